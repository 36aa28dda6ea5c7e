"""A calibration board to print: true to scale, with a bar to check the print and the command that it is for.

What is drawn is laid out from the board's first point, mm, x right and y down, as `targets` counts its points.
"""

import cv2
import numpy as np

from asterism.protocol.errors import InputError
from asterism.server.calibration.lens.targets import Target
from asterism.server.design.page import Disc, Mark, Page, Rectangles, Words
from asterism.server.design.paper import BAR, PAPER, scale_bar

DICTIONARY = "DICT_4X4_1000"  # whose first 50 to 250 markers are DICT_4X4_50 to DICT_4X4_250
MARKER = 0.75  # of a charuco square's side
DOT_RADIUS = {"circles": 0.25, "acircles": 0.35}  # of the pitch
LEAST_PITCH = 0.002  # m: less is no board that a printer draws or a camera sees
QUIET = 0.3  # of the pitch: white around the board, so that nothing is taken for a part of it
_MARGIN = 5.0  # mm: printers leave as much white
_STRIP = 15.0  # mm, below the board: bar and words
_SIZE, _STEP = 2.6, 3.3  # mm: of letters, from line to line

Box = tuple[float, float, float, float]  # left, top, right, bottom


def printed_board(target: Target) -> Page:
    """The board on the smallest sheet that holds it, its longer side along the sheet's if it can be. Raises InputError
    where no sheet does, and for boards that would not be found.
    """
    _refuse_unfit(target)
    left, top, right, bottom = box = _box(target)
    quiet = QUIET * target.pitch * 1e3
    around = max(_MARGIN, quiet)
    needed = (right - left + 2 * around, bottom - top + around + quiet + _STRIP + _MARGIN)
    paper, width, height = _sheet(target, *needed, on_its_side=right - left > bottom - top)
    x = (width - right - left) / 2
    y = height - around - (height - needed[1]) / 2 + top
    marks = (*_pattern(target, box, x, y), *_words(target, paper))
    return Page(width, height, f"asterism board {_name(target)}", marks)


def _refuse_unfit(target: Target) -> None:
    if target.pitch < LEAST_PITCH:
        raise InputError(f"{target.name}: {target.pitch * 1e3:g} mm, expected a PITCH of {LEAST_PITCH:g} m or more")


def _sheet(target: Target, width: float, height: float, *, on_its_side: bool) -> tuple[str, float, float]:
    """Name, width and height of the smallest sheet that holds width x height mm, lying ``on_its_side`` if it can."""
    for paper, short, long in PAPER:
        both = [(paper, short, long), (f"{paper} on its side", long, short)]
        for sheet in reversed(both) if on_its_side else both:
            if width <= sheet[1] and height <= sheet[2]:
                return sheet
    paper, short, long = PAPER[-1]
    raise InputError(
        f"{target.name}: {width:.0f} x {height:.0f} mm with bar and margins, expected what fits on {paper}, "
        f"{short:g} x {long:g} mm"
    )


def _box(target: Target) -> Box:
    """The edges of what is printed black."""
    pitch = target.pitch * 1e3
    rim = DOT_RADIUS.get(target.kind, 1.0) * pitch
    right, bottom = (np.max(target.points, axis=0)[:2] * 1e3).tolist()
    return -rim, -rim, right + rim, bottom + rim


def _pattern(target: Target, box: Box, x: float, y: float) -> list[Mark]:
    """Discs or squares; (x, y) is the first point's place on the page, mm."""
    pitch = target.pitch * 1e3
    if target.kind in DOT_RADIUS:
        radius = DOT_RADIUS[target.kind] * pitch
        return [Disc(x + 1e3 * px, y - 1e3 * py, radius) for px, py, _ in target.points.tolist()]
    columns, rows = target.columns + 1, target.rows + 1
    squares = [divmod(k, columns) for k in range(columns * rows)]
    # OpenCV counts a chessboard's points from a white corner, a charuco board's from a black one.
    black = int(target.kind == "chessboard")
    dark: list[Box] = [(column, row, 1.0, 1.0) for row, column in squares if (row + column) % 2 == black]
    if target.kind == "charuco":
        dark += _marker_bars(columns, rows)
    left, top = x + box[0], y - box[1]
    return [Rectangles(tuple((left + pitch * u, top - pitch * (v + h), pitch * w, pitch * h) for u, v, w, h in dark))]


def _marker_bars(columns: int, rows: int) -> list[Box]:
    """The black of all markers, row by row, in squares from the board's upper left corner: x, y, width, height."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, DICTIONARY))
    board = cv2.aruco.CharucoBoard((columns, rows), 1.0, MARKER, dictionary)
    cells = dictionary.markerSize + 2
    cell, bars = MARKER / cells, []
    for number, corners in zip(np.ravel(board.getIds()).tolist(), board.getObjPoints(), strict=True):
        u, v = np.reshape(corners, (4, 3))[0, :2].tolist()
        black = np.pad(cv2.aruco.generateImageMarker(dictionary, number, cells) == 0, ((0, 0), (1, 1)))
        for row, line in enumerate(np.diff(black.astype(np.int8), axis=1)):
            starts, ends = np.flatnonzero(line == 1).tolist(), np.flatnonzero(line == -1).tolist()
            bars += [(u + cell * a, v + cell * row, cell * (b - a), cell) for a, b in zip(starts, ends, strict=True)]
    return bars


def _words(target: Target, paper: str) -> list[Mark]:
    name, mm = _name(target), 1e3 * target.pitch
    what = {
        "chessboard": f"{target.columns} x {target.rows} inner corners, {mm:g} mm apart",
        "circles": f"{target.columns} x {target.rows} dots, {mm:g} mm apart",
        "acircles": f"{target.columns} x {target.rows} dots, rows {mm:g} mm and columns {2 * mm:g} mm apart",
        "charuco": f"{target.columns + 1} x {target.rows + 1} squares of {mm:g} mm, markers of {DICTIONARY}",
    }[target.kind]
    world = (
        "looks the same turned by half: for calibrate camera, not for calibrate world"
        if target.symmetric
        else "for calibrate world: the origin is the upper left point as you read this, x to the right, y up"
    )
    lines = [
        Words(_MARGIN, _MARGIN + 0.6 + 2 * _STEP, f"{what}; {paper}, print at 100 %; glue it to something flat", _SIZE),
        Words(_MARGIN, _MARGIN + 0.6 + _STEP, world, _SIZE),
        Words(
            _MARGIN,
            _MARGIN + 0.6,
            f"asterism calibrate camera SOURCE --target {name} -o camera.yaml",
            _SIZE,
            columns=True,
        ),
    ]
    check = f"{BAR:g} mm; if not, PITCH is {target.pitch!r} times what it measures / {BAR:g}"
    return [*scale_bar(_MARGIN, _MARGIN + 0.6 + 3 * _STEP + 0.2, check, tall=3.0, size=_SIZE), *lines]


def _name(target: Target) -> str:
    """As `calibrate camera --target` takes it."""
    extra = int(target.kind == "charuco")
    return f"{target.kind}:{target.columns + extra}x{target.rows + extra}:{target.pitch!r}"
