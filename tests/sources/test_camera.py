"""What a camera tells in an image's place: it waits, something was lost, another program has it."""

import itertools
from collections.abc import Iterator

import numpy as np

from asterism.protocol.errors import WorldError
from asterism.server.sources.camera import Camera, Device, Taken, Waiting
from tests.sources.genicam.gige_film import HEIGHT, WIDTH, rig_with

IMAGE = np.zeros((HEIGHT, WIDTH), np.uint8)
BUSY = WorldError("cam: the camera is in use by a program on 10.0.0.7")


class Scripted:
    """A device that gives one thing after the other."""

    def __init__(self, *reads: Taken | Waiting | None) -> None:
        self.reads: Iterator[Taken | Waiting | None] = iter(reads)
        self.closed = False

    def read(self) -> Taken | Waiting | None:
        return next(self.reads)

    def close(self) -> None:
        self.closed = True


def opening(*devices: Device | WorldError | None) -> Camera:
    given = iter(devices)

    def open_device() -> Device | None:
        device = next(given)
        if isinstance(device, WorldError):
            raise device
        return device

    said: list[str] = []
    camera = Camera("cam", open_device, rig_with(), said.append, retry_s=0.0)
    camera.said = said  # type: ignore[attr-defined]
    return camera


def test_what_was_lost_is_counted_whether_or_not_an_image_came() -> None:
    camera = opening(Scripted(Waiting(unreadable=1), Taken(IMAGE, missed=3), Waiting(), Taken(IMAGE, unreadable=2)))
    frames = list(itertools.islice(camera.frames(), 2))
    assert [frame.index for frame in frames] == [0, 1]
    assert (camera.unreadable, camera.missed) == (3, 3)


def test_why_it_waits_is_said_once_and_is_over_with_the_next_image() -> None:
    why = Waiting("it waits for its trigger (Line1)")
    camera = opening(Scripted(why, why, Waiting(), why, Taken(IMAGE), why, Taken(IMAGE)))
    stream = camera.frames()
    next(stream)
    assert camera.problem == ""
    next(stream)
    assert camera.said == ["cam: it waits for its trigger (Line1)"] * 2  # type: ignore[attr-defined]


def test_while_another_program_has_it_that_is_said_once() -> None:
    first = Scripted(Taken(IMAGE), None)
    camera = opening(first, None, BUSY, BUSY, BUSY, Scripted(Taken(IMAGE)))
    assert len(list(itertools.islice(camera.frames(), 2))) == 2
    assert first.closed
    assert camera.said == [  # type: ignore[attr-defined]
        "cam: the camera vanished; waiting for it",
        f"{BUSY}; waiting for it",
        "cam: the camera is back",
    ]


def test_whoever_stops_reading_lets_the_camera_go() -> None:
    device = Scripted(Taken(IMAGE), Taken(IMAGE))
    stream = opening(device).frames()
    next(stream)
    assert not device.closed
    stream.close()
    assert device.closed


def test_the_bits_that_a_camera_tells_are_used_where_the_rig_says_none() -> None:
    deep = Taken(np.full((HEIGHT, WIDTH), 0x0ABC, np.uint16), bits=12)
    (frame,) = itertools.islice(opening(Scripted(deep)).frames(), 1)
    assert (frame.image == 0xAB).all()
    camera = Camera("cam", lambda: Scripted(deep), rig_with(bits=16), print)
    (frame,) = itertools.islice(camera.frames(), 1)
    assert (frame.image == 0x0A).all()
