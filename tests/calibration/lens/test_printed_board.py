"""Printed boards: what is on paper is true to scale, is found by the detectors, and is what its words say."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats
from asterism.server.__main__ import main
from asterism.server.calibration.lens.board_points import DICTIONARIES, find_points
from asterism.server.calibration.lens.printed_board import DICTIONARY, looks_the_same_turned, printed_board
from asterism.server.calibration.lens.targets import parse_board, parse_target
from asterism.server.design.page import Words, pdf

MM_PER_POINT = 25.4 / 72.0
BOARDS = (
    "chessboard:9x6:0.025", "chessboard:8x6:0.02", "circles:7x5:0.03", "acircles:4x11:0.02", "charuco:8x6:0.028",
    "charuco:7x7:0.02",
)  # fmt: skip


def paths_of(data: bytes) -> tuple[Floats, list[Floats]]:
    """The page's size in points, and the filled areas of its PDF: polygons (n, 2) in points from its upper left corner.

    Reads what ISO 32000-1 (8.5.2) says of cm, re, m, c and f, and nothing of the product's.
    """
    box = re.search(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", data)
    stream = re.search(rb"stream\n(.*?)\nendstream", data, re.DOTALL)
    assert box is not None
    assert stream is not None
    size = np.array([float(box[1]), float(box[2])])
    scale, filled, path, operands = 1.0, [], [], []
    for word in re.sub(rb"\(.*?\) Tj", b"", stream[1]).decode("ascii").split():
        if re.fullmatch(r"-?[\d.]+", word):
            operands.append(float(word))
            continue
        if word == "cm":
            scale = operands[0]
        elif word == "re":
            x, y, w, h = operands
            path.append([(x, y), (x + w, y), (x + w, y + h), (x, y + h)])
        elif word == "m":
            path.append([(operands[0], operands[1])])
        elif word == "c":
            ends = np.array([path[-1][-1], *np.reshape(operands, (3, 2))])
            for t in np.linspace(0.0, 1.0, 9)[1:]:
                path[-1].append(tuple(np.array([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t * t * (1 - t), t**3]) @ ends))
        elif word in ("f", "S"):
            filled += [np.array(part) * scale for part in path] if word == "f" else []
            path = []
        operands = []
    return size, [np.column_stack([area[:, 0], size[1] - area[:, 1]]) for area in filled]


def scanned(data: bytes, px_per_mm: float = 4.0, finer: int = 4) -> NDArray[np.uint8]:
    """The page as a scanner on a grey table sees it, supersampled."""
    size, areas = paths_of(data)
    scale = finer * px_per_mm * MM_PER_POINT
    page = np.full(np.rint(size[::-1] * scale).astype(int), 235, np.uint8)
    for area in areas:
        # fillPoly counts pixels from their centres.
        corners = np.rint((area * scale - 0.5) * 256).astype(np.int32)
        cv2.fillPoly(page, [corners], 20, cv2.LINE_8, 8)
    height, width = (length // finer for length in page.shape)
    seen = cv2.resize(page, (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.copyMakeBorder(seen, 60, 60, 60, 60, cv2.BORDER_CONSTANT, value=80), np.uint8)


def px_by_mm(image: NDArray[np.uint8], text: str) -> Floats:
    """The linear part (2, 2) of the map from the board's mm to the pixels where its points were found."""
    target = parse_target(text)
    seen = find_points(image, target)
    assert seen is not None
    assert len(seen.points) == len(target.points)
    known = np.column_stack([1e3 * seen.points[:, :2], np.ones(len(seen.points))])
    fit, residual, _, _ = np.linalg.lstsq(known, seen.pixels, rcond=None)
    assert np.sqrt(residual.sum() / len(known)) < 0.15
    return np.asarray(fit[:2].T, np.float64)


@pytest.mark.parametrize("text", BOARDS)
def test_a_printed_board_is_found_and_true_to_a_thousandth(text: str) -> None:
    image = scanned(pdf(printed_board(parse_board(text))))
    upright = px_by_mm(image, text)
    turned = px_by_mm(np.ascontiguousarray(np.rot90(image, 2)), text)
    if looks_the_same_turned(parse_board(text)):
        upright, turned = np.abs(upright), -np.abs(turned)
    # x to the right and y down from the upper left point, as the sheet says.
    np.testing.assert_allclose(upright, 4.0 * np.eye(2), atol=4.0 * 1e-3)
    np.testing.assert_allclose(turned, -4.0 * np.eye(2), atol=4.0 * 1e-3)


def test_large_dots_are_found_as_well() -> None:
    text = "circles:5x4:0.04"
    image = scanned(pdf(printed_board(parse_board(text))), px_per_mm=6.0, finer=2)
    np.testing.assert_allclose(px_by_mm(image, text), 6.0 * np.eye(2), atol=6.0 * 1e-3)


def test_markers_are_of_a_dictionary_that_is_looked_for() -> None:
    assert DICTIONARY in DICTIONARIES


@pytest.mark.parametrize(
    ("text", "width", "height"),
    [
        ("chessboard:9x6:0.025", 297, 210),
        ("chessboard:6x9:0.025", 210, 297),
        ("chessboard:9x6:0.026", 420, 297),
        ("charuco:30x20:0.03", 1189, 841),
    ],
)
def test_the_smallest_sheet_that_holds_it_is_taken(text: str, width: float, height: float) -> None:
    page = printed_board(parse_board(text))
    assert (page.width, page.height) == (width, height)


@pytest.mark.parametrize("text", [*BOARDS, "chessboard:9x6:0.025", "acircles:3x5:0.05", "charuco:12x9:0.0615"])
def test_nothing_reaches_the_margin_and_the_words_stay_clear_of_the_board(text: str) -> None:
    page = printed_board(parse_board(text))
    size, areas = paths_of(pdf(page))
    corners = np.concatenate(areas) * MM_PER_POINT
    np.testing.assert_allclose(size * MM_PER_POINT, [page.width, page.height], atol=1e-3)
    assert corners.min() >= 5.0 - 1e-6
    assert (page.width - corners[:, 0].max()) >= 5.0 - 1e-6
    words = [mark for mark in page.marks if isinstance(mark, Words)]
    highest = max(mark.y + 3.0 for mark in words)
    assert page.height - corners[:, 1].max() - highest > 0.25 * parse_board(text).pitch * 1e3
    # No letter of Helvetica but @, %, M, W and m is wider than 0.78 of its size; half of that is its mean.
    assert all(mark.x + 0.6 * mark.size * len(mark.text) < page.width - 5.0 for mark in words)


def test_the_words_say_what_it_is_and_how_to_check_it() -> None:
    said = [mark.text for mark in printed_board(parse_board("chessboard:9x6:0.025")).marks if isinstance(mark, Words)]
    assert said == [
        "100 mm; if not, PITCH is 0.025 times what it measures / 100",
        "9 x 6 inner corners, 25 mm apart; A4 on its side, print at 100 %; glue it to something flat",
        "for calibrate world: the origin is the upper left point as you read this, x to the right, y up",
        "asterism calibrate camera SOURCE --target chessboard:9x6:0.025 -o camera.yaml",
    ]
    ambiguous = printed_board(parse_board("chessboard:8x6:0.025")).marks
    assert any("not for calibrate world" in mark.text for mark in ambiguous if isinstance(mark, Words))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("chessboard:30x20:0.05", "1580 x 1100 mm with bar and margins, expected what fits on A0, 841 x 1189 mm"),
        ("charuco:8x6:0.0005", "0.5 mm, expected a PITCH of 0.002 m or more"),
        ("acircles:4x10:0.02", "10 rows, expected an odd number"),
        ("leds:board.yaml", "expected KIND:COLSxROWS:PITCH with KIND chessboard"),
        ("chessboard:9x²:0.025", "expected KIND:COLSxROWS:PITCH"),
        ("chessboard:9x6:25", "if you meant mm, say 0.025"),
    ],
)
def test_a_board_that_cannot_be_is_refused(text: str, words: str) -> None:
    with pytest.raises(InputError) as refused:
        printed_board(parse_board(text))
    assert words in str(refused.value)
    assert str(refused.value).startswith(f"{text}: ")


def test_the_command_writes_what_is_there_and_replaces_nothing_unasked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "board.pdf"
    command = ["board", "charuco:8x6:0.028", "-o", str(out)]
    assert main(command) == 0
    assert out.read_bytes() == pdf(printed_board(parse_board("charuco:8x6:0.028")))
    told = capsys.readouterr().out
    assert "297 x 210 mm" in told
    assert "asterism calibrate camera SOURCE --target charuco:8x6:0.028 -o camera.yaml" in told
    assert main(command) == 2
    assert "--force" in capsys.readouterr().err
    assert main([*command, "--force"]) == 0
    assert main(["board", "charuco:8x6:0.028", "-o", str(tmp_path / "board.png")]) == 2
    assert ".pdf" in capsys.readouterr().err
