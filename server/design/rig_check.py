"""How well a rig's robots can be told apart, what their poses are worth, how often a tilt is taken for the other."""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from asterism.protocol.constellation import Confusion, confusions
from asterism.protocol.geometry import Floats
from asterism.protocol.rig import Rig, Robot
from asterism.server.design.pose_bounds import Bound, pose_bound
from asterism.server.design.telling_apart import SIGMAS, TILT_DEG, image_px, needed_m
from asterism.server.identity.plan import plan_for

SIGMA_PX = 0.05  # of a centre, with what calibration and LED positions add to it
TILTS_DEG = (0.0, 5.0, 10.0, 15.0, 30.0, 45.0, 60.0)
TYPICAL_DEG = 30.0
RARE = 0.01  # of the frames: tilts that are mistaken less often are no concern
KINDS = ("two robots", "one and itself", "mirror image")


@dataclass(frozen=True, slots=True)
class Weakest:
    """The nearest of all confusions of a kind."""

    kind: str  # one of KINDS
    hidden: int
    confusion: Confusion


@dataclass(frozen=True, slots=True, eq=False)
class RobotCheck:
    """One robot; separations in m, the lesser of both directions (inf where there is no other robot)."""

    robot: Robot
    other: dict[int, float]  # by the number of hidden LEDs: from any other robot
    itself: dict[int, float]
    bound: Bound  # at the farthest distance and TYPICAL_DEG
    bound_hidden: Bound  # the same with the LED hidden that makes z worst

    @property
    def rms_radius(self) -> float:
        """Of its LEDs about their mean, m."""
        leds = self.robot.leds_plane
        return float(np.sqrt(((leds - leds.mean(axis=0)) ** 2).sum(axis=1).mean()))


@dataclass(frozen=True, slots=True, eq=False)
class RigCheck:
    """Everything `asterism check` tells. Distances in m; bounds hold for centres with SIGMA_PX."""

    rig: Rig
    distances: tuple[float, float, float]  # nearest, middle, farthest
    tilt_deg: float  # the worst that is reckoned with
    weakest: tuple[Weakest, ...]
    robots: tuple[RobotCheck, ...]
    bounds: dict[tuple[float, float], tuple[Bound, ...]]  # by distance and tilt in degrees: one a robot

    def px(self, separation: float, tilt_deg: float) -> float:
        """A separation in the image at the farthest distance."""
        return image_px(separation, self.rig.camera.focal_px, self.distances[-1], tilt_deg)

    @property
    def needed(self) -> float:
        """The separation, m, that is enough at the farthest distance, worst tilt and SIGMA_PX."""
        return needed_m(SIGMA_PX, self.rig.camera.focal_px, self.distances[-1], self.tilt_deg)

    def verdict(self) -> list[str]:
        """One sentence on identities, one on mirror images, one on tilts; and one where five LEDs lie on one line."""
        return [*self._identities(), self._mirrors(), *self._lines(), self._tilts()]

    def _least(self, hidden: int, mirrored: bool) -> float:
        return min(
            entry.confusion.separation
            for entry in self.weakest
            if entry.hidden == hidden and (entry.kind == KINDS[2]) == mirrored
        )

    def _identities(self) -> list[str]:
        visible, hidden = self._least(0, False), self._least(1, False)
        if hidden >= self.needed and visible >= self.needed:
            return [
                "identities: safe, also with one LED hidden; centres may be "
                f"{self.px(min(visible, hidden), self.tilt_deg) / SIGMAS:.2g} px off (one sigma)"
            ]
        weak = [entry for entry in self.robots if min(entry.other[1], entry.itself[1]) < self.needed]
        who = _list([entry.robot.id for entry in weak])
        if visible >= self.needed:
            return [
                f"identities: safe with all LEDs visible; with one hidden {who} can be mistaken where centres are "
                f"{SIGMA_PX:g} px off (good for {self.px(hidden, self.tilt_deg) / SIGMAS:.2g} px)"
            ]
        return [
            f"identities: NOT safe, even with all LEDs visible, where centres are {SIGMA_PX:g} px off (good for "
            f"{self.px(min(visible, hidden), self.tilt_deg) / SIGMAS:.2g} px): {who}"
        ]

    def _mirrors(self) -> str:
        visible, hidden = self._least(0, True), self._least(1, True)
        if min(visible, hidden) >= self.needed:
            return "mirror images in a polished surface: safe, also with one LED hidden"
        if visible >= self.needed:
            return (
                "mirror images in a polished surface: safe with all LEDs visible; with one hidden they can be mistaken"
            )
        return "mirror images in a polished surface: NOT safe, they can be mistaken for a robot"

    def _lines(self) -> list[str]:
        lined = [entry.robot.id for entry in self.robots if math.isinf(entry.bound_hidden.depth_m)]
        return [f"poses: five LEDs on one line tell none when the sixth is hidden: {_list(lined)}"] if lined else []

    def _tilts(self) -> str:
        far = self.distances[-1]
        mistaken = [
            tilt for (distance, tilt), found in self.bounds.items()
            if distance == far and tilt > 0 and max(bound.flip for bound in found) > RARE
        ]  # fmt: skip
        if not mistaken:
            return f"tilts: the wrong one of the two is likelier in less than {RARE:.0%} of the frames from 5° on"
        return (
            f"tilts: at {far:g} m and {max(mistaken):g}° or less a frame alone can take the wrong one of the two "
            f"(most are flagged TILT_AMBIGUOUS); a surface normal (robots.ID.normal) or frames before decide"
        )


def check_rig(rig: Rig, progress: Callable[[str], None] = lambda _: None) -> RigCheck:
    """Judge a rig at its working distances, or where it gives none at those where its robots can be seen at all.

    ``progress`` is told what is being done.
    """
    near, far = rig.range_m or (plan_for(rig).near, plan_for(rig).far)
    distances = (near, (near + far) / 2, far)
    tilt_deg = min(TILT_DEG, max(_most_tilt_deg(rig, robot) for robot in rig.robots))
    layouts = [robot.leds_plane[:, :2] for robot in rig.robots]
    progress("separations")
    plain = {hidden: list(confusions(layouts, hidden)) for hidden in (0, 1)}
    progress("separations of mirror images")
    mirrored = {hidden: list(confusions(layouts, hidden, mirrored=True)) for hidden in (0, 1)}
    weakest = []
    for kind, hidden in itertools.product(KINDS, (0, 1)):
        found = mirrored[hidden] if kind == KINDS[2] else plain[hidden]
        if kind != KINDS[2]:
            found = [confusion for confusion in found if (confusion.seen == confusion.taken) == (kind == KINDS[1])]
        if found:
            weakest.append(Weakest(kind, hidden, min(found, key=lambda confusion: confusion.separation)))
    progress("poses")
    sigma = SIGMA_PX / rig.camera.focal_px
    bounds = {
        (distance, tilt): tuple(
            pose_bound(robot.leds_plane, distance, math.radians(tilt), sigma) for robot in rig.robots
        )
        for distance in distances
        for tilt in TILTS_DEG
        if tilt <= tilt_deg
    }
    nearest = {hidden: _nearest(plain[hidden], len(rig.robots)) for hidden in (0, 1)}
    robots = tuple(
        RobotCheck(
            robot,
            {hidden: float(nearest[hidden][0][index]) for hidden in (0, 1)},
            {hidden: float(nearest[hidden][1][index]) for hidden in (0, 1)},
            pose_bound(robot.leds_plane, far, math.radians(TYPICAL_DEG), sigma),
            _one_hidden(robot.leds_plane, far, sigma),
        )
        for index, robot in enumerate(rig.robots)
    )
    return RigCheck(rig, distances, tilt_deg, tuple(weakest), robots, bounds)


def _most_tilt_deg(rig: Rig, robot: Robot) -> float:
    """How far the plate can lean from the optical axis, by what the rig knows of its normal; 180 without that."""
    if robot.normal is None or rig.T_world_camera is None:
        return 180.0
    towards = -rig.T_world_camera.rotation[:, 2]
    middle = math.acos(float(np.clip(robot.normal.world @ towards, -1.0, 1.0)))
    off = math.acos(float(np.clip(robot.T_robot_plane.rotation[:, 2] @ robot.axis, -1.0, 1.0)))
    return math.degrees(middle + off + robot.normal.within_rad)


def _nearest(found: list[Confusion], robots: int) -> tuple[Floats, Floats]:
    """For every robot the separation from the nearest other one, and from itself, (robots,) each."""
    matrix = np.full((robots, robots), np.inf)
    for confusion in found:
        matrix[confusion.seen, confusion.taken] = confusion.separation
    itself = np.diag(matrix).copy()
    np.fill_diagonal(matrix, np.inf)
    return np.minimum(matrix.min(axis=0), matrix.min(axis=1)), itself


def _one_hidden(leds: Floats, distance: float, sigma: float) -> Bound:
    bounds = [
        pose_bound(np.delete(leds, led, axis=0), distance, math.radians(TYPICAL_DEG), sigma) for led in range(len(leds))
    ]
    return max(bounds, key=lambda bound: bound.depth_m)


def _list(names: list[str], most: int = 6) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more
