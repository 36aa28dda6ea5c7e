"""GenICam cameras, by Aravis' own emulated one over real GigE Vision: frames, ids, refusals, unplugging."""

import itertools
import socket
import threading
from collections.abc import Iterator

import numpy as np
import pytest

from asterism.protocol.errors import InputError, WorldError
from asterism.protocol.messages import Clock
from asterism.server.sources.background import wait_for_background
from asterism.server.sources.camera import Camera
from asterism.server.sources.genicam import aravis
from asterism.server.sources.genicam import camera as genicam
from asterism.server.sources.genicam.aravis_stream import BUFFERS
from asterism.server.sources.genicam.camera import GenicamCamera, GenicamDevice
from asterism.server.sources.genicam.listing import Place, list_genicam
from asterism.server.sources.open_source import open_source, refuse_endless
from tests.sources.genicam.fake_camera import ADDRESS, SERIAL, FakeCamera, fake_camera, truth_of
from tests.sources.genicam.gige_film import (
    BY_ADDRESS,
    FILM,
    HEIGHT,
    WIDTH,
    assert_is_of_the_film,
    frames,
    number_of,
    rig_with,
    silent,
)


@pytest.fixture(scope="module")
def emulator(tmp_path_factory: pytest.TempPathFactory) -> Iterator[FakeCamera]:
    with fake_camera(tmp_path_factory.mktemp("camera"), FILM, "--truth") as camera:
        yield camera


@pytest.fixture
def plugged_in(emulator: FakeCamera, monkeypatch: pytest.MonkeyPatch) -> Iterator[FakeCamera]:
    """Nobody has it, whatever became of the test before."""
    devices: list[GenicamDevice] = []
    opened = GenicamCamera._opened

    def noted(camera: GenicamCamera, place: Place) -> GenicamDevice:
        devices.append(opened(camera, place))
        return devices[-1]

    monkeypatch.setattr(GenicamCamera, "_opened", noted)
    yield emulator
    if emulator.process.poll() is not None:
        emulator.start()
    for device in devices:
        if device._closing is None:
            device.close()
    wait_for_background(10.0)


def beside_losses(said: list[str]) -> list[str]:
    """A machine that is busy may lose a frame of the emulator's: that is said, too."""
    return [text for text in said if "frames are lost" not in text]


def test_it_is_listed_and_opened_by_any_of_its_names(plugged_in: FakeCamera) -> None:
    (found,) = [one for one in list_genicam().cameras if one.serial == SERIAL]
    assert found == (f"genicam:{SERIAL}", "Aravis", "Fake", SERIAL, (ADDRESS, ADDRESS, SERIAL))
    for name in (found.name, BY_ADDRESS):
        camera = open_source(name, rig_with(), silent)
        assert isinstance(camera, Camera)
        assert len(frames(camera, 3)) == 3
        wait_for_background(2.0)


def test_frames_come_as_they_were_sent_each_accounted_for_with_the_cameras_time(plugged_in: FakeCamera) -> None:
    """On a machine with time to spare none is lost; a busy one may lose some, and then each is counted."""
    camera = open_source(BY_ADDRESS, rig_with(), silent)
    before = plugged_in.sent()
    taken = frames(camera, 120)
    numbers = [number_of(frame.image) for frame in taken]
    steps = (np.diff([before - 1, *numbers]) - 1) % len(FILM) + 1
    assert steps.sum() < len(FILM)  # forwards, less than once round
    left_out = steps - 1
    assert left_out[1:].sum() <= camera.unreadable + camera.missed <= left_out.sum()
    for frame in taken:
        assert_is_of_the_film(frame.image)
        assert frame.clock == Clock.CAMERA
    stamps = np.array([frame.exposed_ns for frame in taken])
    assert (np.diff(stamps) > 0).all()
    # Mid-exposure: half an exposure after the stamp. How late the first packet is at least is up to the machine.
    truth = np.array([camera.clock.at_ns(truth_of(frame.image)) for frame in taken])
    assert np.median(np.abs((stamps - truth - 200_000)[30:])) < 50_000_000


@pytest.mark.parametrize(("stamp", "middle_us"), [("start", 200.0), ("middle", 0.0), ("end", -200.0)])
def test_the_stamp_is_what_the_rig_says(plugged_in: FakeCamera, stamp: str, middle_us: float) -> None:
    device = GenicamCamera(ADDRESS, rig_with(stamp=stamp).capture, None, silent).open()
    assert device is not None
    assert device._to_middle * device._applied.exposure_ns == middle_us * 1e3
    device.close()


def test_what_others_send_is_not_taken_for_frames(plugged_in: FakeCamera) -> None:
    """While a stream is opened the host's other traffic goes on."""
    done = threading.Event()

    def chatter() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as both:
            both.bind((ADDRESS, 0))
            while not done.wait(0.001):
                for _ in range(20):
                    both.sendto(bytes(200), both.getsockname())
                    both.recv(500)

    thread = threading.Thread(target=chatter)
    thread.start()
    try:
        for _ in range(4):
            said: list[str] = []
            stream = open_source(BY_ADDRESS, rig_with(trigger="software"), said.append).frames()
            next(stream)
            stream.close()
            wait_for_background(2.0)
            # A frame of the camera's that is not whole misses packets; what never was one does not.
            assert not any("came incomplete" in text and "missing)" not in text for text in said)
    finally:
        done.set()
        thread.join()


def test_images_that_somebody_holds_are_left_alone(plugged_in: FakeCamera) -> None:
    """Many more than Aravis has memory for; only the first are not copied."""
    stream = open_source(BY_ADDRESS, rig_with(), silent).frames()
    held = [next(stream).image for _ in range(3 * BUFFERS)]
    copies = [image.copy() for image in held]
    list(itertools.islice(stream, 2 * BUFFERS))
    stream.close()
    wait_for_background(2.0)
    for image, copy in zip(held, copies, strict=True):
        assert_is_of_the_film(image)
        np.testing.assert_array_equal(image, copy)
    assert not held[0].flags.owndata
    assert held[-1].flags.owndata


def test_unplugged_and_back_with_all_settings(plugged_in: FakeCamera) -> None:
    said: list[str] = []
    camera = open_source(f"genicam:{SERIAL}", rig_with(gain=3.0), said.append)
    stream = camera.frames()
    for _ in range(20):
        next(stream)
    plugged_in.unplug()
    told = threading.Thread(target=lambda: plugged_in.start() if wait_for(said, "vanished") else None)
    told.start()
    try:
        frame = next(frame for frame in stream if any("is back" in text for text in said))
    finally:
        told.join()
    assert beside_losses(said) == [
        f"genicam:{SERIAL}: the camera vanished; waiting for it",
        f"genicam:{SERIAL}: the camera is back",
    ]
    assert camera.problem == ""
    assert frame.image.shape == (HEIGHT, WIDTH)
    settings = camera._device._camera  # type: ignore[union-attr]
    assert (settings.value("exposure_time"), settings.value("gain")) == (400.0, 3.0)
    assert settings.region() == (0, 0, WIDTH, HEIGHT)
    stream.close()


def wait_for(said: list[str], word: str) -> bool:
    poll = threading.Event()
    return any(poll.wait(0.02) or any(word in text for text in said) for _ in range(1000))


def test_a_camera_that_another_program_has_is_said_to_be_taken(
    plugged_in: FakeCamera, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(genicam, "HELD_S", 0.3)
    mine = open_source(BY_ADDRESS, rig_with(), silent)
    with pytest.raises(WorldError, match=f"{BY_ADDRESS}: the camera is in use by another program; it serves one"):
        open_source(BY_ADDRESS, rig_with(), silent)
    assert len(frames(mine, 3)) == 3  # and it is not disturbed


def test_a_camera_that_another_program_took_is_said_and_taken_up_when_it_is_free(
    plugged_in: FakeCamera, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nor is Aravis asked, which would not notice: the camera sends to somebody else."""
    said: list[str] = []
    camera = open_source(BY_ADDRESS, rig_with(), said.append)
    assert isinstance(camera, Camera)
    stream = camera.frames()
    next(stream)
    leave = aravis.checked("arv_gv_device_leave_control", aravis.c_int, aravis.c_void_p)
    assert camera._device is not None
    mine = camera._device._camera
    mine.stop()  # as cameras do that lose their program; the emulator would go on, and go on sending to us
    leave(mine._device())
    other = GenicamCamera(ADDRESS, rig_with().capture, None, silent).open()
    assert other is not None
    monkeypatch.setattr(mine, "is_ours", lambda: True)
    until_back = (frame for frame in stream if any("is back" in text for text in said))
    reader = threading.Thread(target=next, args=(until_back,))
    reader.start()
    try:
        assert wait_for(said, "in use")
        other.close()
        reader.join(20.0)
    finally:
        camera.close()
        reader.join(10.0)
    assert not reader.is_alive()
    stream.close()
    assert beside_losses(said) == [
        f"{BY_ADDRESS}: the camera vanished; waiting for it",
        f"{BY_ADDRESS}: the camera is in use by another program; it serves one at a time; waiting for it",
        f"{BY_ADDRESS}: the camera is back",
    ]


def test_a_software_trigger_is_given_frame_by_frame(plugged_in: FakeCamera) -> None:
    before = plugged_in.sent()
    assert len(frames(open_source(BY_ADDRESS, rig_with(trigger="software"), silent), 10)) == 10
    assert plugged_in.sent() - before <= 12


def test_a_camera_that_waits_for_its_trigger_says_so_and_nothing_hangs(
    plugged_in: FakeCamera, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The emulator makes up the triggers of its line itself; those of the software can be kept from it."""
    monkeypatch.setattr(genicam, "STUCK_S", 0.5)
    monkeypatch.setattr(genicam.ArvCamera, "trigger", lambda _: None)
    said: list[str] = []
    camera = open_source(BY_ADDRESS, rig_with(trigger="software"), said.append)
    assert isinstance(camera, Camera)
    reader = threading.Thread(target=lambda: list(camera.frames()))
    reader.start()
    try:
        told = wait_for(said, "trigger")
        problem = camera.problem
    finally:
        camera.close()
        reader.join(20.0)
    assert told
    assert said == [problem] == [f"{BY_ADDRESS}: it waits for its trigger (software)"]
    assert not reader.is_alive()


def test_no_such_camera_tells_what_there_is(plugged_in: FakeCamera) -> None:
    with pytest.raises(InputError, match=rf"genicam:SN7: there is no such camera; there is .*serial {SERIAL}, at"):
        open_source("genicam:SN7", None, silent)
    with pytest.raises(InputError, match=r"genicam:127\.0\.0\.77: no camera answers at this address; there is .*SN42"):
        open_source("genicam:127.0.0.77", None, silent)
    with pytest.raises(InputError, match="genicam:: expected a camera's serial number, IP address or index behind it"):
        open_source("genicam:", None, silent)


@pytest.mark.parametrize(
    ("capture", "words"),
    [
        ({"exposure_us": 5.0}, "capture.exposure_us 5: the camera accepts 10 to 1e[+]07 us"),
        ({"gain": 20.0}, "capture.gain 20: the camera accepts 0 to 10"),
        ({"rate_hz": 2000.0}, "capture.rate 2000: the camera accepts 0.1 to 1000 Hz as it is set"),
        (
            {"size": (4000, 3000)},
            r"capture.size \[4000, 3000\]: the camera's width is 1 to 2048 px; .*height is 1 to 2048",
        ),
        ({"pixel_format": "Mono12p"}, "capture.pixel_format Mono12p: is none of the camera's; it has Mono8, Mono16"),
        ({"pixel_format": "RGB8"}, "capture.pixel_format RGB8: is no grey that can be read; it has Mono8, Mono16"),
        ({"trigger": "Line9"}, "capture.trigger Line9: is none of the camera's; it accepts free, software, Line0"),
        ({"trigger": "action"}, "capture.trigger action: is none of the camera's; it accepts free, software, Line0"),
        ({"gain": 20.0, "exposure_us": 5.0}, "exposure_us 5: the camera accepts .*; genicam:.*: capture.gain 20: the"),
    ],
)
def test_settings_that_the_camera_refuses(plugged_in: FakeCamera, capture: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        open_source(BY_ADDRESS, rig_with(**capture), silent)


def test_without_the_library_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(aravis, "LIBRARY", "libnowhere.so")
    monkeypatch.setattr(aravis, "function", lambda *_: aravis._loaded("libnowhere.so"))
    assert list_genicam() == ([], aravis.MISSING)
    with pytest.raises(WorldError, match=r"Aravis is not installed, which .*: apt install libaravis-0\.8-0"):
        open_source("genicam:0", None, silent)


def test_what_has_no_end_is_not_for_commands_that_need_one() -> None:
    with pytest.raises(InputError, match="genicam:0: has no end; locate takes"):
        refuse_endless("genicam:0", "locate")
