"""The kernel's own virtual camera, vivid, where there is one: real buffers, formats, times, and a driver taken away."""

import os
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from asterism.protocol.capture import Capture
from asterism.protocol.errors import InputError, WorldError
from asterism.server.sources.camera import Taken
from asterism.server.sources.v4l2.camera import V4l2Device, V4l2Opener
from asterism.server.sources.v4l2.node import KERNEL, Node

SIZE = (640, 360)


def silent(text: str) -> None:
    """Nobody listens."""


@pytest.fixture(scope="module")
def vivid() -> str:
    for path in KERNEL.nodes():
        try:
            with closing(Node(path)) as node:
                if node.card == "vivid" and not node.not_a_camera():
                    return path
        except OSError:
            continue
    pytest.skip("needs the kernel's virtual camera: modprobe vivid node_types=0x1")


@contextmanager
def opened(path: str, capture: Capture, say: list[str] | None = None) -> Iterator[V4l2Device]:
    device = V4l2Opener(path, capture, SIZE, silent if say is None else say.append)()
    assert device is not None
    with closing(device):
        yield device


def image(device: V4l2Device) -> NDArray[np.generic]:
    """The next one."""
    while not isinstance(taken := device.read(), Taken):
        assert taken is not None
    return taken.image


def image_of(path: str, fourcc: str) -> NDArray[np.generic]:
    with opened(path, Capture(pixel_format=fourcc, rate_hz=30.0)) as device:
        return image(device)


@pytest.mark.parametrize("fourccs", [("GREY", "Y10", "Y12", "Y16"), ("YUYV", "UYVY", "NV12")])
def test_every_format_shows_the_same_picture(vivid: str, fourccs: tuple[str, ...]) -> None:
    """Of its colour bars grey and YUV have different greys."""
    pictures = [image_of(vivid, fourcc).astype(int) for fourcc in fourccs]
    for picture in pictures:
        assert picture.shape == SIZE[::-1]
        assert np.ptp(picture) > 100
        assert np.mean(np.abs(picture - pictures[0]) <= 1) > 0.9  # elsewhere a text counts frames


def test_settings_are_read_back_and_the_camera_is_one_programs(vivid: str) -> None:
    said: list[str] = []
    with opened(vivid, Capture(rate_hz=47.0, gain=300.0, exposure_us=500.0), said):
        assert [line.partition(": ")[2].partition(":")[0] for line in said] == [
            "capture.rate 47",
            "capture.exposure_us 500",
            "capture.gain 300",
        ]
        with pytest.raises(WorldError, match="another program has"):
            V4l2Opener(vivid, Capture(), SIZE, silent)()
    with pytest.raises(InputError, match="no images of 641x480"):
        V4l2Opener(vivid, Capture(), (641, 480), silent)()


def test_a_driver_taken_away_ends_it_and_given_back_it_is_found_under_another_number(vivid: str) -> None:
    device = (KERNEL.folder / Path(vivid).name / "device").resolve()
    driver = (device / "driver").resolve()
    if not os.access(driver / "unbind", os.W_OK):
        pytest.skip("needs root")
    opener = V4l2Opener(vivid, Capture(), SIZE, silent)
    camera = opener()
    assert camera is not None
    image(camera)
    with Path(vivid).open("rb", buffering=0):  # the number stays taken
        (driver / "unbind").write_text(device.name)
        while camera.read() is not None:
            pass
        camera.close()
        assert opener() is None
        (driver / "bind").write_text(device.name)
        again = opener()
        assert again is not None
        with closing(again):
            assert opener.path != vivid
            image(again)
