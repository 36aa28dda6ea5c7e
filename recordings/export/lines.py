"""The JSON lines of `asterism locate`, `fuse` and `simulate` as frames for export."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np

from asterism.protocol.codec import UNIT
from asterism.protocol.errors import InputError
from asterism.protocol.keys import key_problem
from asterism.protocol.messages import Velocity
from asterism.protocol.yaml_file import describe
from asterism.recordings.export.frames import Alternative, ExportedFrame, ExportedRobot, ExportedSurface

SUFFIX = ".jsonl"
LONGEST = 16 << 20  # bytes of a line
EXPECTED = "JSON lines as asterism locate writes them"
FARTHEST_M = 1e9
LOST = "LOST"  # what lines call every robot without a pose; IDENTITY_AMBIGUOUS stands in the reason

Three = tuple[float, float, float]
Four = tuple[float, float, float, float]


class _Alternative(msgspec.Struct):
    position: Three
    orientation: Four
    odds: float


class _Velocity(msgspec.Struct):
    linear: Three
    angular: Three
    covariance: list[float]


class _Without(msgspec.Struct):
    position: Three
    orientation: Four
    covariance: list[float]


class _Surface(msgspec.Struct):
    standing: str
    reason: str = ""
    off_m: float | None = None
    off_sigma_m: float | None = None
    tilt_off_rad: float | None = None
    tilt_off_sigma_rad: float | None = None
    without: _Without | None = None


class _Robot(msgspec.Struct):
    id: str
    position: Three
    orientation: Four
    state: str = ""
    covariance: list[float] | None = None
    leds: Annotated[int, msgspec.Meta(ge=0, le=255)] | None = None
    rms_px: float | None = None
    alternative: _Alternative | None = None
    filter: str = ""
    velocity: _Velocity | None = None
    extrapolated: bool = False
    cameras: tuple[str, ...] = ()
    surface: _Surface | None = None


class _Line(msgspec.Struct):
    frame: str
    robots: list[_Robot]
    exposed_ns: int | msgspec.UnsetType = msgspec.UNSET
    lost: dict[str, str] = {}


def lines_of(path: Path) -> Iterator[ExportedFrame]:
    """The frames that a file of lines tells of, one after the other; they tell no parent frame and no session.

    Raises InputError with file, line, what was found and what is accepted.
    """
    decoder = msgspec.json.Decoder(_Line)
    with path.open("rb") as stream:
        for number, line in enumerate(iter(lambda: stream.readline(LONGEST + 1), b""), start=1):
            if len(line) > LONGEST:
                raise InputError(f"{path}: line {number}: is longer than {LONGEST >> 20} MB, expected {EXPECTED}")
            if line.strip():
                where = f"{path}: line {number}"
                yield _frame(_decoded(decoder, line, where), number, where)


def _decoded(decoder: "msgspec.json.Decoder[_Line]", line: bytes, where: str) -> _Line:
    try:
        return decoder.decode(line)
    except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as error:
        raise InputError(f"{where}: {error}; expected {EXPECTED}") from None


def _frame(line: _Line, number: int, where: str) -> ExportedFrame:
    if line.exposed_ns is msgspec.UNSET:
        raise InputError(f"{where}: tells no exposed_ns, expected one in every line (a survey needs a column time_s)")
    if not 0 <= line.exposed_ns < 1 << 63:
        raise InputError(f"{where}: exposed_ns: {describe(line.exposed_ns)}, expected ns, 0 to 2^63 - 1")
    found: dict[str, ExportedRobot] = {}
    for robot in (*(_located(robot, where) for robot in line.robots), *_lost(line)):
        if problem := key_problem(robot.id):
            raise InputError(f"{where}: the robot's id {describe(robot.id)} {problem}")
        if robot.id in found:
            raise InputError(f"{where}: {describe(robot.id)} is told of twice, expected once")
        found[robot.id] = robot
    return ExportedFrame(line.frame, number, line.exposed_ns, 0, "", tuple(found.values()))


def _lost(line: _Line) -> Iterator[ExportedRobot]:
    for robot, reason in line.lost.items():
        yield ExportedRobot(robot, LOST, reason)


def _located(robot: _Robot, where: str) -> ExportedRobot:
    where = f"{where}: {describe(robot.id)}"
    _check_pose(robot.position, robot.orientation, where)
    if robot.covariance is not None and len(robot.covariance) != 36:
        raise InputError(f"{where}: covariance: {len(robot.covariance)} numbers, expected 36")
    other = robot.alternative
    if other is not None:
        _check_pose(other.position, other.orientation, f"{where}: alternative")
    return ExportedRobot(
        robot.id,
        robot.state,
        position=robot.position,
        orientation=robot.orientation,
        covariance=None if robot.covariance is None else tuple(robot.covariance),
        leds=robot.leds,
        rms_px=robot.rms_px,
        alternative=None if other is None else Alternative(other.position, other.orientation, other.odds),
        smoothed_by=robot.filter,
        velocity=_velocity(robot.velocity, where),
        extrapolated=robot.extrapolated,
        cameras=robot.cameras,
        surface=None if robot.surface is None else _surface(robot.surface, where),
    )


def _surface(told: _Surface, where: str) -> ExportedSurface:
    without = None
    if told.without is not None:
        _check_pose(told.without.position, told.without.orientation, f"{where}: surface: without")
        if len(told.without.covariance) != 36:
            found = len(told.without.covariance)
            raise InputError(f"{where}: surface: without: covariance: {found} numbers, expected 36")
        without = told.without.position, told.without.orientation, tuple(told.without.covariance)
    numbers = (told.off_m, told.off_sigma_m, told.tilt_off_rad, told.tilt_off_sigma_rad)
    return ExportedSurface(told.standing, told.reason, *numbers, without)


def _velocity(told: _Velocity | None, where: str) -> Velocity | None:
    if told is None:
        return None
    if len(told.covariance) != 36:
        raise InputError(f"{where}: velocity: covariance: {len(told.covariance)} numbers, expected 36")
    return Velocity(np.array(told.linear), np.array(told.angular), np.array(told.covariance).reshape(6, 6))


def _check_pose(position: Three, orientation: Four, where: str) -> None:
    length = math.hypot(*orientation)
    if abs(length - 1.0) > UNIT:
        raise InputError(f"{where}: a quaternion of length {length:g}, expected x, y, z, w of length 1")
    if not all(abs(value) <= FARTHEST_M for value in position):
        raise InputError(f"{where}: position: {list(position)}, expected m, up to {FARTHEST_M:g}")
