"""V4L2 cameras by their names: opened, refused, lost, and found again wherever they are plugged in."""

import errno
import itertools
from collections.abc import Iterator
from pathlib import Path

import pytest

from asterism.protocol.capture import Capture
from asterism.protocol.errors import InputError, WorldError
from asterism.protocol.rig import Rig
from asterism.server.chain.frame import Frame
from asterism.server.sources.camera import Camera
from asterism.server.sources.v4l2 import abi
from asterism.server.sources.v4l2.camera import V4l2Opener, v4l2_camera
from asterism.server.sources.v4l2.node import Kernel
from asterism.server.sources.v4l2.place import best_names, is_v4l2, name_of
from tests.rigs import make_camera, make_rig
from tests.sources.v4l2.stand_in import StandInCamera, StandInSystem, grey_frame

SIZE = (64, 48)
RIG = make_rig(2, camera=make_camera(*SIZE, 80.0))
PLAIN = Capture()


def silent(text: str) -> None:
    """Nobody listens."""


def frames_of(source: Camera) -> Iterator[Frame]:
    source.retry_s = 0.001
    return source.frames()


def opened(system: StandInSystem, text: str, said: list[str], capture: Capture = PLAIN) -> Camera:
    rig = Rig(RIG.camera, RIG.robots, capture=capture)
    return v4l2_camera(text, rig, said.append, system)


def test_a_camera_pulled_out_is_found_under_another_number_by_its_serial_with_all_settings() -> None:
    controls = {abi.EXPOSURE_ABSOLUTE: [1, 1000, 1, 200], abi.EXPOSURE_AUTO: [0, 3, 1, 3], abi.GAIN: [0, 9, 1, 0]}
    hardware = ("046d:082d:ABC", "0")

    def plugged(bus: str) -> StandInCamera:
        fresh = {number: list(values) for number, values in controls.items()}
        return StandInCamera(bus=bus, hardware=hardware, controls=fresh, endless=grey_frame)

    stranger = StandInCamera(bus="usb-2", hardware=("046d:082d:XYZ", "0"), endless=grey_frame)
    camera = plugged("usb-1")
    system = StandInSystem(video0=camera, video1=stranger)
    said: list[str] = []
    source = opened(system, "0", said, Capture(exposure_us=500.0, gain=3.0))
    frames = frames_of(source)
    assert [frame.index for frame in itertools.islice(frames, 3)] == [0, 1, 2]
    camera.unplug()
    back = plugged("usb-7")
    system.cameras |= {"/dev/video0": stranger, "/dev/video1": camera, "/dev/video4": back}
    assert next(frames).index == 3
    assert said == [
        "/dev/video0: the camera vanished; waiting for it",
        "/dev/video0: the camera is /dev/video4 by now",
        "/dev/video0: the camera is back",
    ]
    assert source.name == "/dev/video0"
    assert (back.controls[abi.EXPOSURE_ABSOLUTE][3], back.controls[abi.GAIN][3]) == (5, 3)
    assert stranger.streams is None


@pytest.mark.parametrize("serial", ["", "dead:beef:SN0001"])
def test_without_a_serial_of_its_own_the_same_socket_is_the_same_camera(serial: str) -> None:
    """Two of one make, without numbers or with the same: the other one is never taken for it."""
    ours, twin = (StandInCamera(bus=bus, hardware=(serial, "0"), endless=grey_frame) for bus in ("usb-1", "usb-2"))
    system = StandInSystem(video0=ours, video2=twin)
    opener = V4l2Opener("/dev/video0", Capture(), SIZE, silent, system=system)
    device = opener()
    assert device is not None
    ours.unplug()
    assert device.read() is None
    device.close()
    system.cameras["/dev/video0"] = twin
    assert opener() is None
    system.cameras["/dev/video5"] = StandInCamera(bus="usb-1", hardware=(serial, "0"))
    assert opener() is not None
    assert system.cameras["/dev/video5"].streams is not None


def test_another_node_of_the_same_camera_is_not_taken_for_it() -> None:
    hardware = "8086:0b07:77"
    depth, colour = (StandInCamera(hardware=(hardware, part), endless=grey_frame) for part in ("0", "2"))
    system = StandInSystem(video0=depth, video1=colour)
    opener = V4l2Opener("/dev/video0", Capture(), SIZE, silent, system=system)
    assert opener() is not None
    depth.unplug()
    assert opener() is None


def test_a_link_is_followed_anew_every_time_and_keeps_its_name(tmp_path: Path) -> None:
    link = tmp_path / "usb-cam-index0"
    link.symlink_to("/dev/video90")
    first, second = StandInCamera(endless=grey_frame), StandInCamera(endless=grey_frame)
    system = StandInSystem(video90=first)
    said: list[str] = []
    source = opened(system, str(link), said)
    frames = frames_of(source)
    next(frames)
    first.unplug()
    link.unlink()
    link.symlink_to("/dev/video93")
    system.cameras["/dev/video93"] = second
    assert next(frames).index == 1
    assert said == [
        f"{link}: the camera vanished; waiting for it",
        f"{link}: the camera is /dev/video93 by now",
        f"{link}: the camera is back",
    ]
    assert source.name == str(link)


def test_where_nobody_asked_for_a_size_the_first_one_stays() -> None:
    formats = {"GREY": {(32, 24): [30.0], SIZE: [30.0]}}
    system = StandInSystem(video0=StandInCamera(formats=formats, size=SIZE, endless=grey_frame))
    opener = V4l2Opener("/dev/video0", PLAIN, None, silent, system=system)
    assert opener() is not None
    system.cameras["/dev/video0"].unplug()
    system.cameras["/dev/video0"] = StandInCamera(formats=formats, size=(32, 24), endless=grey_frame)
    device = opener()
    assert device is not None
    taken = device.read()
    assert taken is not None
    assert taken.image.shape == SIZE[::-1]


def test_what_keeps_a_camera_from_coming_back_is_said_once_and_stands_in_its_problem() -> None:
    camera = StandInCamera(endless=grey_frame)
    system = StandInSystem(video0=camera)
    said: list[str] = []
    source = opened(system, "0", said)
    frames = frames_of(source)
    next(frames)
    tries = itertools.count()

    def taken_by_another() -> list[str]:
        """Let go after a few tries."""
        camera.there, camera.streams = True, 1 if next(tries) < 5 else None
        assert next(tries) < 10 or source.problem
        return ["/dev/video0"]

    system.nodes = taken_by_another  # type: ignore[method-assign]
    camera.unplug()
    next(frames)
    assert [line.partition("(")[0] for line in said] == [
        "/dev/video0: the camera vanished; waiting for it",
        "/dev/video0: the camera cannot be set: another program has /dev/video0 ",
        "/dev/video0: the camera is back",
    ]


def test_a_camera_that_comes_back_without_the_size_is_the_worlds_fault() -> None:
    system = StandInSystem(video0=StandInCamera(endless=grey_frame))
    opener = V4l2Opener("/dev/video0", PLAIN, SIZE, silent, system=system)
    assert opener() is not None
    system.cameras["/dev/video0"] = StandInCamera(formats={"GREY": {(32, 24): [30.0]}})
    with pytest.raises(WorldError, match="no images of 64x48; it has 32x24"):
        opener()


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (errno.EACCES, "does not open: no permission for /dev/video0; as root: usermod -aG video USER"),
        (errno.EBUSY, "does not open: another program has /dev/video0"),
        (errno.ENXIO, "does not open: there is no /dev/video0; is it plugged in?"),
        (errno.EIO, "does not open: /dev/video0: Input/output error"),
    ],
)
def test_a_camera_that_does_not_open_is_the_worlds_fault(code: int, words: str) -> None:
    with pytest.raises(WorldError, match=words):
        opened(StandInSystem(video0=StandInCamera(open_errno=code)), "0", [])


def test_a_camera_that_another_program_streams_is_left_alone() -> None:
    controls = {abi.GAIN: [0, 9, 1, 7]}
    with pytest.raises(WorldError, match="cannot be set: another program has /dev/video0"):
        opened(StandInSystem(video0=StandInCamera(streams=1, controls=controls)), "0", [], Capture(gain=1.0))
    assert controls[abi.GAIN][3] == 7


@pytest.mark.parametrize(
    ("capabilities", "words"),
    [
        (0x00800000 | abi.CAP_STREAMING, "gives no images"),
        (0x4000 | abi.CAP_STREAMING, "is an encoder"),
        (abi.CAP_CAPTURE_PLANES | abi.CAP_STREAMING, "has its images in planes"),
        (abi.CAP_CAPTURE, "cannot stream"),
    ],
)
def test_a_node_that_is_no_camera_is_refused(capabilities: int, words: str) -> None:
    system = StandInSystem(video0=StandInCamera(capabilities=capabilities))
    with pytest.raises(InputError, match=f"/dev/video0: {words}.*cameras lists what there is"):
        opened(system, "/dev/video0", [])
    assert not system.opened


def test_a_device_that_is_no_video_node_is_refused(tmp_path: Path) -> None:
    link = tmp_path / "cam"
    link.symlink_to("/dev/null")
    assert not is_v4l2(str(link))
    with pytest.raises(WorldError, match="/dev/null is no V4L2 device"):
        V4l2Opener("/dev/null", Capture(), None, silent)()


def test_names(tmp_path: Path) -> None:
    folders = [tmp_path / "by-id", tmp_path / "by-path"]
    for folder, links in zip(folders, ({"usb-A": 0}, {"pci-1": 0, "pci-2": 1}), strict=True):
        folder.mkdir()
        for name, number in links.items():
            (folder / name).symlink_to(f"/dev/video9{number}")
    nodes = [f"/dev/video9{number}" for number in range(3)]
    assert best_names(nodes, [str(folder) for folder in folders]) == {
        "/dev/video90": str(folders[0] / "usb-A"),
        "/dev/video91": str(folders[1] / "pci-2"),
        "/dev/video92": "/dev/video92",
    }
    for text in ("0", "12", "/dev/video3", "/dev/v4l/by-id/usb-gone", str(folders[0] / "usb-A")):
        assert is_v4l2(text)
    for text in ("frames", "²", "sim", str(tmp_path)):
        assert not is_v4l2(text)
    assert name_of("7") == "/dev/video7"
    for text in ("9" * 30, "/dev/videoX", "/dev/video"):
        with pytest.raises(InputError, match="expected a V4L2 camera such as 0 or /dev/video0, or a link to one"):
            name_of(text)


def test_the_hardware_behind_a_node_is_read_from_the_kernels_tree(tmp_path: Path) -> None:
    """As it lies in /sys: a node's device is a USB interface, whose parent is the USB device."""
    usb, sensor = tmp_path / "devices/usb1/1-4", tmp_path / "devices/platform/csi"
    for folder in (usb / "1-4:1.0", sensor, tmp_path / "class/video2", tmp_path / "class/video10"):
        folder.mkdir(parents=True)
    for key, value in (("idVendor", "046d"), ("idProduct", "082d"), ("serial", "A1B2")):
        (usb / key).write_text(f"{value}\n")
    for node, device in (("video2", usb / "1-4:1.0"), ("video10", sensor)):
        (tmp_path / "class" / node / "device").symlink_to(device)
        (tmp_path / "class" / node / "index").write_text("0\n")
    kernel = Kernel()
    kernel.folder = tmp_path / "class"
    assert kernel.hardware("/dev/video2") == ("046d:082d:A1B2", "0")
    assert kernel.hardware("/dev/video10") == ("", "0")
    assert kernel.hardware("/dev/video99") == ("", "")
    (usb / "serial").unlink()
    assert kernel.hardware("/dev/video2") == ("", "0")
