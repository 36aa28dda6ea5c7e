"""A folder's times.csv: its images have these times; what is wrong with it is said."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from asterism.protocol.errors import InputError
from asterism.server.sources.open_source import open_source

NAMES = ("f1.png", "f2.png", "f10.png")
TIMES = (1_700_000_000_000_000_001, 1_700_000_000_016_666_668, 1_700_000_000_050_000_003)
LINES = ["frame,exposed_ns", *(f"{name},{time}" for name, time in zip(NAMES, TIMES, strict=True))]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in NAMES:
        cv2.imwrite(str(tmp_path / name), np.zeros((48, 64), np.uint8))
    (tmp_path / "times.csv").write_text("\n".join(LINES) + "\n")
    return tmp_path


def silent(text: str) -> None:
    """Nobody listens."""


def times(source: str) -> list[tuple[str, int]]:
    return [(frame.name, frame.exposed_ns) for frame in open_source(source, None, silent).frames()]


def test_images_have_the_times_that_are_written_there(folder: Path) -> None:
    told = list(zip(NAMES, TIMES, strict=True))
    assert times(str(folder)) == told
    assert times(f"{folder}/f1*.png") == [told[0], told[2]]  # lines of other images do not matter
    assert times(f"{folder}/f2.png") == [told[1]]
    assert open_source(str(folder), None, silent).rate_hz == pytest.approx(2 / 0.050000002)


def test_the_lines_may_stand_in_any_order_and_end_in_any_way(folder: Path) -> None:
    (folder / "times.csv").write_bytes(b"\xef\xbb\xbf" + "\r\n".join([LINES[0], *LINES[:0:-1], ""]).encode())
    assert times(str(folder)) == list(zip(NAMES, TIMES, strict=True))


def test_an_image_that_cannot_be_read_costs_no_other_its_time(folder: Path) -> None:
    (folder / "f2.png").write_bytes(b"no image")
    assert times(str(folder)) == [("f1.png", TIMES[0]), ("f10.png", TIMES[2])]


def test_pages_of_a_stack_have_times_of_their_own(folder: Path) -> None:
    cv2.imwritemulti(str(folder / "s.tiff"), [np.zeros((48, 64), np.uint8)] * 2)
    (folder / "times.csv").write_text("frame,exposed_ns\ns.tiff#0,5\ns.tiff#1,9\n")
    assert times(f"{folder}/s.tiff") == [("s.tiff#0", 5), ("s.tiff#1", 9)]


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ([], r"times\.csv: is empty, expected the header frame,exposed_ns"),
        (["name,t", *LINES[1:]], r"times\.csv: begins with 'name,t', expected the header frame,exposed_ns"),
        ([*LINES[:2], "f2.png"], r"times\.csv, line 3: 'f2.png', expected an image's name and a whole number of ns"),
        ([*LINES[:2], "f2.png,1.5"], r"line 3: 'f2.png,1.5', expected an image's name and a whole number of ns"),
        ([*LINES[:2], "f2.png,-5"], r"line 3: 'f2.png,-5', expected"),
        ([*LINES[:2], f"f2.png,{1 << 63}"], r"line 3: .*, expected an image's name and a whole number of ns"),
        ([*LINES, LINES[1]], r"line 5: a second time for f1.png, expected one line for each image"),
        (LINES[:3], r"times\.csv: has no time for f10.png, expected a line for every image of the folder"),
        ([*LINES[:3], "f10.png,7"], r"f10.png was taken at 7, expected later than f2.png before it"),
    ],
)
def test_what_is_wrong_is_said(folder: Path, lines: list[str], words: str) -> None:
    (folder / "times.csv").write_text("\n".join(lines))
    with pytest.raises(InputError, match=words):
        times(str(folder))
