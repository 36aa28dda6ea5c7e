"""V4L2 cameras from their buffers to frames: pixels, times, what is lost or late."""

import time

import cv2
import numpy as np
import pytest

from asterism.protocol.capture import Capture
from asterism.protocol.messages import Clock
from asterism.server.sources.camera import Taken, Waiting
from asterism.server.sources.v4l2 import abi
from asterism.server.sources.v4l2.camera import V4l2Device, V4l2Opener, v4l2_camera
from tests.rigs import make_camera, make_rig
from tests.sources.v4l2 import stand_in
from tests.sources.v4l2.stand_in import MONOTONIC_AT_START, StandInCamera, StandInSystem, grey_frame

SIZE = (64, 48)
NOW_NS = 50_000_000_000
RIG = make_rig(2, camera=make_camera(*SIZE, 80.0))
PLAIN = Capture()


def silent(text: str) -> None:
    """Nobody listens."""


def opened(camera: StandInCamera, said: list[str] | None = None, capture: Capture = PLAIN) -> V4l2Device:
    """A camera that was opened at `NOW_NS`, and what it says."""
    say = silent if said is None else said.append
    opener = V4l2Opener("/dev/video0", capture, SIZE, say, system=StandInSystem(video0=camera))
    opener.monotonic_ns = lambda: NOW_NS
    device = opener()
    assert device is not None
    return device


def one(camera: StandInCamera, capture: Capture = PLAIN) -> Taken:
    """The first frame of a camera."""
    taken = opened(camera, capture=capture).read()
    assert isinstance(taken, Taken)
    return taken


def put(
    camera: StandInCamera, data: bytes, stamp_ns: int = NOW_NS - 1_000_000, flags: int = MONOTONIC_AT_START
) -> None:
    camera.frames.append(stand_in.Frame(data, stamp_ns, 7, flags))


def padded(rows: np.ndarray, more: int) -> bytes:
    """Rows of bytes, each followed by so many that mean nothing."""
    return np.hstack([rows, np.full((len(rows), more), 99, np.uint8)]).tobytes()


@pytest.mark.parametrize("more", [0, 12])
@pytest.mark.parametrize(
    ("fourcc", "bits"), [("GREY", 8), ("NV12", 8), ("Y10", 10), ("Y12", 12), ("Y14", 14), ("Y16", 16)]
)
def test_grey_is_read_exactly_and_its_upper_eight_bits_kept(
    rng: np.random.Generator, fourcc: str, bits: int, more: int
) -> None:
    camera = StandInCamera(formats={fourcc: {SIZE: [60.0]}}, fourcc=fourcc, stride_more=more)
    image = rng.integers(0, 1 << bits, SIZE[::-1]).astype("<u2" if bits > 8 else np.uint8)
    put(camera, padded(image.view(np.uint8), more))
    taken = one(camera)
    np.testing.assert_array_equal(taken.image, image >> (bits - 8))
    assert taken.image.dtype == np.uint8


@pytest.mark.parametrize(("fourcc", "first"), [("YUYV", 0), ("UYVY", 1)])
def test_of_yuv_the_luminance_is_taken(rng: np.random.Generator, fourcc: str, first: int) -> None:
    camera = StandInCamera(formats={fourcc: {SIZE: [60.0]}}, fourcc=fourcc, stride_more=4)
    rows = rng.integers(0, 256, (SIZE[1], SIZE[0] * 2)).astype(np.uint8)
    put(camera, padded(rows, 4))
    taken = one(camera)
    np.testing.assert_array_equal(taken.image, rows[:, first::2])


def test_16_bit_pixels_that_hold_fewer_are_read_by_the_rigs_bits(rng: np.random.Generator) -> None:
    camera = StandInCamera(formats={"Y16": {SIZE: [60.0]}}, fourcc="Y16")
    image = rng.integers(0, 1 << 12, SIZE[::-1]).astype("<u2")
    put(camera, image.tobytes())
    taken = one(camera, Capture(bits=12))
    np.testing.assert_array_equal(taken.image, image >> 4)


def jpeg(seed: int, size: tuple[int, int] = SIZE) -> bytes:
    smooth = cv2.GaussianBlur(np.random.default_rng(seed).integers(0, 256, size[::-1]).astype(np.uint8), (0, 0), 4)
    return bytes(cv2.imencode(".jpg", cv2.cvtColor(smooth, cv2.COLOR_GRAY2BGR), [cv2.IMWRITE_JPEG_QUALITY, 95])[1])


def test_damaged_images_are_counted_said_and_skipped() -> None:
    camera = StandInCamera(formats={"MJPG": {SIZE: [60.0]}}, fourcc="MJPG")
    whole = jpeg(1)
    now_ns = time.monotonic_ns()
    for data in (whole[: len(whole) // 2], b"", jpeg(2, (32, 24)), whole[:300] + whole[-200:]):
        put(camera, data, now_ns)
    put(camera, whole, now_ns, MONOTONIC_AT_START | abi.BUF_ERROR)
    put(camera, whole + bytes(500), now_ns)
    said: list[str] = []
    source = v4l2_camera("0", RIG, said.append, StandInSystem(video0=camera))
    frame = next(source.frames())
    expected = cv2.imdecode(np.frombuffer(whole, np.uint8), cv2.IMREAD_GRAYSCALE)
    np.testing.assert_array_equal(frame.image, expected)
    assert source.unreadable == 5
    assert said == [
        "/dev/video0: damaged images, skipped: 1 so far; the last is cut off",
        "/dev/video0: damaged images, skipped: 2 so far; the last is no JPEG image",
        "/dev/video0: damaged images, skipped: 4 so far; the last is no whole image",
    ]


def test_a_buffer_that_is_too_short_is_damaged() -> None:
    camera = StandInCamera()
    put(camera, bytes(SIZE[0] * SIZE[1] - 1))
    said: list[str] = []
    assert opened(camera, said).read() == Waiting(unreadable=1)
    assert said == ["/dev/video0: damaged images, skipped: 1 so far; the last is cut off after 3071 of 3072 bytes"]


@pytest.mark.parametrize(
    ("flags", "capture", "middle_us"),
    [
        (MONOTONIC_AT_START, Capture(), 250.0),
        (abi.STAMP_MONOTONIC, Capture(), -250.0),
        (abi.STAMP_MONOTONIC, Capture(stamp="start", stamp_given=True), 250.0),
        (abi.STAMP_MONOTONIC, Capture(stamp="middle", stamp_given=True), 0.0),
        (MONOTONIC_AT_START, Capture(stamp="end", stamp_given=True), -250.0),
    ],
)
def test_mid_exposure_is_half_the_exposure_from_the_drivers_stamp(
    flags: int, capture: Capture, middle_us: float
) -> None:
    controls = {abi.EXPOSURE_AUTO: [0, 3, 1, 1], abi.EXPOSURE_ABSOLUTE: [1, 1000, 1, 5]}
    camera = StandInCamera(controls=controls)
    put(camera, bytes(SIZE[0] * SIZE[1]), NOW_NS - 20_000_000, flags)
    taken = one(camera, capture)
    assert (taken.clock, taken.mid_ns) == (Clock.DRIVER, NOW_NS - 20_000_000 + round(middle_us * 1e3))


@pytest.mark.parametrize(
    ("stamp_ns", "flags", "why"),
    [
        (NOW_NS - 1_000_000, abi.STAMP_AT_START, "are not of the monotonic clock"),
        (0, MONOTONIC_AT_START, "are zero"),
        (NOW_NS + 3_000_000, MONOTONIC_AT_START, "lie in the future, by 3 ms"),
        (NOW_NS - 8_000_000_000, MONOTONIC_AT_START, "are 8 s old when frames come"),
    ],
)
def test_stamps_that_cannot_be_are_said_once_and_arrival_counts(stamp_ns: int, flags: int, why: str) -> None:
    camera = StandInCamera()
    for _ in range(3):
        put(camera, bytes(SIZE[0] * SIZE[1]), stamp_ns, flags)
    put(camera, bytes(SIZE[0] * SIZE[1]))
    said: list[str] = []
    device = opened(camera, said)
    clocks = [taken.clock for _ in range(4) if isinstance(taken := device.read(), Taken)]
    assert clocks == [Clock.ARRIVAL] * 3 + [Clock.DRIVER]
    assert said == [f"/dev/video0: the driver's time stamps {why}; such frames are stamped when they arrive"]


def test_lost_frames_show_in_the_numbers_and_are_counted() -> None:
    camera = StandInCamera()
    camera.frames.extend(grey_frame(number) for number in (0xFFFFFFFE, 0xFFFFFFFF, 0, 3, 4, 9, 2))
    said: list[str] = []
    device = opened(camera, said)
    missed = [taken.missed for _ in range(7) if isinstance(taken := device.read(), Taken)]
    assert missed == [0, 0, 0, 2, 0, 4, 0]
    assert [line for line in said if "lost on their way" in line and line.endswith(("2 so far", "6 so far"))] == said[
        1:
    ]


def test_who_comes_late_gets_the_newest_and_what_was_missed_is_told_apart() -> None:
    camera = StandInCamera()
    said: list[str] = []
    device = opened(camera, said)
    camera.frames.append(grey_frame(1))
    device.read()
    camera.ahead = True
    camera.frames.extend(grey_frame(number) for number in (2, 3, 9))  # the driver had no buffer for those between
    taken = device.read()
    assert isinstance(taken, Taken)
    assert (taken.image[0, 0], taken.missed) == (9, 2 + 5)
    camera.frames.append(grey_frame(12))  # nor for these
    device.read()
    late = "/dev/video0: frames not taken in time (this machine is busy)"
    assert [line for line in said if "stamps" not in line] == [f"{late}: {count} so far" for count in (1, 2, 7)]


def test_buffers_are_returned_and_images_stay_when_the_driver_writes_again() -> None:
    camera = StandInCamera(endless=grey_frame)
    device = opened(camera)
    images = [taken.image for _ in range(20) if isinstance(taken := device.read(), Taken)]
    assert [int(image[5, 5]) for image in images] == list(range(20))
    device.close()
    assert camera.streams is None


@pytest.mark.parametrize(("rate", "least_s", "most_s"), [(30.0, 0.5, 1.0), (1.0, 2.0, 4.0)])
def test_a_silent_camera_is_gone_within_a_second_and_a_slow_one_is_waited_for(
    rate: float, least_s: float, most_s: float
) -> None:
    camera = StandInCamera(formats={"GREY": {SIZE: [rate]}}, rate=rate)
    put(camera, bytes(SIZE[0] * SIZE[1]))
    system = StandInSystem(video0=camera)
    opener = V4l2Opener("/dev/video0", PLAIN, SIZE, silent, system=system)
    now_ns = [NOW_NS]
    opener.monotonic_ns = lambda: now_ns[0]
    device = opener()
    assert device is not None
    assert isinstance(device.read(), Taken)
    for after_s, read in ((least_s, Waiting()), (most_s, None)):
        now_ns[0] = NOW_NS + round(after_s * 1e9)
        assert device.read() == read
    assert max(system.waits) < 0.5, "whoever wants to close it does not wait for long"
