"""Says what can be done while no robot is found, about robots that never were, and about those whose rig is off."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from asterism.protocol.rig import Rig, Robot
from asterism.server.chain.frame import Frame
from asterism.server.chain.pipeline import localize
from asterism.server.identity.plan import plan_for
from asterism.server.pose.solve import PoseEstimate
from asterism.server.pose.track import Tracks
from asterism.server.service.advice import Wider, advice, wider_advice
from asterism.server.service.tally import Blank, Tally

AFTER_S = 3.0  # without a robot
MISFIT_EVERY = 30  # frames


class Adviser:
    """Looks at a tally: `look` about once a second while it grows, `last` when it is whole."""

    def __init__(self, rig: Rig, tally: Tally, say: Callable[[str], None]) -> None:
        self._rig = rig
        self._tally = tally
        self._say = say
        self._said: Blank | None = None
        self._looked = 0  # how many frames there were when misfits were looked at
        self._off: set[str] = set()  # robots of whose rig it was said that it is off
        self._wider_rigs: list[tuple[Rig, bool]] = []

    def look(self) -> None:
        """Say why no robot is found, once for every time that lasts, and once of a robot that its rig is off."""
        self._look_at_misfits()
        blank = self._tally.blank
        if blank is None or blank is self._said or self._tally.clock() - blank.began_s < AFTER_S:
            return
        self._said = blank
        if sentence := self._sentence():
            self._say(f"no robot is found: {sentence}")

    def _look_at_misfits(self) -> None:
        if self._tally.frames >= self._looked + MISFIT_EVERY:
            self._looked = self._tally.frames
            for sentence in self._tally.off(self._rig, self._off):
                self._say(sentence)

    def last(self) -> list[str]:
        """What is to be said at the end: why no robot was found at all, or what kept single ones from being found."""
        ours = {robot.id for robot in self._rig.robots}  # the rig may have been another before
        missing = [robot for robot in self._tally.missing() if robot in ours]
        if len(missing) == len(self._rig.robots):
            return [f"no robot was found: {sentence}"] if (sentence := self._sentence()) else []
        frame = self._tally.frame
        if not missing or frame is None:
            return []
        return [wider_advice(wider, self._range()) for wider in self._look_wider(frame) if wider.robot in missing]

    def summary(self) -> list[str]:
        """The end of a run: every robot by state, and what can be done for those that were never found."""
        if not self._tally.frames:
            return []
        return [*self._tally.lines(), *self._tally.off(self._rig, self._off), *self.last()]

    def _sentence(self) -> str:
        blank = self._tally.seen()
        return "" if blank is None else advice(blank[0], self._look_wider(blank[1]), self._range())

    def _range(self) -> tuple[float, float]:
        plan = plan_for(self._rig)
        return plan.near, plan.far

    def _look_wider(self, frame: Frame) -> list[Wider]:
        """The robots that a frame holds where range, LED radius and handedness of the rig are not believed."""
        if not self._wider_rigs:
            self._wider_rigs = [(wider_rig(self._rig, mirrored), mirrored) for mirrored in (False, True)]
        for rig, mirrored in self._wider_rigs:
            result, _ = localize(frame, rig, Tracks.none())
            found = [
                Wider(robot, float(np.linalg.norm(answer.position)), mirrored)
                for robot, answer in result.answers.items()
                if isinstance(answer, PoseEstimate)
            ]
            if found:
                return found
        return []


def wider_rig(rig: Rig, mirrored: bool) -> Rig:
    """The rig without limits of range and LED radius, in the camera's frame; every constellation its mirror image."""
    return replace(
        rig,
        range_m=None,
        z_correction=None,
        T_world_camera=None,
        follows_world=False,
        robots=tuple(_wider_robot(robot, mirrored) for robot in rig.robots),
    )


def _wider_robot(robot: Robot, mirrored: bool) -> Robot:
    leds = robot.leds
    if mirrored:
        leds = robot.T_robot_plane.map(robot.leds_plane * np.array([-1.0, 1.0, 1.0]))
    return replace(robot, leds=leds, led_radius=None, led_offset=None, normal=None)
