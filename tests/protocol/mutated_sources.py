"""What reads images and calibrations of other programs, with good ones to be mutated."""

from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np

from asterism.protocol.errors import InputError
from asterism.protocol.ros2.types import COMPRESSED_IMAGE, IMAGE
from asterism.server.calibration.lens.foreign_camera import read_foreign_camera
from asterism.server.service.ros2.told_camera import difference
from asterism.server.sources.foreign.image_messages import picture
from asterism.server.sources.foreign.network import told_by
from asterism.server.sources.foreign.ros_images import RosImages
from asterism.server.sources.foreign.ros_messages import BadMessage, read_camera_info, read_compressed, read_image
from asterism.server.sources.foreign.topic_frames import ForeignFrames, open_topics
from tests.rigs import make_camera
from tests.sources.foreign.foreign_files import (
    ROS1,
    ROS2,
    camera_info,
    compressed,
    raw,
    ros_compressed,
    ros_image,
    write_bag1,
    write_bag2,
    write_mcap,
)

_IMAGE = np.random.default_rng(3).integers(0, 200, (48, 64)).astype(np.uint8)
_CAMERA = make_camera(64, 48, 80.0)
_TOPIC = RosImages("/fuzz", 0, None, print)
_STAMP_NS = 1_700_000_000_000_000_001


def _file(suffix: str) -> bytes:
    return bytes(cv2.imencode(suffix, _IMAGE)[1])


def check_size(width: int, height: int) -> None:
    """As a calibrated source does."""
    if (width, height) != (64, 48):
        raise InputError(f"{width}x{height}, expected 64x48")


def image_message(payload: bytes) -> object:
    """From the network, with nothing said of what it is."""
    try:
        found = picture(told_by("", payload), check_size)
    except BadMessage as problem:
        raise InputError(str(problem)) from None
    assert found.image.shape[:2] == (48, 64)
    return found.image.shape


def ros_message(payload: bytes) -> object:
    """Of ROS 2; the first byte says of which kind."""
    try:
        told = (read_image if payload[:1] == b"i" else read_compressed)(payload[1:])
        found = picture(told, check_size)
    except BadMessage as problem:
        raise InputError(str(problem)) from None
    assert found.image.shape[:2] == (48, 64)
    return found.image.shape


def ros2_image(payload: bytes) -> object:
    """As `ros2:TOPIC` reads them; the first byte says of which kind: images, or the calibration beside them."""
    kinds = {b"i": IMAGE, b"c": COMPRESSED_IMAGE}
    try:
        if payload[:1] not in kinds:
            return difference(_CAMERA, read_camera_info(payload[1:]))
        told = _TOPIC.told(kinds[payload[:1]].ros, payload[1:])
        return picture(told, check_size).image.shape
    except BadMessage as problem:
        raise InputError(str(problem)) from None


def camera_of(text: str) -> object:
    """A calibration, of whatever kind."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "fuzz"
        path.write_bytes(text.encode("utf-8", "surrogatepass"))
        camera = read_foreign_camera(str(path), None, None, "fuzz").camera
    assert np.isfinite(camera.matrix).all()
    assert np.isfinite(camera.distortion).all()
    return camera


def frames_of(suffix: str, data: bytes) -> object:
    """All images of a file."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"fuzz{suffix}"
        path.write_bytes(data)
        source = ForeignFrames("fuzz", open_topics(path), None, None, lambda _: None)
        return [frame.image.shape for frame in source.frames()]


frames_of_mcap, frames_of_db3, frames_of_bag = (partial(frames_of, suffix) for suffix in (".mcap", ".db3", ".bag"))


def image_messages() -> tuple[bytes, ...]:
    """Pixels and files."""
    wide = np.full((48, 64), 3000, np.uint16)
    found = [raw(_IMAGE, _STAMP_NS), raw(wide, _STAMP_NS, "mono16"), raw(_IMAGE, _STAMP_NS, "bayer_rggb8", pad=3)]
    files = [compressed(_file(suffix), _STAMP_NS) for suffix in (".png", ".jpg")]
    return tuple(message.SerializeToString() for message in [*found, *files])


def ros_messages() -> tuple[bytes, ...]:
    """Likewise."""
    one, other = ros_image(_IMAGE, _STAMP_NS), ros_compressed(_file(".png"), _STAMP_NS, "png")
    return (
        b"i" + bytes(ROS2.serialize_cdr(one, one.__msgtype__)),
        b"c" + bytes(ROS2.serialize_cdr(other, other.__msgtype__)),
    )


def ros2_images() -> tuple[bytes, ...]:
    """And calibrations: another than the camera's, of a region, of another model."""
    told = [
        camera_info([85.0, 0, 33.0, 0, 85.0, 22.0, 0, 0, 1], [0.1, 0.0, 0.0, 0.0, 0.0], (64, 48)),
        camera_info(
            [160.0, 0, 66.0, 0, 160.0, 44.0, 0, 0, 1],
            [0.1] * 4,
            (128, 96),
            model="equidistant",
            binning=(2, 2),
            region=(0, 0, 128, 96),
        ),
    ]
    return (*ros_messages(), *(b"n" + bytes(ROS2.serialize_cdr(one, one.__msgtype__)) for one in told))


CALIBRATIONS = (
    """\
width: 1280
height: 1024
distortion_model: plumb_bob
d: [-0.11, 0.035, 0.0004, -0.0003, 0.01]
k: [1400.0, 0.0, 645.3, 0.0, 1401.8, 508.7, 0.0, 0.0, 1.0]
binning_x: 2
binning_y: 2
roi: {x_offset: 200, y_offset: 100, height: 600, width: 800, do_rectify: false}
""",
    """\
cam0:
  camera_model: pinhole
  distortion_coeffs: [-0.02, 0.01, -0.003, 0.001]
  distortion_model: equidistant
  intrinsics: [1400.0, 1401.8, 645.3, 508.7]
  resolution: [1280, 1024]
""",
    """\
%YAML:1.0
---
image_width: 1280
image_height: 1024
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 1400., 0., 645.3, 0., 1401.8, 508.7, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -0.11, 0.035, 0.0004, -0.0003, 0.01 ]
""",
    """\
<?xml version="1.0"?>
<opencv_storage>
<image_width>1280</image_width>
<image_height>1024</image_height>
<camera_matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt>
  <data>1400. 0. 645.3 0. 1401.8 508.7 0. 0. 1.</data></camera_matrix>
<distortion_coefficients type_id="opencv-matrix"><rows>5</rows><cols>1</cols><dt>d</dt>
  <data>-0.11 0.035 0.0004 -0.0003 0.01</data></distortion_coefficients>
</opencv_storage>
""",
)


def files(kind: str) -> tuple[bytes, ...]:
    """A file of three images: mcap, db3, bag."""
    with TemporaryDirectory() as folder:
        path, store = Path(folder) / f"film.{kind}", ROS1 if kind == "bag" else ROS2
        messages = [("/i", _STAMP_NS + k, ros_image(_IMAGE, _STAMP_NS + k, store=store)) for k in range(3)]
        if kind == "mcap":
            write_mcap(path, messages)
        elif kind == "bag":
            write_bag1(path, messages, "lz4")
        else:
            path = next(write_bag2(path, messages).glob("*.db3"))
        return (path.read_bytes(),)
