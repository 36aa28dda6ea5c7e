"""Whether a payload is what its schema says, so that every reader can take it; and what it is, where no schema says."""

import math
from collections.abc import Callable, Iterable
from pathlib import Path

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import DecodeError
from google.protobuf.message import Message as Protobuf

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import UNIT, decode_event, decode_frame_report, decode_odometry, is_coverage, is_event
from asterism.protocol.errors import InputError
from asterism.protocol.messages import (
    ANNOTATIONS,
    CALIBRATION,
    COVERAGE,
    EVENT,
    FRAME_REPORT,
    IMAGE,
    ODOMETRY,
    STATUS,
    TRANSFORMS,
    Kind,
    RobotPose,
)
from asterism.protocol.program import typed

FINITE_M = 1e6
_DIGITS = 20  # of 64 bits


def is_decodable(schema: str, payload: bytes | memoryview) -> bool:
    """Whether a message of that schema is sound; one of a schema that is not Asterism's counts as sound."""
    known = _KNOWN.get(schema)
    if known is None:
        return True
    make, is_sound = known
    message = make()
    try:
        message.ParseFromString(payload)  # type: ignore[arg-type]
    except DecodeError:
        return False
    return is_sound(message)


def read_report(payload: bytes, where: Path) -> "pb.FrameReport":
    """The frame report in a recording's message. Raises InputError for one that no server of Asterism makes."""
    try:
        report = decode_frame_report(payload)
    except InputError as error:
        raise InputError(f"{where}: {error}; run this first: {typed('recover', where)}") from None
    if not _report(report):
        raise InputError(
            f"{where}: its report of frame {report.sequence} is none that a server makes; run this first: "
            f"{typed('recover', where)}"
        )
    return report


def read_odometry(payload: bytes, where: Path) -> RobotPose:
    """The pose in a recording's message. Raises InputError for one that no server of Asterism makes."""
    try:
        pose = decode_odometry(payload)
        if not is_decodable(ODOMETRY.schema, payload):
            raise InputError(f"its pose of frame {pose.sequence} is none that a server makes")
    except InputError as error:
        raise InputError(f"{where}: {error}; run this first: {typed('recover', where)}") from None
    return pose


def read_event(payload: bytes, where: Path) -> "pb.Event":
    """The event in a recording's message. Raises InputError for one that no server of Asterism makes."""
    try:
        return decode_event(payload)
    except InputError as error:
        raise InputError(f"{where}: {error}; run this first: {typed('recover', where)}") from None


def channel_of(payload: bytes | memoryview, camera: str) -> tuple[str, Kind] | None:
    """The key and kind of a message whose channel is lost, told by what it holds; None where that fits nothing."""
    for kind in (IMAGE, FRAME_REPORT, ODOMETRY, STATUS, EVENT, COVERAGE, CALIBRATION, TRANSFORMS, ANNOTATIONS):
        make, is_sound = _KNOWN[kind.schema]
        message = make()
        try:
            message.ParseFromString(payload)  # type: ignore[arg-type]
        except DecodeError:
            continue
        if is_sound(message) and _SURE[kind.schema](message):
            return _key(kind, message, camera), kind
    return None


def _key(kind: Kind, message: Protobuf, camera: str) -> str:
    if isinstance(message, Odometry):
        return keys.odometry(camera, message.body_frame_id)
    of_kind: dict[str, Callable[[str], str]] = {
        IMAGE.schema: keys.image,
        FRAME_REPORT.schema: keys.frame,
        STATUS.schema: keys.status,
        EVENT.schema: keys.event,
        COVERAGE.schema: keys.coverage,
        CALIBRATION.schema: keys.calibration,
        ANNOTATIONS.schema: keys.annotations,
    }
    return keys.TRANSFORMS if kind is TRANSFORMS else of_kind[kind.schema](camera)


def _image(image: RawImage) -> bool:
    sized = image.width <= image.step and image.width * image.height > 0
    return sized and len(image.data) == image.step * image.height and image.encoding in {"mono8", "8UC1"}


def _odometry(message: Odometry) -> bool:
    told = {pair.key: pair.value for pair in message.metadata}
    return (
        {"state", "leds", "rms_px", "sequence"} <= told.keys()
        and len(message.pose_covariance) == 36
        and _pose(message.pose)  # type: ignore[arg-type]
        and _named(message.body_frame_id)
        and _framed(message.frame_id)
        and 0 <= message.timestamp.seconds < 1 << 33
        and all(_counts(told.get(key, "0")) for key in ("leds", "sequence", "published_ns", "session"))
    )


def _report(report: "pb.FrameReport") -> bool:
    spots = report.spots
    columns = (spots.y, spots.covariance_xx, spots.covariance_xy, spots.covariance_yy)
    more = (spots.brightness, spots.radius, spots.fate, spots.robot, spots.led)
    return (
        all(len(column) == len(spots.x) for column in (*columns, *more))
        and all(robot < len(report.robots) for robot in spots.robot)
        and all(fate in _FATES for fate in spots.fate)
        and all(_robot(robot, len(spots.x)) for robot in report.robots)
        and len({robot.id for robot in report.robots}) == len(report.robots)
        and _framed(report.frame_id)
        and (not report.HasField("camera") or _pose(report.camera.pose))
        and _finite([*spots.x, *spots.y, *spots.radius])
        and report.exposed_ns < 1 << 63
        and report.sequence < 1 << 63
    )


def _robot(robot: "pb.RobotReport", spots: int) -> bool:
    columns = (robot.led, robot.residual_x, robot.residual_y)
    return (
        robot.state in _STATES
        and _named(robot.id)
        and all(len(column) == len(robot.spot) for column in columns)
        and all(0 <= spot < spots for spot in robot.spot)
        and (not robot.HasField("pose") or _pose(robot.pose))
        and (not robot.HasField("alternative") or _pose(robot.alternative.pose))
        and _finite([*robot.residual_x, *robot.residual_y, robot.rms_px])
    )


def _named(robot: str) -> bool:
    """Whether a robot can be called so: files are named after it."""
    return keys.key_problem(robot) is None


def _framed(frame_id: str) -> bool:
    """The same of the parent frame of poses; there may be none."""
    return not frame_id or _named(frame_id)


def _counts(text: str) -> bool:
    return text.isascii() and text.isdecimal() and len(text) <= _DIGITS and int(text) < 1 << 64


def _pose(pose: "pb.Pose") -> bool:
    p, q = pose.position, pose.orientation
    return _finite((p.x, p.y, p.z)) and abs(math.hypot(q.x, q.y, q.z, q.w) - 1.0) <= UNIT


def _finite(numbers: Iterable[float]) -> bool:
    return all(abs(number) < FINITE_M for number in numbers)


def _always(_: Protobuf) -> bool:
    return True


_STATES = frozenset(pb.State.values()) - {0}
_FATES = frozenset(pb.Fate.values())
_KNOWN: dict[str, tuple[Callable[[], Protobuf], Callable[..., bool]]] = {
    IMAGE.schema: (RawImage, _image),
    ODOMETRY.schema: (Odometry, _odometry),
    FRAME_REPORT.schema: (pb.FrameReport, _report),
    STATUS.schema: (pb.Status, _always),
    EVENT.schema: (pb.Event, is_event),
    COVERAGE.schema: (pb.Coverage, is_coverage),
    CALIBRATION.schema: (CameraCalibration, _always),
    TRANSFORMS.schema: (FrameTransforms, _always),
    ANNOTATIONS.schema: (ImageAnnotations, _always),
}
# What only a message of that kind holds; a payload of one kind may decode as another.
_SURE: dict[str, Callable[..., bool]] = {
    IMAGE.schema: lambda image: len(image.data) > 0,
    ODOMETRY.schema: lambda told: bool(told.body_frame_id),
    FRAME_REPORT.schema: lambda report: report.exposed_ns > 0 and len(report.robots) > 0 and bool(report.frame_id),
    STATUS.schema: lambda status: status.time_ns > 0 and bool(status.source),
    EVENT.schema: lambda event: event.since_ns > 0,
    COVERAGE.schema: lambda told: bool(told.since_ns and told.columns and told.rows and told.HasField("frame")),
    CALIBRATION.schema: lambda told: len(told.K) == 9 and len(told.P) == 12,
    TRANSFORMS.schema: lambda told: all(entry.parent_frame_id and entry.child_frame_id for entry in told.transforms),
    ANNOTATIONS.schema: lambda told: all(circle.HasField("position") for circle in told.circles),
}
