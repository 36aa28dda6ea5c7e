"""A V4L2 camera is set as the rig wants, or one sentence tells what it did instead and what it has."""

import errno
from contextlib import closing

import pytest

from asterism.protocol.capture import Capture
from asterism.protocol.errors import InputError
from asterism.server.sources.v4l2 import abi
from asterism.server.sources.v4l2.node import Node
from asterism.server.sources.v4l2.settings import InForce, apply_settings, refuse_what_v4l2_lacks
from tests.sources.v4l2.stand_in import StandInCamera, StandInSystem

VGA, HD = (640, 480), (1280, 720)
WEBCAM = {"YUYV": {VGA: [30.0, 15.0], HD: [10.0]}, "MJPG": {VGA: [60.0, 30.0], HD: [60.0, 30.0]}}
CONTROLS = {
    abi.EXPOSURE_AUTO: [0, 3, 1, 3],
    abi.EXPOSURE_AUTO_PRIORITY: [0, 1, 1, 1],
    abi.EXPOSURE_ABSOLUTE: [3, 2047, 1, 250],
    abi.AUTOGAIN: [0, 1, 1, 1],
    abi.GAIN: [0, 240, 16, 32],
}


def webcam() -> StandInCamera:
    controls = {number: list(values) for number, values in CONTROLS.items()}
    return StandInCamera(formats=WEBCAM, controls=controls, size=VGA, fourcc="YUYV")


def applied(camera: StandInCamera, capture: Capture, size: tuple[int, int] | None = None) -> tuple[InForce, list[str]]:
    said: list[str] = []
    with closing(Node("/dev/video0", StandInSystem(video0=camera))) as node:
        return apply_settings(node, capture, size, "cam", said.append), said


def test_everything_is_set_and_read_back_without_a_word() -> None:
    camera = webcam()
    got, said = applied(camera, Capture(rate_hz=30.0, exposure_us=500.0, gain=48.0), VGA)
    assert said == []
    assert (got.layout.fourcc, got.layout.width, got.layout.height) == ("YUYV", 640, 480)
    assert (got.rate_hz, got.exposure_us) == (30.0, 500.0)
    values = {number: control[3] for number, control in camera.controls.items()}
    assert values == {
        abi.EXPOSURE_AUTO: abi.EXPOSURE_MANUAL,
        abi.EXPOSURE_AUTO_PRIORITY: 0,
        abi.EXPOSURE_ABSOLUTE: 5,
        abi.AUTOGAIN: 0,
        abi.GAIN: 48,
    }


def test_without_wishes_the_camera_stays_as_it_is() -> None:
    camera = webcam()
    got, said = applied(camera, Capture())
    assert said == []
    assert (got.layout.width, got.layout.height, got.rate_hz) == (640, 480, 30.0)
    assert got.exposure_us is None, "automatic: nobody knows"
    assert {number: control[3] for number, control in camera.controls.items()} == {
        number: control[3] for number, control in CONTROLS.items()
    }


@pytest.mark.parametrize(
    ("capture", "sentence"),
    [
        (Capture(exposure_us=550.0), "exposure_us 550: the camera set 600 us; it takes 300 to 204700 in steps of 100"),
        (Capture(exposure_us=100.0), "exposure_us 100: the camera set 300 us; it takes 300 to 204700 in steps of 100"),
        (Capture(gain=50.0), "gain 50: the camera set 48; it takes 0 to 240 in steps of 16"),
        (Capture(gain=1e4), "gain 10000: the camera set 240; it takes 0 to 240 in steps of 16"),
        (Capture(rate_hz=50.0, pixel_format="YUYV"), "rate 50: the camera set 30 Hz; as YUYV of 640x480 it has 30, 15"),
    ],
)
def test_what_it_makes_otherwise_is_said_with_what_it_takes(capture: Capture, sentence: str) -> None:
    _, said = applied(webcam(), capture, VGA)
    assert len(said) == 1
    assert said[0].startswith(f"cam: capture.{sentence}")


def test_what_it_ignores_in_silence_or_lacks_is_said() -> None:
    camera = webcam()
    camera.deaf = {abi.EXPOSURE_ABSOLUTE}
    assert "the camera set 25000 us" in applied(camera, Capture(exposure_us=500.0), VGA)[1][0]
    camera = webcam()
    camera.deaf = {abi.EXPOSURE_AUTO}
    assert "automatic exposure cannot be switched off" in applied(camera, Capture(exposure_us=500.0), VGA)[1][0]
    camera.controls = {}
    got, said = applied(camera, Capture(exposure_us=500.0, gain=1.0), VGA)
    assert ["has no exposure" in said[0], "has no gain" in said[1], len(said)] == [True, True, 2]
    assert got.exposure_us is None
    camera.refuses = {abi.S_PARM: errno.ENOTTY}
    assert "takes no rate" in applied(camera, Capture(rate_hz=30.0), VGA)[1][0]


@pytest.mark.parametrize(
    ("size", "rate", "fourcc"),
    [
        (VGA, None, "YUYV"),
        (VGA, 30.0, "YUYV"),
        (VGA, 30.1, "YUYV"),  # 29.97 is 30
        (VGA, 60.0, "MJPG"),
        (HD, 30.0, "MJPG"),
        (HD, 10.0, "YUYV"),
        (VGA, 200.0, "MJPG"),  # the fastest there is
    ],
)
def test_the_best_format_that_is_fast_enough_is_taken(size: tuple[int, int], rate: float | None, fourcc: str) -> None:
    assert applied(webcam(), Capture(rate_hz=rate), size)[0].layout.fourcc == fourcc


def test_grey_comes_before_more_bits_before_colour_before_jpeg() -> None:
    order = ["GREY", "Y16", "Y14", "Y12", "Y10", "YUYV", "UYVY", "NV12", "MJPG"]
    for k in range(len(order)):
        camera = StandInCamera(formats={fourcc: {VGA: [60.0]} for fourcc in reversed(["RGB3", *order[k:]])})
        assert applied(camera, Capture(bits=12), VGA)[0].layout.fourcc == order[k]


def test_a_format_is_taken_by_its_name_in_any_letters() -> None:
    assert applied(webcam(), Capture(pixel_format="mjpg"), VGA)[0].layout.fourcc == "MJPG"
    camera = StandInCamera(formats={"GREY": {VGA: []}, "Y12": {VGA: []}})
    assert applied(camera, Capture(pixel_format="Y12 "), VGA)[0].layout.fourcc == "Y12"


@pytest.mark.parametrize(
    ("capture", "size", "words"),
    [
        (Capture(pixel_format="Mono8"), VGA, "pixel_format Mono8: the camera lacks it; expected one of YUYV, MJPG"),
        (Capture(pixel_format="H264"), VGA, "pixel_format H264: is not read; expected one of YUYV, MJPG"),
        (Capture(), (800, 600), r"no images of 800x600; it has 640x480 1280x720 \(YUYV, MJPG\)"),
        (Capture(pixel_format="YUYV"), (800, 600), r"it has 640x480 1280x720 \(YUYV\)$"),
    ],
)
def test_what_it_lacks_is_refused_with_what_it_has(capture: Capture, size: tuple[int, int], words: str) -> None:
    camera = webcam()
    camera.formats = {**WEBCAM, "H264": {(800, 600): [30.0]}}
    with pytest.raises(InputError, match=words):
        applied(camera, capture, size)


def test_a_camera_without_a_format_that_is_read_is_refused() -> None:
    with pytest.raises(InputError, match="has pixel formats RGGB; expected one of GREY, Y16"):
        applied(StandInCamera(formats={"RGGB": {VGA: [30.0]}}), Capture(), VGA)


def test_sizes_may_be_a_range() -> None:
    camera = StandInCamera(formats={"GREY": {(64, 48): [60.0], VGA: [30.0]}}, span=(64, 1280, 8, 48, 1024, 2))
    got, _ = applied(camera, Capture(rate_hz=30.0), VGA)
    assert (got.layout.width, got.layout.height, got.rate_hz) == (640, 480, 30.0)
    for odd in ((641, 480), (640, 2048)):
        with pytest.raises(InputError, match=r"no images of .*; it has 64x48 to 1280x1024 \(GREY\)"):
            applied(camera, Capture(), odd)


def test_a_driver_that_lists_no_sizes_is_asked_by_setting_them() -> None:
    camera = webcam()
    camera.refuses = {abi.ENUM_FRAMESIZES: errno.ENOTTY}
    assert applied(camera, Capture(), HD)[0].layout.width == 1280
    with pytest.raises(InputError, match="made 640x480 of 800x600"):
        applied(camera, Capture(), (800, 600))


def test_16_bits_that_nobody_counted_are_said() -> None:
    camera = StandInCamera(formats={"Y16": {VGA: []}})
    assert "capture.bits" in applied(camera, Capture(), VGA)[1][0]
    assert applied(camera, Capture(bits=12), VGA)[1] == []


@pytest.mark.parametrize("capture", [Capture(trigger="Line1"), Capture(offset=(0, 8))])
def test_what_v4l2_has_no_word_for_is_refused(capture: Capture) -> None:
    with pytest.raises(InputError, match=r"cam: capture\.(trigger|offset)"):
        refuse_what_v4l2_lacks(capture, "cam")
    refuse_what_v4l2_lacks(Capture(trigger="free", offset=(0, 0)), "cam")
