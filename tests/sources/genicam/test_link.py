"""Emulated cameras that are not as they should be: packets lost, packed pixels, a link that is too slow."""

from pathlib import Path

import numpy as np
import pytest

from asterism.protocol.errors import InputError
from asterism.server.sources.open_source import open_source
from tests.sources.genicam.fake_camera import described, fake_camera
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
from tests.sources.genicam.test_pixel_formats import packed


def test_packed_pixels_are_unpacked(tmp_path: Path, rng: np.random.Generator) -> None:
    image = rng.integers(0, 4096, (HEIGHT, WIDTH))
    film = packed(image.ravel().tolist(), "Mono12Packed")[None]
    xml = described(tmp_path, "Mono12Packed")
    with fake_camera(tmp_path, film, "--xml", str(xml)):
        (frame,) = frames(open_source(BY_ADDRESS, rig_with(pixel_format="Mono12Packed"), silent), 1)
        np.testing.assert_array_equal(frame.image, image >> 4)


def test_incomplete_frames_are_counted_said_and_never_used(tmp_path: Path) -> None:
    said: list[str] = []
    with fake_camera(tmp_path, FILM, "--lost", "0.05"):
        camera = open_source(BY_ADDRESS, rig_with(), said.append)
        taken = frames(camera, 60)
        for frame in taken:
            assert_is_of_the_film(frame.image)
        assert len(said) == 1
        # Whole, damaged or left out: nothing else happens to a frame.
        first, last = number_of(taken[0].image), number_of(taken[-1].image)
        assert camera.unreadable > 0
        assert last - first + 1 <= 60 + camera.unreadable + camera.missed <= last + 1
    assert said[0].startswith(f"{BY_ADDRESS}: frames are lost: ")
    assert "none of them is used. Packets have 1400 bytes: allow jumbo frames" in said[0]


def test_a_rate_that_the_link_does_not_carry_is_refused(tmp_path: Path) -> None:
    xml = described(tmp_path, "DeviceLinkSpeed=200000")
    with (
        fake_camera(tmp_path, FILM, "--xml", str(xml)),
        pytest.raises(
            InputError,
            match=r"capture.rate 100: a frame has 0\.00 MB, and the camera's link carries 0 MB/s: 61\.8 Hz at",
        ),
    ):
        open_source(BY_ADDRESS, rig_with(), silent)
