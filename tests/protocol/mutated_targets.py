"""What reads files and messages of others, each with a good input to be mutated; the law that all of them keep."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any

import cv2
import numpy as np

from asterism.protocol.camera import parse_camera
from asterism.protocol.codec import decode_odometry, encode_rig, to_bytes
from asterism.protocol.errors import InputError
from asterism.protocol.led_offset import parse_offset
from asterism.protocol.rig import parse_rig
from asterism.recordings.export.columns import groups, row
from asterism.recordings.export.lines import lines_of
from asterism.server.calibration.survey.survey import read_survey
from asterism.server.calibration.survey.survey_csv import read_survey_csv
from asterism.server.sources.images import UnreadableImage, read_pages, to_grey8
from tests.fusing import mutated_reports
from tests.protocol import make_golden, mutated_clients, mutated_sources, mutated_surfaces
from tests.protocol.bounds import TooMuch, bounded
from tests.protocol.message_mutations import mutated_message
from tests.protocol.mutations import mutated_bytes, mutated_yaml
from tests.protocol.picture_mutations import mutated_bmp, mutated_jpeg, mutated_png, mutated_tiff
from tests.protocol.small_camera import CAMERA
from tests.protocol.table_mutations import mutated_table
from tests.recordings import mutated_recordings

RIG = """\
camera: camera.yaml
range: [0.4, 0.9]
masks: [[0, 0, 20, 30]]
capture: {rate: 60, exposure_us: 500, size: [640, 512], offset: [0, 0], binning: 1, bits: 12}
world: {position: [0.0, 0.0, 1.3], orientation: [1.0, 0.0, 0.0, 0.0]}
robots:
  alpha:
    leds: [[0.02923, 0.03294, 0.0], [-0.01279, 0.04273, 0.0], [-0.04582, 0.004, 0.0],
      [-0.01981, -0.01067, 0.0], [-0.03314, -0.0269, 0.0], [0.01278, -0.04416, 0.0]]
    led: {radius: 0.0025, axis: [0, 0, 1], offset: led.yaml}
    points: {tool: [0.0, 0.0, -0.03]}
    normal: {world: [0, 0, 1], within_deg: 40}
"""
FISHEYE = CAMERA.replace("plumb_bob", "equidistant").replace("cols: 5", "cols: 4").replace(", 0.0]}\n", "]}\n")
CORRECTED = (
    RIG
    + """\
z_correction: {kind: plane, centre: [0.0, 0.0, 1.0], scale: [0.5, 0.4, 0.3], coefficients: [0.001, 0.0, 0.0, 0.0],
  spread: [[1e-4, 0, 0, 0], [0, 1e-4, 0, 0], [0, 0, 1e-4, 0], [0, 0, 0, 1e-4]], region: 0.001, most: 0.01, misfit: 0.0}
"""
)
OFFSET = "axial_shift: [0.0001, -0.0002, 0.0003]\nup_to_deg: 50\n"
SURVEY = """\
{"frame": "0.png", "robots": [{"id": "alpha", "position": [0.1, 0.2, 1.3], "orientation": [0, 0, 0, 1]}]}
{"frame": "1.png", "exposed_ns": 5, "robots": [], "lost": {"alpha": "why"}}
"""
_SPREADSHEETS = (
    "robot,frame,x_mm,y_mm,z_mm,yaw_deg,note\nalpha,0.png,100.5,-20,30.25,90,\nalpha,1.png,4,5.5,6,170,x\n",
    "\ufeffrobot;time_s;x_m;y_m;z_m;qx;qy;qz;qw\r\nalpha;0,5;0,1;0,2;1,3;0;0;0,6;0,8\r\n;;;;;;;;\r\n",
)
SPREADSHEETS = tuple(text.encode() for text in _SPREADSHEETS)
LINES = """\
{"frame": "0.png", "exposed_ns": 5, "robots": [{"id": "alpha", "state": "TRACKED", "position": [0.1, 0.2, 1.3],
 "orientation": [0, 0, 0.6, 0.8], "leds": 6, "rms_px": 0.01, "alternative": {"position": [0.1, 0.2, 1.3],
 "orientation": [0, 0, 0, 1], "odds": 12.0}}], "lost": {"bravo": "why"}}
""".replace("\n ", " ")


@dataclass(frozen=True)
class Target:
    """``read`` takes what ``mutate`` makes of one of the ``good``; ``in_tests`` of them are tried in the test suite,
    and of a million ``in_a_thousand`` of each thousand.
    """

    read: Callable[[Any], object]
    good: tuple[Any, ...]
    mutate: Callable[[Any, np.random.Generator], Any]
    in_tests: int
    in_a_thousand: int

    @property
    def is_bytes(self) -> bool:
        return isinstance(self.good[0], bytes)

    def mutated(self, rng: np.random.Generator) -> Any:
        """One that is wrong."""
        return self.mutate(self.good[int(rng.integers(len(self.good)))], rng)


def check(target: Target, mutated: Any) -> bool:
    """The law: read, or refused with one printable line, within bounds. Returns whether it was read."""
    try:
        with bounded():
            target.read(mutated)
    except (InputError, UnreadableImage) as refused:
        text = str(refused)
        assert 0 < len(text) < 2000, f"a sentence of {len(text)} characters"
        assert text.isprintable(), text
        return False
    except TooMuch as much:
        raise AssertionError(str(much)) from None
    return True


def _in_a_file(read: Callable[[Path], object], suffix: str) -> Callable[[bytes | str], object]:
    def reading(data: bytes | str) -> object:
        with NamedTemporaryFile(suffix=suffix) as file:
            file.write(data if isinstance(data, bytes) else data.encode("utf-8", "surrogatepass"))
            file.flush()
            return read(Path(file.name))

    return reading


def _rig(text: str) -> object:
    rig = parse_rig(text, CAMERA, "fuzz", {"led.yaml": OFFSET})
    assert all(np.isfinite(robot.leds).all() for robot in rig.robots)
    return encode_rig(rig)


def _exported(path: Path) -> object:
    of = groups(())
    return [row(of, frame, robot) for frame in lines_of(path) for robot in frame.robots]


def _camera(text: str) -> object:
    camera = parse_camera(text, "fuzz")
    assert np.isfinite(camera.matrix).all()
    assert np.isfinite(camera.distortion).all()
    return camera


def _image(path: Path) -> object:
    """Read as a source does: the size is asked for before anything is decoded."""

    def check_size(width: int, height: int) -> None:
        if (width, height) != (64, 48):
            raise InputError(f"{width}x{height}, expected 64x48")

    shapes = {to_grey8(image, 12, name).shape for name, image in read_pages(path, check_size)}
    assert shapes == {(48, 64)}
    return shapes


_PROGRESSIVE = (cv2.IMWRITE_JPEG_PROGRESSIVE, 1)


@cache
def _encoded(suffix: str, kind: str = "uint8", channels: int = 1, options: tuple[int, ...] = ()) -> bytes:
    rng = np.random.default_rng(3)
    image = rng.integers(0, 200, (48, 64, channels)).astype(kind)
    ok, data = cv2.imencode(suffix, image, options)
    assert ok
    return bytes(data)


def _stack() -> bytes:
    pages = [np.full((48, 64), 10 * page, np.uint8) for page in range(3)]
    ok, data = cv2.imencodemulti(".tiff", pages)
    assert ok
    return bytes(data)


_PNGS = (_encoded(".png"), _encoded(".png", "uint16"), _encoded(".png", channels=3))
_JPEGS = (_encoded(".jpg"), _encoded(".jpg", channels=3), _encoded(".jpg", options=_PROGRESSIVE))
_TIFFS = (_encoded(".tiff", "uint16"), _encoded(".tiff", channels=3), _stack())
_REPORTS = (to_bytes(make_golden.frame_report()), to_bytes(make_golden.smoothed_report()))
TARGETS = {
    "rig": Target(_rig, (RIG, CORRECTED), mutated_yaml, 400, 12),
    "surface": Target(mutated_surfaces.rig, mutated_surfaces.RIGS, mutated_yaml, 300, 12),
    "heights": Target(mutated_surfaces.heights, mutated_surfaces.TABLES, mutated_table, 300, 20),
    "stl": Target(mutated_surfaces.stl, mutated_surfaces.files(), mutated_surfaces.mutated_stl, 150, 10),
    "camera": Target(_camera, (CAMERA, FISHEYE), mutated_yaml, 400, 12),
    "led_offset": Target(lambda text: parse_offset(text, "fuzz"), (OFFSET,), mutated_yaml, 400, 10),
    "survey": Target(_in_a_file(lambda path: read_survey(path, ["alpha"]), ".jsonl"), (SURVEY,), mutated_yaml, 500, 6),
    "survey_csv": Target(_in_a_file(read_survey_csv, ".csv"), SPREADSHEETS, mutated_table, 500, 6),
    "pose_lines": Target(_in_a_file(_exported, ".jsonl"), (LINES,), mutated_yaml, 500, 6),
    "odometry": Target(decode_odometry, mutated_clients.poses(), mutated_message, 4000, 190),
    "pose": Target(mutated_clients.pose, mutated_clients.poses(), mutated_message, 5000, 210),
    "report": Target(mutated_clients.report, _REPORTS, mutated_message, 2700, 140),
    "status": Target(mutated_clients.status, (to_bytes(make_golden.status()),), mutated_message, 1000, 40),
    "event": Target(mutated_clients.event, (to_bytes(make_golden.event()),), mutated_message, 1000, 40),
    "beat": Target(mutated_clients.beat, (to_bytes(make_golden.beat()),), mutated_message, 1000, 40),
    "rig_report": Target(mutated_clients.rig_report, (to_bytes(make_golden.rig_report()),), mutated_message, 1000, 40),
    "fused": Target(
        mutated_reports.fused, mutated_reports.frames(mutated_reports.BEFORE)[:1], mutated_message, 150, 10
    ),
    "png": Target(_in_a_file(_image, ".png"), _PNGS, mutated_png, 900, 80),
    "jpeg": Target(_in_a_file(_image, ".jpg"), _JPEGS, mutated_jpeg, 900, 70),
    "tiff": Target(_in_a_file(_image, ".tiff"), _TIFFS, mutated_tiff, 900, 80),
    "bmp": Target(_in_a_file(_image, ".bmp"), (_encoded(".bmp"),), mutated_bmp, 300, 10),
    "image_message": Target(mutated_sources.image_message, mutated_sources.image_messages(), mutated_message, 1000, 40),
    "ros_message": Target(mutated_sources.ros_message, mutated_sources.ros_messages(), mutated_bytes, 500, 20),
    "ros2_image": Target(mutated_sources.ros2_image, mutated_sources.ros2_images(), mutated_bytes, 300, 10),
    "calibration": Target(mutated_sources.camera_of, mutated_sources.CALIBRATIONS, mutated_yaml, 300, 10),
    "film_mcap": Target(
        mutated_sources.frames_of_mcap, mutated_sources.files("mcap"), mutated_recordings.mutated_file, 150, 10
    ),
    "film_db3": Target(mutated_sources.frames_of_db3, mutated_sources.files("db3"), mutated_bytes, 100, 5),
    "film_bag": Target(mutated_sources.frames_of_bag, mutated_sources.files("bag"), mutated_bytes, 100, 5),
    "review": Target(mutated_recordings.review, _REPORTS, mutated_message, 300, 10),
    "mcap": Target(mutated_recordings.read, mutated_recordings.files(), mutated_recordings.mutated_file, 200, 20),
    "recover": Target(mutated_recordings.recover, mutated_recordings.files(), mutated_recordings.mutated_file, 100, 20),
}
