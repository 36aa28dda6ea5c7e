"""Image files as they come: stacks, bytes behind the end, huge claims, 12 bits in 16; films and their own times."""

import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from asterism.protocol.errors import InputError
from asterism.server.sources.image_headers import NoImage, page_sizes
from asterism.server.sources.images import UnreadableImage, read_pages
from asterism.server.sources.open_source import open_source
from tests.helpers import shared

WIDTH, HEIGHT = 64, 48


def pattern(seed: int, most: int = 256, kind: str = "uint8") -> NDArray[np.generic]:
    return np.random.default_rng(seed).integers(0, most, (HEIGHT, WIDTH)).astype(kind)


def any_size(width: int, height: int) -> None:
    """Every size is right."""


def silent(text: str) -> None:
    """Nobody listens."""


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tiff", ".bmp"])
def test_the_size_is_known_before_anything_is_decoded(tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"a{suffix}"
    cv2.imwrite(str(file), pattern(1))
    assert page_sizes(file.read_bytes()) == [(WIDTH, HEIGHT)]
    asked: list[tuple[int, int]] = []

    def refuse(width: int, height: int) -> None:
        asked.append((width, height))
        raise InputError("another size")

    with pytest.raises(InputError, match="another size"):
        next(read_pages(file, refuse))
    assert asked == [(WIDTH, HEIGHT)]


def test_a_small_file_that_claims_to_be_huge_is_refused(tmp_path: Path) -> None:
    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    head = struct.pack(">IIBBBBB", 20_000, 20_000, 8, 0, 0, 0, 0)
    png = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", b"") + chunk(b"IEND", b"")
    (tmp_path / "a.png").write_bytes(png)
    with pytest.raises(UnreadableImage, match="claims to be 20000x20000, larger than any camera's image"):
        next(read_pages(tmp_path / "a.png", any_size))


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
@pytest.mark.parametrize("behind", [1, 8192, 300_000])
def test_what_stands_behind_an_images_end_is_none_of_it(tmp_path: Path, suffix: str, behind: int) -> None:
    file = tmp_path / f"a{suffix}"
    cv2.imwrite(str(file), pattern(2))
    whole = next(read_pages(file, any_size))[1]
    data = file.read_bytes()
    file.write_bytes(data + b"\0" * behind)
    np.testing.assert_array_equal(next(read_pages(file, any_size))[1], whole)
    # Cut off is what ends before its end marker, whatever follows.
    file.write_bytes(data[:-30])
    with pytest.raises(UnreadableImage, match="is cut off"):
        next(read_pages(file, any_size))


KINDS_OF_JPEG = (
    (),
    (cv2.IMWRITE_JPEG_OPTIMIZE, 1),
    (cv2.IMWRITE_JPEG_RST_INTERVAL, 3),
    (cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
    (cv2.IMWRITE_JPEG_QUALITY, 30),
)


@pytest.mark.parametrize("options", KINDS_OF_JPEG)
@pytest.mark.parametrize("shape", [(48, 64), (33, 47), (33, 47, 3), (9, 300)])
def test_whole_jpeg_files_are_read_as_any_decoder_reads_them(
    tmp_path: Path, rng: np.random.Generator, options: tuple[int, ...], shape: tuple[int, ...]
) -> None:
    file = tmp_path / "a.jpg"
    for image in (np.zeros(shape, np.uint8), np.full(shape, 128, np.uint8), *rng.integers(0, 256, (20, *shape))):
        cv2.imwrite(str(file), image.astype(np.uint8), options)
        read = next(read_pages(file, any_size))[1]
        np.testing.assert_array_equal(read, cv2.imread(str(file), cv2.IMREAD_UNCHANGED))


def lose(data: bytes, at: int) -> bytes:
    return data[:at] + data[at + 40 :]


def end_early(data: bytes, at: int) -> bytes:
    return data[:at] + data[-2:]


@pytest.mark.parametrize(("damage", "least"), [(end_early, 40), (lose, 20)])
def test_jpeg_data_that_ends_before_the_image_is_damaged(
    tmp_path: Path,
    rng: np.random.Generator,
    damage: Callable[[bytes, int], bytes],
    least: int,
    capfd: pytest.CaptureFixture[str],
) -> None:
    file, found = tmp_path / "a.jpg", 0
    noise = rng.normal(40, 60, (240, 320)).clip(0, 255).astype(np.uint8)
    cv2.imwrite(str(file), cv2.GaussianBlur(noise, (0, 0), 1))
    data = file.read_bytes()
    first = data.index(b"\xff\xda") + 20
    for at in rng.integers(first, len(data) - 60, 40):
        file.write_bytes(damage(data, int(at)))
        try:
            next(read_pages(file, any_size))
        except UnreadableImage:
            found += 1
    # What is read instead of what is lost may be as many blocks, or more.
    assert found >= least, found
    assert capfd.readouterr().err == ""


def test_every_page_of_a_tiff_is_a_frame(tmp_path: Path) -> None:
    pages = [pattern(k) for k in range(5)]
    assert cv2.imwritemulti(str(tmp_path / "stack.tiff"), pages)
    cv2.imwrite(str(tmp_path / "zlast.tiff"), pattern(9))
    frames = list(open_source(str(tmp_path), None, silent).frames())
    assert [frame.name for frame in frames] == [f"stack.tiff#{k}" for k in range(5)] + ["zlast.tiff"]
    assert [frame.index for frame in frames] == list(range(6))
    for frame, page in zip(frames, [*pages, pattern(9)], strict=True):
        np.testing.assert_array_equal(frame.image, page)


def test_directories_of_a_tiff_that_go_round_in_a_circle_are_refused(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.tiff"), pattern(1))
    data = bytearray((tmp_path / "a.tiff").read_bytes())
    first = struct.unpack_from("<I", data, 4)[0]
    entries = struct.unpack_from("<H", data, first)[0]
    struct.pack_into("<I", data, first + 2 + 12 * entries, first)
    with pytest.raises(NoImage, match="go round in a circle"):
        page_sizes(bytes(data))


@pytest.mark.parametrize(("bits", "shift"), [(10, 2), (12, 4), (14, 6)])
def test_bits_in_the_lower_end_of_16_are_recognized_and_said(tmp_path: Path, bits: int, shift: int) -> None:
    images = [pattern(k, 1 << bits, "uint16") for k in range(2)]
    images[0][0, 0] = (1 << bits) - 1
    for k, image in enumerate(images):
        cv2.imwrite(str(tmp_path / f"{k}.png"), image)
    said: list[str] = []
    frames = list(open_source(str(tmp_path), None, said.append).frames())
    for frame, image in zip(frames, images, strict=True):
        np.testing.assert_array_equal(frame.image, image >> shift)
    assert len(said) == 1
    assert f"taken for a camera of {bits} bits" in said[0]


def test_a_later_image_with_more_bits_than_the_first_is_asked_about(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "0.png"), pattern(0, 1 << 12, "uint16"))
    cv2.imwrite(str(tmp_path / "1.png"), pattern(1, 1 << 16, "uint16"))
    with pytest.raises(InputError, match=r"1\.png: values up to \d+, more than the 1[024] bits .* say how many"):
        list(open_source(str(tmp_path), None, silent).frames())


def test_a_film_has_the_times_that_its_file_gives() -> None:
    film = shared("cases") / "08-variable-rate-video-times" / "vfr.mkv"
    times = [frame.exposed_ns / 1e6 for frame in open_source(str(film), None, silent).frames()]
    assert len(times) == 12
    assert times[5] < 200
    assert times[6] == pytest.approx(1200, abs=40)
    assert times == sorted(times)


def test_damaged_frames_of_a_film_are_skipped_counted_and_said(tmp_path: Path) -> None:
    whole = tmp_path / "whole.avi"
    writer = cv2.VideoWriter(str(whole), cv2.VideoWriter.fourcc(*"MJPG"), 30.0, (WIDTH, HEIGHT), False)
    for k in range(20):
        writer.write(cv2.GaussianBlur(pattern(k), (0, 0), 3))
    writer.release()
    data = bytearray(whole.read_bytes())
    starts = [at for at in range(len(data)) if data[at : at + 3] == b"\xff\xd8\xff"]
    assert len(starts) == 20
    for k in (7, 8):
        data[starts[k] : starts[k] + 200] = b"\0" * 200
    (tmp_path / "damaged.avi").write_bytes(data)
    said: list[str] = []
    source = open_source(str(tmp_path / "damaged.avi"), None, said.append)
    frames = list(source.frames())
    assert len(frames) + source.unreadable == 20
    assert {frame.index for frame in frames} >= {*range(7), *range(10, 20)} or source.unreadable == 2
    assert frames[-1].exposed_ns == pytest.approx(19 / 30 * 1e9, abs=2e7)
    assert source.unreadable == 2
    assert "2 of 20 frames cannot be read; skipped" in said[0]


def test_reading_a_huge_claim_takes_no_memory(tmp_path: Path) -> None:
    """In a process of its own, held to 600 MB."""
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((6000, 6000), np.uint8))
    program = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_DATA, (600 << 20,) * 2)\n"
        "from pathlib import Path\n"
        "from asterism.protocol.errors import InputError\n"
        "from asterism.server.sources.open_source import open_source\n"
        "from asterism.protocol.rig import load_rig\n"
        "from asterism.server.simulation.demo_rig import DEMO_RIG\n"
        "try:\n    list(open_source(sys.argv[1], load_rig(DEMO_RIG), print).frames())\n"
        "except InputError as error:\n    print('refused:', error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, tmp_path / "a.png"], capture_output=True, text=True, check=False
    )
    assert "refused:" in done.stdout, done.stderr
    assert "6000x6000" in done.stdout
