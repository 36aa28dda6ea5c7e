"""What reads files and messages of others, each with a good input to be mutated; the law that all of them keep."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any

import cv2
import numpy as np

from asterism.clients.json_lines import as_json
from asterism.protocol.camera import parse_camera
from asterism.protocol.codec import (
    decode_beat,
    decode_frame_report,
    decode_odometry,
    decode_rig,
    decode_status,
    encode_odometry,
    encode_rig,
    to_bytes,
)
from asterism.protocol.errors import InputError
from asterism.protocol.led_offset import parse_offset
from asterism.protocol.rig import parse_rig
from asterism.server.calibration.survey.survey import read_survey
from asterism.server.sources.images import UnreadableImage, read_pages, to_grey8
from tests.protocol import make_golden
from tests.protocol.mutations import mutated_bytes, mutated_yaml

CAMERA = """\
image_width: 640
image_height: 512
camera_name: top
camera_matrix: {rows: 3, cols: 3, data: [700.0, 0.0, 319.5, 0.0, 700.0, 255.5, 0.0, 0.0, 1.0]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0.0, 0.0, 0.0, 0.0, 0.0]}
"""
RIG = """\
camera: camera.yaml
range: [0.4, 0.9]
masks: [[0, 0, 20, 30]]
capture: {rate: 60, exposure_us: 500, size: [640, 512], bits: 12}
world: {position: [0.0, 0.0, 1.3], orientation: [1.0, 0.0, 0.0, 0.0]}
robots:
  alpha:
    leds: [[0.02923, 0.03294, 0.0], [-0.01279, 0.04273, 0.0], [-0.04582, 0.004, 0.0],
      [-0.01981, -0.01067, 0.0], [-0.03314, -0.0269, 0.0], [0.01278, -0.04416, 0.0]]
    led: {radius: 0.0025, axis: [0, 0, 1], offset: led.yaml}
    points: {tool: [0.0, 0.0, -0.03]}
    normal: {world: [0, 0, 1], within_deg: 40}
"""
OFFSET = "axial_shift: [0.0001, -0.0002, 0.0003]\nup_to_deg: 50\n"
SURVEY = """\
{"frame": "0.png", "robots": [{"id": "alpha", "position": [0.1, 0.2, 1.3], "orientation": [0, 0, 0, 1]}]}
{"frame": "1.png", "exposed_ns": 5, "robots": [], "lost": {"alpha": "why"}}
"""


@dataclass(frozen=True)
class Target:
    """``read`` takes what ``mutate`` makes of ``good``; ``in_tests`` of them are tried in the test suite."""

    read: Callable[[Any], object]
    good: Any
    mutate: Callable[[Any, np.random.Generator], Any]
    in_tests: int

    @property
    def is_bytes(self) -> bool:
        return isinstance(self.good, bytes)


def check(target: Target, mutated: Any) -> bool:
    """The law: read, or refused with one printable line. Returns whether it was read."""
    try:
        target.read(mutated)
    except (InputError, UnreadableImage) as refused:
        text = str(refused)
        assert 0 < len(text) < 2000, f"a sentence of {len(text)} characters"
        assert "\n" not in text, text
        return False
    return True


def _in_a_file(read: Callable[[Path], object], suffix: str) -> Callable[[bytes | str], object]:
    def reading(data: bytes | str) -> object:
        with NamedTemporaryFile(suffix=suffix) as file:
            file.write(data if isinstance(data, bytes) else data.encode("utf-8", "surrogatepass"))
            file.flush()
            return read(Path(file.name))

    return reading


def _rig(text: str) -> object:
    return encode_rig(parse_rig(text, CAMERA, "fuzz", {"led.yaml": OFFSET}))


def _report(payload: bytes) -> object:
    return json.dumps(as_json("top", decode_frame_report(payload), frozenset()))


def _image(path: Path) -> object:
    """Read as a source does: the size is asked for before anything is decoded."""

    def check_size(width: int, height: int) -> None:
        if (width, height) != (64, 48):
            raise InputError(f"{width}x{height}, expected 64x48")

    return [to_grey8(image, 12, name).shape for name, image in read_pages(path, check_size)]


@cache
def _encoded(suffix: str, kind: str = "uint8") -> bytes:
    rng = np.random.default_rng(3)
    image = rng.integers(0, 200, (48, 64)).astype(kind)
    ok, data = cv2.imencode(suffix, image)
    assert ok
    return bytes(data)


TARGETS = {
    "rig": Target(_rig, RIG, mutated_yaml, 600),
    "camera": Target(lambda text: parse_camera(text, "fuzz"), CAMERA, mutated_yaml, 600),
    "led_offset": Target(lambda text: parse_offset(text, "fuzz"), OFFSET, mutated_yaml, 800),
    "survey": Target(_in_a_file(lambda path: read_survey(path, ["alpha"]), ".jsonl"), SURVEY, mutated_yaml, 2000),
    "odometry": Target(decode_odometry, encode_odometry(make_golden.ROBOT_POSE), mutated_bytes, 6000),
    "report": Target(_report, to_bytes(make_golden.frame_report()), mutated_bytes, 4000),
    "status": Target(decode_status, to_bytes(make_golden.status()), mutated_bytes, 1000),
    "beat": Target(decode_beat, to_bytes(make_golden.beat()), mutated_bytes, 1000),
    "rig_report": Target(decode_rig, encode_rig(make_golden.RIG), mutated_bytes, 1000),
    "png": Target(_in_a_file(_image, ".png"), _encoded(".png"), mutated_bytes, 1000),
    "jpeg": Target(_in_a_file(_image, ".jpg"), _encoded(".jpg"), mutated_bytes, 1000),
    "tiff": Target(_in_a_file(_image, ".tiff"), _encoded(".tiff", "uint16"), mutated_bytes, 1000),
}
