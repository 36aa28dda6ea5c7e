"""Calibrations that other programs made: what they say, and what of it Asterism's lens models can be.

ROS' camera_info files, dumps and messages, OpenCV's FileStorage, kalibr's camchains.
"""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from google.protobuf.message import DecodeError

from asterism.protocol.camera import DISTORTION_MODELS, Camera
from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats
from asterism.protocol.keys import key_problem
from asterism.protocol.sensor_part import part_of
from asterism.protocol.text_file import read_text
from asterism.protocol.yaml_file import describe, shortened
from asterism.server.calibration.lens.calibration_texts import read_calibration
from asterism.server.sources.foreign.ros_messages import BadMessage, CameraInfoTold, read_camera_info
from asterism.server.sources.foreign.topic_frames import holds_topics, open_topics
from asterism.server.sources.foreign.topics import chosen, shown, type_name

# Models by the names that others give them.
NAMES = {
    "plumb_bob": "plumb_bob",
    "radtan": "plumb_bob",
    "rational_polynomial": "rational_polynomial",
    "equidistant": "equidistant",
    "fisheye": "equidistant",
}
NO_FOCAL_PX = 1e-6  # and less is as good as 0
ACCEPTED = "plumb_bob (radtan), rational_polynomial, equidistant (fisheye)"
INFO_NAMES = "sensor_msgs/CameraInfo, foxglove.CameraCalibration"


class ForeignCamera(NamedTuple):
    """A camera, and what it was read from, in sentences."""

    camera: Camera
    told: list[str]


def read_foreign_camera(source: str, topic: str | None, model: str | None, name: str) -> ForeignCamera:
    """The calibration in a file of another program, FILE#cam1 for one of several cameras in it.

    ``topic`` chooses among those of an MCAP file or a bag; ``model`` is what a person says where the file does not;
    ``name`` is the camera's where the file has none. Raises InputError.
    """
    path, which = Path(source), None
    if not path.exists() and "#" in source:
        file, _, which = source.rpartition("#")
        path = Path(file)
    if holds_topics(path):
        if which is not None:
            raise InputError(f"{source}: a bag's calibrations are chosen by --topic, not by #")
        kind, told = _from_topic(path, topic)
    elif topic is not None:
        raise InputError(f"--topic {topic}: {source} has no topics; they are in MCAP files and bags of ROS")
    else:
        kind, told = read_calibration(read_text(path, "a camera's calibration"), str(path), which)
    return _camera(told, kind, source, model, name)


def _from_topic(path: Path, topic: str | None) -> tuple[str, CameraInfoTold]:
    files = open_topics(path)
    found = chosen(files, topic, INFO_TYPES, "a camera's calibration", INFO_NAMES)
    for _, payload in files.messages(found):
        try:
            told = INFO_TYPES[found.type, found.encoding](bytes(payload))
        except BadMessage as problem:
            raise InputError(f"{path}, {shown(found.name)}: {problem}") from None
        return f"{type_name(found.type)} on {shown(found.name)}", told
    raise InputError(f"{path}: topic {shown(found.name)} holds no messages")


def _foxglove(payload: bytes) -> CameraInfoTold:
    message = CameraCalibration()
    try:
        message.ParseFromString(payload)
    except DecodeError:
        raise BadMessage("is no foxglove.CameraCalibration") from None
    if len(message.K) != 9:
        raise BadMessage(f"holds a matrix of {len(message.K)} numbers, expected 9")
    matrix = np.array(message.K).reshape(3, 3)
    distortion = np.array(message.D, np.float64)
    return CameraInfoTold("", message.width, message.height, message.distortion_model, distortion, matrix)


INFO_TYPES: dict[tuple[str, str], Callable[[bytes], CameraInfoTold]] = {
    ("sensor_msgs/msg/CameraInfo", "cdr"): read_camera_info,
    ("sensor_msgs/msg/CameraInfo", "ros1"): lambda payload: read_camera_info(payload, ros1=True),
    ("foxglove.CameraCalibration", "protobuf"): _foxglove,
}


def camera_of(told: CameraInfoTold, source: str, name: str) -> Camera:
    """The camera that a message tells of, for the images as they come. Raises InputError."""
    return _camera(told, "", source, None, name).camera


def _camera(told: CameraInfoTold, kind: str, source: str, model: str | None, name: str) -> ForeignCamera:
    """The camera, checked, for the images as they come."""
    if not (16 <= told.width <= 65_535 and 16 <= told.height <= 65_535):
        raise InputError(f"{source}: the image is {told.width}x{told.height}, expected 16 to 65535 px each way")
    _check_matrix(told.matrix, told.height, source)
    taken = _model(told, model, source)
    distortion = _coefficients(told.distortion, taken, source)
    lines = [f"{source}: {kind}: {told.width}x{told.height}, {taken} with {len(told.distortion)} coefficients"]
    if told.name and (problem := key_problem(told.name)):
        lines.append(f"its name {describe(told.name)} {problem}: the camera is called '{name}'")
    elif told.name:
        name = told.name
    camera = Camera(name, told.width, told.height, told.matrix, taken, distortion)
    return _part(camera, told, source, lines)


def _part(camera: Camera, told: CameraInfoTold, source: str, lines: list[str]) -> ForeignCamera:
    """What the images show of the sensor, where they are a region of it or binned."""
    x, y, width, height = told.region
    binning = max(told.binning[0], 1), max(told.binning[1], 1)
    if not (width and height):
        x, y, width, height = 0, 0, camera.width, camera.height
    size = width // binning[0], height // binning[1]
    if (x, y, size) == (0, 0, (camera.width, camera.height)):
        return ForeignCamera(camera, lines)
    try:
        part = part_of(camera, (x, y), size, binning)
    except ValueError as problem:
        raise InputError(f"{source}: its binning and region of interest: {problem}") from None
    lines.append(
        f"its images are {size[0]}x{size[1]} px: {width}x{height} from ({x}, {y}) on, binned "
        f"{binning[0]}x{binning[1]}; the calibration was scaled to them"
    )
    return ForeignCamera(part, lines)


def _check_matrix(matrix: Floats, height: int, source: str) -> None:
    where = f"{source}: the camera's matrix"
    if not np.isfinite(matrix).all() or abs(matrix).max() > 1e9:
        raise InputError(f"{where}: holds what is no number of px")
    if not (matrix[0, 0] > NO_FOCAL_PX and matrix[1, 1] > NO_FOCAL_PX):
        raise InputError(
            f"{where}: fx = {matrix[0, 0]:g} and fy = {matrix[1, 1]:g}, expected focal lengths above 0 px; drivers "
            "tell zeros for a camera that was never calibrated"
        )
    if skew := matrix[0, 1]:
        moved = abs(skew) * height / 2 / matrix[1, 1]
        raise InputError(
            f"{where}: a skew of {skew:g} px, the sensor's rows and columns "
            f"{np.degrees(abs(np.arctan2(skew, matrix[0, 0]))):.3g} degrees off the right angle, which no lens model "
            f"here has, since sensors have none; calibrate again without it, or write 0 there if {moved:.2g} px at "
            "the image's edge do not matter"
        )
    if list(matrix[1:, 0]) != [0, 0] or matrix[2, 1] != 0 or matrix[2, 2] != 1:
        raise InputError(f"{where}: expected the form [fx, 0, cx, 0, fy, cy, 0, 0, 1]")


def _model(told: CameraInfoTold, asked: str | None, source: str) -> str:
    """Asterism's name of the model. Where the file has none, the number of coefficients tells, or a person."""
    if told.model in ("", "none") and not any(told.distortion.tolist()):
        return asked or "plumb_bob"
    if told.model:
        if told.model not in NAMES:
            raise InputError(
                f"{source}: the model {shortened(told.model)!r}, expected one of {ACCEPTED}; calibrate with one "
                "of these"
            )
        if asked not in (None, NAMES[told.model]):
            raise InputError(f"{source}: its model is {told.model}, but --model is {asked}")
        return NAMES[told.model]
    if asked is not None:
        return asked
    count = len(told.distortion)
    if count == 4:
        raise InputError(
            f"{source}: 4 coefficients and no name of their model: say --model plumb_bob (k1 k2 p1 p2), or --model "
            "equidistant (cv::fisheye)"
        )
    return "plumb_bob" if count <= 5 else "rational_polynomial"


def _coefficients(told: Floats, model: str, source: str) -> Floats:
    """As many as the model has; zeros may be missing for no distortion at all, and be too many."""
    if not np.isfinite(told).all() or (abs(told) > 1e9).any():
        raise InputError(f"{source}: its coefficients hold what is no number")
    accepted = DISTORTION_MODELS[model]
    kept = told[: max(accepted)]
    if told[len(kept) :].any():
        raise InputError(
            f"{source}: {len(told)} coefficients for {model}, expected {max(accepted)}: those of thin prisms and of a "
            "tilted sensor are not modelled; calibrate again without them"
        )
    if not kept.any():
        return np.zeros(5 if model == "plumb_bob" else max(accepted))
    if len(kept) not in accepted:
        wanted = " or ".join(map(str, accepted))
        raise InputError(f"{source}: {len(kept)} coefficients, expected {wanted} for {model}")
    return np.concatenate([kept, np.zeros(1)]) if len(kept) == 4 and model == "plumb_bob" else kept
