"""Where frames come from: formats, order, refusals, a camera that vanishes, threads that keep or drop."""

import itertools
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from asterism.protocol.capture import Capture
from asterism.protocol.errors import InputError, WorldError
from asterism.protocol.messages import Clock
from asterism.protocol.rig import Rig
from asterism.server.chain.frame import Frame
from asterism.server.service.threads import Feed, Ticker
from asterism.server.sources.camera import Camera, Taken
from asterism.server.sources.images import UnreadableImage, read_pages, to_grey8
from asterism.server.sources.open_source import open_source
from asterism.server.sources.paced import paced
from asterism.server.sources.session_clock import SessionClock
from asterism.server.sources.simulated import Simulated
from asterism.server.sources.video import VideoFile
from tests.rigs import make_camera, make_rig

SMALL = make_camera(64, 48, 80.0)
RIG = make_rig(2, camera=SMALL)


def silent(text: str) -> None:
    """Nobody listens."""


def read_image(path: Path, bits: int | None) -> NDArray[np.uint8]:
    """The one image of a file."""
    ((name, image),) = read_pages(path, lambda *_: None)
    assert name == path.name
    return to_grey8(image, bits, name)


def pattern(seed: int) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, (48, 64)).astype(np.uint8)


@pytest.mark.parametrize("name", ["a.png", "a.tif", "a.tiff", "a.bmp", "a.PNG"])
def test_lossless_images_are_read_exactly(tmp_path: Path, name: str) -> None:
    cv2.imwrite(str(tmp_path / name), pattern(1))
    np.testing.assert_array_equal(read_image(tmp_path / name, None), pattern(1))


def test_colour_jpeg_and_alpha_are_converted(tmp_path: Path) -> None:
    smooth = cv2.GaussianBlur(pattern(2), (0, 0), 4)
    colour = cv2.cvtColor(smooth, cv2.COLOR_GRAY2BGR)
    cv2.imwrite(str(tmp_path / "a.jpg"), colour, [cv2.IMWRITE_JPEG_QUALITY, 98])
    cv2.imwrite(str(tmp_path / "b.png"), cv2.cvtColor(smooth, cv2.COLOR_GRAY2BGRA))
    assert np.abs(read_image(tmp_path / "a.jpg", None).astype(int) - smooth).max() <= 4
    np.testing.assert_array_equal(read_image(tmp_path / "b.png", None), smooth)


@pytest.mark.parametrize(("bits", "shift"), [(None, 8), (16, 8), (12, 4), (10, 2), (8, 0)])
def test_16_bit_images_keep_their_upper_eight_bits(tmp_path: Path, bits: int | None, shift: int) -> None:
    values = np.linspace(0, 2 ** (8 + shift) - 1, 48 * 64).astype(np.uint16).reshape(48, 64)
    cv2.imwrite(str(tmp_path / "a.png"), values)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png", bits), values >> shift)


def test_values_beyond_the_bits_saturate() -> None:
    assert to_grey8(np.full((2, 2), 5000, np.uint16), 12, "x").tolist() == [[255, 255], [255, 255]]


def test_float_pixels_are_refused() -> None:
    with pytest.raises(InputError, match=r"x\.tif: the image is float32 of shape \(2, 2\), expected 8 or 16 bit"):
        to_grey8(np.zeros((2, 2), np.float32), None, "x.tif")


@pytest.mark.parametrize("extension", ["png", "jpg", "bmp", "tiff"])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.95])
def test_cut_off_images_are_noticed(tmp_path: Path, extension: str, share: float) -> None:
    whole = tmp_path / f"whole.{extension}"
    cv2.imwrite(str(whole), pattern(3))
    data = whole.read_bytes()
    part = tmp_path / f"part.{extension}"
    part.write_bytes(data[: int(share * len(data))])
    with pytest.raises(UnreadableImage, match=r"is cut off|is no whole image|is empty"):
        read_image(part, None)


def test_a_folder_is_read_in_natural_order_and_what_cannot_be_read_is_skipped_and_said(tmp_path: Path) -> None:
    for number in (1, 2, 10, 20):
        cv2.imwrite(str(tmp_path / f"frame{number}.png"), pattern(number))
    (tmp_path / "frame3.png").write_bytes((tmp_path / "frame2.png").read_bytes()[:900])
    (tmp_path / "notes.txt").write_text("not an image")
    said: list[str] = []
    source = open_source(str(tmp_path), RIG, said.append)
    frames = list(source.frames())
    assert [frame.name for frame in frames] == ["frame1.png", "frame2.png", "frame10.png", "frame20.png"]
    # The unreadable one keeps its place in time.
    assert [frame.exposed_ns for frame in frames] == [round(k * 1e9 / 60) for k in (0, 1, 3, 4)]
    assert source.unreadable == 1
    assert said == [f"{tmp_path / 'frame3.png'}: is cut off; skipped"]


def test_globs_and_single_images(tmp_path: Path) -> None:
    for name in ("a1.png", "a2.png", "b1.png"):
        cv2.imwrite(str(tmp_path / name), pattern(1))
    assert [frame.name for frame in open_source(f"{tmp_path}/a*.png", RIG, silent).frames()] == ["a1.png", "a2.png"]
    assert [frame.name for frame in open_source(f"{tmp_path}/b1.png", RIG, silent).frames()] == ["b1.png"]


def test_images_of_another_size_are_refused(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((100, 100), np.uint8))
    with pytest.raises(InputError, match=r"a\.png: the image is 100x100, expected 64x48, the size that camera 'test'"):
        list(open_source(str(tmp_path), RIG, silent).frames())


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{}/empty", "empty: holds no images, expected files ending in .png"),
        ("{}/*.png", r"\*.png: holds no images"),
        ("{}/nowhere", "nowhere: there is no such source; expected a camera"),
        ("{}/film.mp4", "film.mp4: is no video that can be read"),
        ("{}/poses-0001.mcap", "is one file of a recording, expected the recording's folder"),
        ("/dev/videoX", "/dev/videoX: expected a V4L2 camera such as 0 or /dev/video0"),
    ],
)
def test_wrong_sources_are_refused(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "film.mp4").write_bytes(b"no film")
    (tmp_path / "poses-0001.mcap").write_bytes(b"")
    with pytest.raises(InputError, match=words):
        open_source(text.format(tmp_path), RIG, silent)


def test_a_folder_in_which_nothing_can_be_read_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"no image")
    with pytest.raises(InputError, match="none of its 1 images can be read"):
        list(open_source(str(tmp_path), RIG, silent).frames())


def test_a_video_is_read_with_its_own_rate(tmp_path: Path) -> None:
    path = tmp_path / "film.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"FFV1"), 25.0, (64, 48), isColor=False)
    for k in range(5):
        writer.write(pattern(k))
    writer.release()
    source = open_source(str(path), RIG, silent)
    assert isinstance(source, VideoFile)
    frames = list(source.frames())
    assert (source.rate_hz, source.length, len(frames)) == (25.0, 5, 5)
    assert [frame.exposed_ns for frame in frames] == [k * 40_000_000 for k in range(5)]
    np.testing.assert_array_equal(frames[3].image, pattern(3))


def test_the_simulator_is_a_source() -> None:
    frames = list(Simulated(make_rig(2), count=3).frames())
    assert [frame.index for frame in frames] == [0, 1, 2]
    assert frames[0].image.shape == (1024, 1280)


class FakeDevice:
    """A camera that delivers some images, then is gone."""

    def __init__(self, images: int) -> None:
        self.left = images
        self.closed = False

    def read(self) -> Taken | None:
        self.left -= 1
        return Taken(pattern(self.left)) if self.left >= 0 else None

    def close(self) -> None:
        self.closed = True


def test_a_camera_that_vanishes_is_said_waited_for_and_taken_up_again() -> None:
    devices: list[FakeDevice | None] = [FakeDevice(2), None, None, FakeDevice(3)]
    opened: list[FakeDevice] = []

    def open_device() -> FakeDevice | None:
        device = devices.pop(0) if devices else None
        if device is not None:
            opened.append(device)
        return device

    said: list[str] = []
    camera = Camera("/dev/video9", open_device, RIG, said.append)
    camera.retry_s = 0.001
    frames = list(itertools.islice(camera.frames(), 5))
    assert [frame.index for frame in frames] == [0, 1, 2, 3, 4]
    assert said == ["/dev/video9: the camera vanished; waiting for it", "/dev/video9: the camera is back"]
    assert opened[0].closed
    assert camera.problem == ""
    assert all(frame.arrived_ns == frame.exposed_ns for frame in frames)


def test_frames_carry_mid_exposure_by_the_clock_that_tells_less_the_delay() -> None:
    rig = Rig(SMALL, RIG.robots, capture=Capture(delay_us=250.0))
    began_ns = time.monotonic_ns()
    taken = [Taken(pattern(0), began_ns - 7_000_000, Clock.CAMERA), Taken(pattern(1)), None]
    device = FakeDevice(0)
    device.read = lambda: taken.pop(0)  # type: ignore[method-assign]
    camera = Camera("cam", lambda: device, rig, silent)
    stamped, unstamped = itertools.islice(camera.frames(), 2)
    assert (stamped.clock, unstamped.clock) == (Clock.CAMERA, Clock.ARRIVAL)
    assert stamped.exposed_ns == camera.clock.at_ns(began_ns - 7_000_000, stamped.session) - 250_000
    assert stamped.arrived_ns > stamped.exposed_ns
    assert unstamped.exposed_ns == unstamped.arrived_ns - 250_000


def test_a_camera_that_does_not_open_is_the_worlds_fault() -> None:
    with pytest.raises(WorldError, match=r"/dev/video9: the camera does not open \(tried V4L2 device /dev/video9\)"):
        Camera("/dev/video9", lambda: None, RIG, silent)


def test_camera_images_of_another_size_are_refused() -> None:
    device = FakeDevice(1)
    device.read = lambda: Taken(np.zeros((10, 10), np.uint8))  # type: ignore[method-assign]
    with pytest.raises(InputError, match="the image is 10x10, expected 64x48"):
        next(Camera("cam", lambda: device, RIG, silent).frames())


def numbered(count: int) -> Iterator[Frame]:
    for k in range(count):
        yield Frame(pattern(k), k * 10_000_000, k)


def test_paced_frames_keep_their_spacing_and_are_stamped_when_played() -> None:
    before = time.time_ns()
    stamps = [frame.exposed_ns for frame in paced(numbered(6), None, lambda: False, SessionClock())]
    # Never early; how late is up to the machine.
    assert all(stamp >= before + k * 10_000_000 for k, stamp in enumerate(stamps))
    slow = (Frame(pattern(k), k * 10**10, k) for k in range(6))
    faster = [frame.exposed_ns for frame in paced(slow, 1000.0, lambda: False, SessionClock())]
    assert faster[-1] - faster[0] < 5 * 10**9


def test_where_the_clock_was_set_a_paced_film_goes_on_at_once() -> None:
    """An hour forwards, and back again; frames ten seconds apart are waited for where all of them are."""
    steps_ns = [0, 10_000_000, 3_600_000_000_000, 10_000_000, -3_600_000_000_000, 10_000_000]
    film = (Frame(pattern(k), int(at), k) for k, at in enumerate(np.cumsum(steps_ns)))
    began = time.monotonic()
    assert len(list(paced(film, None, lambda: False, SessionClock()))) == len(steps_ns)
    assert 0.045 < time.monotonic() - began < 3.0
    rare, late = (Frame(pattern(k), k * 10**10, k) for k in range(2)), time.monotonic() + 0.3
    assert [frame.index for frame in paced(rare, None, lambda: time.monotonic() > late, SessionClock())] == [0]


def test_pacing_ends_when_it_is_told_to() -> None:
    played = []
    for frame in paced(numbered(1000), 1.0, lambda: len(played) >= 1, SessionClock()):
        played.append(frame)
    assert len(played) == 1


def test_a_files_frames_are_all_handed_on_in_order() -> None:
    feed = Feed(numbered(50), live=False)
    taken = []
    while not feed.finished:
        frame = feed.next(1.0)
        if frame is not None:
            taken.append(frame.index)
    assert taken == list(range(50))
    assert feed.dropped == 0
    feed.close()


def test_of_a_live_sources_frames_the_newest_wins_and_drops_are_counted() -> None:
    delivered = threading.Event()

    def burst() -> Iterator[Frame]:
        yield from numbered(5)
        delivered.set()

    feed = Feed(burst(), live=True)
    assert delivered.wait(5.0)
    frame = feed.next(1.0)
    assert frame is not None
    assert frame.index == 4
    assert feed.dropped == 4
    assert feed.next(0.01) is None
    assert feed.finished
    feed.close()


def test_a_sources_exception_is_raised_where_frames_are_taken() -> None:
    def broken() -> Iterator[Frame]:
        yield from numbered(2)
        raise InputError("the third frame is bad")

    feed = Feed(broken(), live=False)
    assert [feed.next(1.0).index for _ in range(2)] == [0, 1]  # type: ignore[union-attr]
    with pytest.raises(InputError, match="the third frame is bad"):
        feed.next(0.5)


def test_a_ticker_calls_until_it_is_closed() -> None:
    called = threading.Event()
    ticker = Ticker(called.set, 0.001)
    assert called.wait(5.0)
    ticker.close()
    called.clear()
    assert not called.is_set()


def test_a_ticker_goes_on_where_what_it_calls_fails(caplog: pytest.LogCaptureFixture) -> None:
    calls, often = [], threading.Event()

    def fail() -> None:
        calls.append(0)
        if len(calls) == 3:
            often.set()
        raise ZeroDivisionError("meant")

    ticker = Ticker(fail, 0.001)
    assert often.wait(5.0)
    ticker.close()
    assert all(record.exc_info is not None for record in caplog.records)
    assert len(caplog.records) == len(calls)


def test_capture_settings_reach_the_sources_rate() -> None:
    rig = Rig(SMALL, RIG.robots, capture=Capture(rate_hz=120.0))
    assert Simulated(rig, count=1).rate_hz == 120.0
