"""Differences of two recordings, per robot and field: what changed between two runs on the same frames."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import report_pose
from asterism.protocol.geometry import angle_between
from asterism.protocol.messages import FRAME_REPORT
from asterism.recordings.decodable import read_report
from asterism.recordings.reader import Recording


@dataclass(slots=True)
class Difference:
    """How one robot's answers differ: position m, rotation rad, residual px, frames of another state or LED count."""

    robot: str
    frames: int = 0  # in both recordings
    located_only_a: int = 0
    located_only_b: int = 0
    other_state: int = 0
    other_leds: int = 0
    position_m: list[float] = field(default_factory=list)
    rotation_rad: list[float] = field(default_factory=list)
    rms_px: list[float] = field(default_factory=list)

    def within(self, position_m: float, rotation_rad: float) -> bool:
        """Whether every frame agrees within the tolerances."""
        return (
            not (self.located_only_a or self.located_only_b or self.other_state)
            and max(self.position_m, default=0.0) <= position_m
            and max(self.rotation_rad, default=0.0) <= rotation_rad
        )


@dataclass(slots=True)
class Comparison:
    """All robots' differences, and the frames that only one recording has."""

    robots: dict[str, Difference]
    frames_both: int
    frames_only_a: int
    frames_only_b: int

    def within(self, position_m: float, rotation_rad: float) -> bool:
        """Whether the recordings hold the same frames and agree within the tolerances."""
        return not (self.frames_only_a or self.frames_only_b) and all(
            robot.within(position_m, rotation_rad) for robot in self.robots.values()
        )


def reports(recording: Recording) -> Iterator["pb.FrameReport"]:
    """The frame reports of a recording. Raises InputError for one that no server of Asterism makes."""
    for message in recording.messages():
        if message.kind.schema == FRAME_REPORT.schema:
            yield read_report(message.payload, recording.path)


def compare(a: Recording, b: Recording) -> Comparison:
    """Compare frame by frame; frames belong together by their sequence number, of two cameras (one of them may be what
    `asterism fuse` joined) by their time: cameras count their frames each for itself.
    """
    key = "sequence" if a.rig().camera.name == b.rig().camera.name else "exposed_ns"
    of_a = {getattr(report, key): report for report in reports(a)}
    of_b = {getattr(report, key): report for report in reports(b)}
    robots: dict[str, Difference] = {}
    both = sorted(of_a.keys() & of_b.keys())
    for frame in both:
        there = {robot.id: robot for robot in of_b[frame].robots}
        here = {robot.id: robot for robot in of_a[frame].robots}
        for robot_id in sorted(here.keys() | there.keys()):
            difference = robots.setdefault(robot_id, Difference(robot_id))
            _compare_robot(difference, here.get(robot_id), there.get(robot_id))
    return Comparison(robots, len(both), len(of_a) - len(both), len(of_b) - len(both))


def _compare_robot(difference: Difference, a: "pb.RobotReport | None", b: "pb.RobotReport | None") -> None:
    difference.frames += 1
    in_a, in_b = a is not None and a.HasField("pose"), b is not None and b.HasField("pose")
    difference.located_only_a += in_a and not in_b
    difference.located_only_b += in_b and not in_a
    if a is None or b is None:
        return
    difference.other_state += a.state != b.state
    if not (in_a and in_b):
        return
    difference.other_leds += a.leds != b.leds
    pose_a, pose_b = report_pose(a.pose), report_pose(b.pose)
    difference.position_m.append(float(np.linalg.norm(pose_a.position - pose_b.position)))
    difference.rotation_rad.append(angle_between(pose_a.rotation, pose_b.rotation))
    difference.rms_px.append(abs(a.rms_px - b.rms_px))


def percentile(values: list[float], share: float) -> float:
    """A percentile; nan where there are no values."""
    return float(np.percentile(values, share)) if values else math.nan
