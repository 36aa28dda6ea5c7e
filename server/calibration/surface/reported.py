"""Where robots were located, from what a recording or JSON lines tell: by light alone, in the world of a rig."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import decode_frame_report, report_pose
from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.messages import FRAME_REPORT
from asterism.protocol.rig import Rig
from asterism.recordings.export.frames import ExportedRobot
from asterism.recordings.export.lines import lines_of
from asterism.recordings.reader import Recording
from asterism.server.calibration.surface.located import Sight

SMOOTHED = (
    "are smoothed, which makes the errors of each those of its neighbours; expected what asterism locate finds without "
    "--smooth"
)
SAME_LEDS_M = 1e-7


def check_camera(recording: Recording, rig: Rig) -> None:
    """Raise InputError for a recording of another camera than the rig's."""
    name = recording.rig().camera.name
    if name != rig.camera.name:
        raise InputError(
            f"{recording.path}: is of camera '{name}', expected one of '{rig.camera.name}', whose rig is given"
        )


def sights_of_recording(recording: Recording, rig: Rig) -> Iterator[Sight]:
    """The poses of its frame reports, moved to where the rig has the camera.

    Raises InputError where they are smoothed, or rest on other LEDs than the rig's.
    """
    rigs = recording.rigs()
    for _, then in rigs:
        _check_leds(then, rig, str(recording.path))
    for message in recording.messages():
        if message.kind.schema != FRAME_REPORT.schema:
            continue
        while len(rigs) > 1 and message.sequence >= rigs[1][0]:
            rigs.pop(0)
        report = decode_frame_report(message.payload)
        T_parent_camera = rigs[0][1].T_world_camera or Pose.identity()
        if report.HasField("camera"):
            T_parent_camera = report_pose(report.camera.pose)
        assert rig.T_world_camera is not None
        there = rig.T_world_camera @ T_parent_camera.inverse()
        for entry in report.robots:
            if entry.HasField("pose"):
                if entry.smoothed_by:
                    raise InputError(f"{recording.path}: poses {SMOOTHED}")
                yield _moved(there, _reported(entry, report.exposed_ns * 1e-9))


def _reported(entry: "pb.RobotReport", time_s: float) -> Sight:
    alone = entry.surface if entry.HasField("surface") and entry.surface.HasField("without") else None
    pose, numbers = (entry.pose, entry.covariance) if alone is None else (alone.without, alone.without_covariance)
    other = None
    if alone is None and entry.HasField("alternative"):
        other = report_pose(entry.alternative.pose)
    elif alone is not None and alone.HasField("without_alternative"):
        other = report_pose(alone.without_alternative.pose)
    return Sight(entry.id, time_s, report_pose(pose), np.array(numbers).reshape(6, 6), other)


def _moved(there: Pose, sight: Sight) -> Sight:
    turn = np.kron(np.eye(2), there.rotation)
    other = None if sight.other is None else there @ sight.other
    return Sight(sight.robot, sight.time_s, there @ sight.pose, turn @ sight.covariance @ turn.T, other)


def _check_leds(then: Rig, rig: Rig, where: str) -> None:
    here = {robot.id: robot for robot in rig.robots}
    for robot in then.robots:
        if robot.id not in here:
            raise InputError(f"{where}: robot '{robot.id}' is not in the rig, expected one of {', '.join(here)}")
        if np.abs(robot.leds - here[robot.id].leds).max() > SAME_LEDS_M:
            raise InputError(
                f"{where}: its poses of '{robot.id}' rest on other LEDs than the rig's, and it holds no images to "
                "solve again; expected a film, or a recording made with this rig"
            )


class _Without(msgspec.Struct):
    position: tuple[float, float, float]
    orientation: tuple[float, float, float, float]
    covariance: list[float]


def sights_of_lines(path: Path, rig: Rig) -> Iterator[Sight]:
    """The poses of JSON lines as `asterism locate` writes them, which are in the world.

    Raises InputError with file, line, what was found and what is accepted.
    """
    ids = [robot.id for robot in rig.robots]
    alone = _without(path)
    for frame in lines_of(path):
        for robot in frame.robots:
            where = f"{path}: line {frame.sequence}: '{robot.id}'"
            if robot.id not in ids:
                raise InputError(f"{where}: is not in the rig, expected one of {', '.join(ids)}")
            if robot.pose is None:
                continue
            if robot.smoothed_by:
                raise InputError(f"{where}: poses {SMOOTHED}")
            yield _told(robot, frame.exposed_ns * 1e-9, alone.get((frame.sequence, robot.id)), where)


def _told(robot: ExportedRobot, time_s: float, alone: _Without | None, where: str) -> Sight:
    if alone is not None:
        return Sight(robot.id, time_s, Pose(np.array(alone.position), np.array(alone.orientation)),
                     _square(alone.covariance, where), None)  # fmt: skip
    if robot.covariance is None:
        raise InputError(f"{where}: tells no covariance, expected lines as asterism locate writes them")
    other = robot.alternative
    assert robot.pose is not None
    return Sight(
        robot.id, time_s, robot.pose, _square(robot.covariance, where),
        None if other is None else Pose(np.array(other.position), np.array(other.orientation)),
    )  # fmt: skip


def _square(numbers: "list[float] | tuple[float, ...]", where: str) -> Floats:
    matrix = np.array(numbers, np.float64)
    if matrix.shape != (36,) or not np.isfinite(matrix).all():
        raise InputError(f"{where}: covariance: expected 36 finite numbers")
    return matrix.reshape(6, 6)


def _without(path: Path) -> dict[tuple[int, str], _Without]:
    """What lines tell of light alone, by line and robot; nothing where they know of no surface."""
    found: dict[tuple[int, str], _Without] = {}
    with path.open("rb") as stream:
        for number, text in enumerate(stream, start=1):
            if b'"without"' not in text:
                continue
            try:
                line: Any = msgspec.json.decode(text)
                for robot in line["robots"]:
                    alone = (robot.get("surface") or {}).get("without")
                    if alone is not None:
                        found[number, robot["id"]] = msgspec.convert(alone, _Without)
            except (msgspec.DecodeError, msgspec.ValidationError, KeyError, TypeError, AttributeError):
                raise InputError(f"{path}: line {number}: expected JSON lines as asterism locate writes them") from None
    return found
