"""Encode and decode, side by side for each kind of message.

Every sub-message is set, even where it is zero: rerun's importer refuses an unset one. Encoding is deterministic, so
equal values have equal bytes.
"""

import math
from dataclasses import replace
from typing import TypeVar

import msgspec
import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import DecodeError
from google.protobuf.message import Message as Protobuf
from google.protobuf.timestamp_pb2 import Timestamp
from numpy.typing import NDArray

from asterism import __version__
from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.camera import Camera
from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.messages import EVENT, FRAME_REPORT, ODOMETRY, PROTOCOL, STATUS, Message, RobotPose, Velocity
from asterism.protocol.rig import Rig

SECOND_NS = 1_000_000_000
_PUBLISHED = "published_ns"
_ACCELERATIONS = ("acceleration", "turn_acceleration")
_FARTHEST_M = 1e9
_LONGEST = 200  # of a reason
UNIT = 1e-3  # a quaternion may be off unit length by so much
_HAPPENINGS = frozenset(pb.Happening.values()) - {0}
_STATES = frozenset(pb.State.values())
_DATA_TAG = bytes([RawImage.DATA_FIELD_NUMBER << 3 | 2])  # a field of bytes

M = TypeVar("M", bound=Protobuf)


def to_bytes(message: Protobuf) -> bytes:
    """The bytes of a protobuf message; equal messages have equal bytes, maps included."""
    return message.SerializeToString(deterministic=True)


def timestamp(time_ns: int) -> Timestamp:
    """Of ns since the Unix epoch."""
    return Timestamp(seconds=time_ns // SECOND_NS, nanos=time_ns % SECOND_NS)


def _nanoseconds(stamp: Timestamp) -> int:
    return stamp.seconds * SECOND_NS + stamp.nanos


def _set_pose(target: "pb.Pose", pose: Pose) -> None:
    """Write a pose into any message with the fields position and orientation."""
    p, q = target.position, target.orientation
    p.x, p.y, p.z = pose.position.tolist()
    q.x, q.y, q.z, q.w = pose.orientation.tolist()
    p.SetInParent()


def set_vector(target: "pb.Vector3", vector: Floats) -> None:
    """Write (3,) into a vector message."""
    target.x, target.y, target.z = vector.tolist()
    target.SetInParent()


def encode_odometry(told: RobotPose) -> bytes:
    """foxglove.Odometry."""
    message = Odometry(timestamp=timestamp(told.exposed_ns), frame_id=told.frame_id, body_frame_id=told.robot)
    _set_pose(message.pose, told.pose)  # type: ignore[arg-type]
    message.pose_covariance.extend(told.covariance.ravel().tolist())
    for key, value in (
        ("state", told.state),
        ("leds", str(told.leds)),
        ("rms_px", f"{told.rms_px:.5g}"),
        ("sequence", str(told.sequence)),
        ("session", str(told.session)),
    ):
        message.metadata.add(key=key, value=value)
    if told.smoothed_by:
        message.metadata.add(key="smoothed", value="true")
        message.metadata.add(key="filter", value=told.smoothed_by)
    if told.extrapolated:
        message.metadata.add(key="extrapolated", value="true")
    if told.cameras:
        message.metadata.add(key="cameras", value=msgspec.json.encode(told.cameras).decode())
    if told.standing:
        message.metadata.add(key="surface", value=told.standing)
    if told.velocity is not None:
        _set_velocity(message, told.velocity)
    return to_bytes(message) + (_odometry_stamp(told.published_ns) if told.published_ns else b"")


def _set_velocity(message: Odometry, velocity: Velocity) -> None:
    for vector, values in (
        (message.linear_velocity, velocity.linear),
        (message.angular_velocity, velocity.angular),
    ):
        vector.x, vector.y, vector.z = values.tolist()
        vector.SetInParent()
    message.velocity_covariance.extend(velocity.covariance.ravel().tolist())
    for key, value in zip(_ACCELERATIONS, velocity.accelerations, strict=True):
        message.metadata.add(key=key, value=f"{value:.5g}")


def _velocity(message: Odometry, metadata: dict[str, str]) -> Velocity | None:
    """The velocity in a message, or None where it has none. Raises ValueError for half of one."""
    if not message.velocity_covariance:
        return None
    v, w = message.linear_velocity, message.angular_velocity
    linear, angular = (float(metadata.get(key, "0")) for key in _ACCELERATIONS)
    return Velocity(
        np.array([v.x, v.y, v.z]),
        np.array([w.x, w.y, w.z]),
        np.array(message.velocity_covariance[:]).reshape(6, 6),
        (linear, angular),
    )


def _cameras(metadata: dict[str, str]) -> tuple[str, ...]:
    """The cameras that a pose rests on. Raises ValueError for what is no list of names."""
    try:
        return msgspec.json.decode(metadata.get("cameras", "[]"), type=tuple[str, ...])
    except msgspec.DecodeError as error:
        raise ValueError(f"its cameras are no list of names: {error}") from None


def _odometry_stamp(published_ns: int) -> bytes:
    """One more pair of metadata, last of the message."""
    message = Odometry()
    message.metadata.add(key=_PUBLISHED, value=str(published_ns))
    return to_bytes(message)


def in_session(message: Message, session: int) -> Message:
    """The message told in another session, as a replay does: the last of equal fields and keys holds."""
    payload = message.payload
    if message.kind.schema == ODOMETRY.schema:
        told = Odometry()
        told.metadata.add(key="session", value=str(session))
        payload += to_bytes(told)
    elif message.kind.schema == FRAME_REPORT.schema:
        payload += to_bytes(pb.FrameReport(session=session))
    elif message.kind.schema == STATUS.schema:
        payload += to_bytes(pb.Status(session=session))
    elif message.kind.schema == EVENT.schema:
        payload += to_bytes(pb.Event(session=session))
    return replace(message, payload=payload)


def stamped(message: Message, published_ns: int) -> Message:
    """The message as it goes out at that time, ns since the Unix epoch: poses, frame reports and events tell it.

    Protobuf lets a field come last: the bytes that are there stay as they are, and stamping takes no encoding.
    """
    payload = message.payload
    if message.kind is ODOMETRY:
        payload += _odometry_stamp(published_ns)
    elif message.kind is FRAME_REPORT:
        payload += to_bytes(pb.FrameReport(published_ns=published_ns))
    elif message.kind is EVENT:
        payload += to_bytes(pb.Event(published_ns=published_ns))
    return replace(message, payload=payload, publish_ns=published_ns)


def decode_odometry(payload: bytes) -> RobotPose:
    """The RobotPose in a foxglove.Odometry. Raises InputError for bytes that are none, or not Asterism's.

    Numbers may be any that a message can hold: who drives by them looks first (`clients.accept`).
    """
    message = Odometry()
    try:
        message.ParseFromString(payload)
        metadata = {pair.key: pair.value for pair in message.metadata}
        p, q = message.pose.position, message.pose.orientation
        length = math.hypot(q.x, q.y, q.z, q.w)
        if not abs(length - 1.0) <= UNIT:
            raise ValueError(f"a quaternion of length {length:.3g}")
        return RobotPose(
            robot=message.body_frame_id,
            frame_id=message.frame_id,
            pose=Pose(np.array([p.x, p.y, p.z]), np.array([q.x, q.y, q.z, q.w])),
            covariance=np.array(message.pose_covariance[:]).reshape(6, 6),
            state=metadata["state"],
            leds=int(metadata["leds"]),
            rms_px=float(metadata["rms_px"]),
            sequence=int(metadata["sequence"]),
            exposed_ns=_nanoseconds(message.timestamp),
            published_ns=int(metadata.get(_PUBLISHED, "0")),
            session=int(metadata.get("session", "0")),
            smoothed_by=metadata.get("filter", ""),
            extrapolated=metadata.get("extrapolated") == "true",
            velocity=_velocity(message, metadata),
            cameras=_cameras(metadata),
            standing=metadata.get("surface", ""),
        )
    except (DecodeError, KeyError, ValueError) as error:
        why = str(error)[:_LONGEST]  # it may quote any text of the message
        raise InputError(f"odometry message: {len(payload)} bytes that are no pose of Asterism ({why})") from None


# FrameReport and Status are used as the protobuf messages they are.


def decode_frame_report(payload: bytes) -> "pb.FrameReport":
    """Raises InputError for bytes that are none."""
    return _parse(pb.FrameReport(), payload)


def decode_status(payload: bytes) -> "pb.Status":
    """Raises InputError for bytes that are none."""
    return _parse(pb.Status(), payload)


def decode_coverage(payload: bytes) -> "pb.Coverage":
    """Raises InputError for bytes that are none."""
    coverage = _parse(pb.Coverage(), payload)
    if not is_coverage(coverage):
        raise InputError(f"{len(payload)} bytes that are no {coverage.DESCRIPTOR.full_name} of a server")
    return coverage


def is_coverage(coverage: "pb.Coverage") -> bool:
    """Whether a server makes such a one."""
    patches = coverage.columns * coverage.rows
    return (
        0.0 < coverage.pitch < math.inf
        and 0 < coverage.exposed_ns < 1 << 63
        and math.isfinite(coverage.x0)
        and math.isfinite(coverage.y0)
        and all(
            len(column) == len(of.patch) and max(of.patch, default=0) < max(patches, 1)
            for of in coverage.robots
            for column in (of.dwell_s, of.passes, of.speed, of.direction, of.last_ns)
        )
    )


def _parse(message: M, payload: bytes) -> M:
    try:
        message.ParseFromString(payload)
    except DecodeError as error:
        raise InputError(f"{len(payload)} bytes that are no {message.DESCRIPTOR.full_name} ({error})") from None
    return message


def set_report_pose(target: "pb.Pose", pose: Pose) -> None:
    """Write a pose into a report."""
    _set_pose(target, pose)


def report_pose(message: "pb.Pose") -> Pose:
    """The pose in a report. Raises InputError as `check_report_pose` does."""
    check_report_pose(message)
    p, q = message.position, message.orientation
    return Pose(np.array([p.x, p.y, p.z]), np.array([q.x, q.y, q.z, q.w]))


def check_report_pose(message: "pb.Pose") -> None:
    """Raises InputError for a pose that is none: not finite, beyond everything, or no rotation."""
    p, q = message.position, message.orientation
    x, y, z, length = p.x, p.y, p.z, math.hypot(q.x, q.y, q.z, q.w)
    near = abs(x) <= _FARTHEST_M and abs(y) <= _FARTHEST_M and abs(z) <= _FARTHEST_M
    if not (near and abs(length - 1.0) <= UNIT):
        raise InputError(f"a pose at {x:g}, {y:g}, {z:g} m, its quaternion of length {length:.3g}, is none")


def decode_event(payload: bytes) -> "pb.Event":
    """Raises InputError for bytes that are none, such as another message, and for one that no server makes."""
    event = _parse(pb.Event(), payload)
    if not is_event(event):
        raise InputError(f"{len(payload)} bytes that are no {event.DESCRIPTOR.full_name} (nothing has happened)")
    return event


def is_event(event: "pb.Event") -> bool:
    """Whether a server makes such a one."""
    known = event.happening in _HAPPENINGS and event.before in _STATES and event.state in _STATES
    return known and event.number > 0 and event.since_ns < 1 << 63 and 0.0 <= event.lasted_s < math.inf


def decode_beat(payload: bytes) -> "pb.Beat":
    """Raises InputError for bytes that are none, such as another message, which protobuf takes for an empty one."""
    beat = _parse(pb.Beat(), payload)
    if not beat.session:
        raise InputError(f"{len(payload)} bytes that are no {beat.DESCRIPTOR.full_name} (it is of no session)")
    return beat


# Rig report: rig and calibration in force, and who answers.


def encode_rig(rig: Rig) -> bytes:
    """asterism.RigReport."""
    camera = rig.camera
    message = pb.RigReport(
        camera=camera.name,
        frame_id=rig.parent_frame,
        width=camera.width,
        height=camera.height,
        camera_matrix=camera.matrix.ravel().tolist(),
        distortion_model=camera.model,
        distortion=camera.distortion.tolist(),
        rig_yaml=rig.rig_text,
        camera_yaml=rig.camera_text,
        offset_yaml=rig.offset_texts,
        files=rig.files,
        version=__version__,
        protocol=PROTOCOL,
    )
    if rig.T_world_camera is not None:
        _set_pose(message.world_camera, rig.T_world_camera)
    for robot in rig.robots:
        entry = message.robots.add(id=robot.id)
        for led in robot.leds:
            set_vector(entry.leds.add(), led)
        set_vector(entry.axis, robot.axis)
        for name, point in robot.points.items():
            set_vector(entry.points[name], point)
    return to_bytes(message)


def decode_rig(payload: bytes) -> "pb.RigReport":
    """Raises InputError for bytes that are none."""
    return _parse(pb.RigReport(), payload)


# What recordings hold beside the published messages, for viewers.


def encode_transforms(time_ns: int, transforms: list[tuple[str, str, Pose]]) -> bytes:
    """foxglove.FrameTransforms of (parent frame, child frame, T_parent_child)."""
    message, stamp = FrameTransforms(), timestamp(time_ns)
    for parent, child, pose in transforms:
        entry = message.transforms.add(timestamp=stamp, parent_frame_id=parent, child_frame_id=child)
        entry.translation.x, entry.translation.y, entry.translation.z = pose.position.tolist()
        entry.translation.SetInParent()
        q = entry.rotation
        q.x, q.y, q.z, q.w = pose.orientation.tolist()
    return to_bytes(message)


def encode_calibration(time_ns: int, camera: Camera) -> bytes:
    """foxglove.CameraCalibration; the projection matrix is K, images are as the camera gives them."""
    k = camera.matrix
    message = CameraCalibration(
        timestamp=timestamp(time_ns),
        frame_id=camera.name,
        width=camera.width,
        height=camera.height,
        distortion_model=camera.model,
        D=camera.distortion.tolist(),
        K=k.ravel().tolist(),
        R=np.eye(3).ravel().tolist(),
        P=np.column_stack([k, np.zeros(3)]).ravel().tolist(),
    )
    return to_bytes(message)


def encode_image(time_ns: int, camera: Camera, image: NDArray[np.uint8]) -> bytes:
    """foxglove.RawImage of an (h, w) grey image."""
    return b"".join(image_parts(time_ns, camera, image))


def image_parts(time_ns: int, camera: Camera, image: NDArray[np.uint8]) -> tuple[bytes, memoryview]:
    """The same in two pieces, the second of which is the image's own memory: nothing of it is copied.

    Its field comes last, which protobuf allows.
    """
    height, width = image.shape
    message = RawImage(
        timestamp=timestamp(time_ns), frame_id=camera.name, width=width, height=height, encoding="mono8", step=width
    )
    pixels = memoryview(np.ascontiguousarray(image).reshape(-1))  # type: ignore[arg-type]
    return to_bytes(message) + _DATA_TAG + varint(len(pixels)), pixels


def varint(number: int) -> bytes:
    """Protobuf's variable-length number."""
    coded = bytearray()
    while number > 0x7F:
        coded.append(number & 0x7F | 0x80)
        number >>= 7
    return bytes([*coded, number])


def decode_image(payload: bytes) -> NDArray[np.uint8]:
    """The (h, w) uint8 image in a foxglove.RawImage. Raises InputError for another encoding than mono8."""
    message = _parse(RawImage(), payload)
    if message.encoding not in {"mono8", "8UC1"}:
        raise InputError(f"image message: encoding {message.encoding!r}, expected mono8")
    if message.step < message.width or len(message.data) != message.step * message.height:
        raise InputError(f"image message: {len(message.data)} bytes, expected {message.step} x {message.height}")
    rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)
    return np.ascontiguousarray(rows[:, : message.width])
