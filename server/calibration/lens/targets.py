"""Planar calibration targets: what people name on the command line, and where their points are on the board."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats
from asterism.protocol.yaml_file import read_yaml
from asterism.server.calibration.lens.layout_match import looks_the_same_turned

KINDS = ("chessboard", "circles", "acircles", "charuco")
LEAST_POINTS, MOST_POINTS = 6, 2000
EXPECTED = (
    "expected KIND:COLSxROWS:PITCH with KIND chessboard (inner corners), circles, acircles or charuco (squares), "
    "PITCH in m"
)


@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """A flat board: ``points`` (n, 3) m, z = 0, in the order of its ``columns`` and ``rows`` (n and 1 for LEDs).

    ``pitch`` m is the distance of neighbours; for acircles that of two rows, half of that of two columns; for charuco
    the side of a square.
    """

    kind: str
    columns: int
    rows: int
    pitch: float
    points: Floats
    name: str

    @property
    def size_m(self) -> float:
        """The largest distance between two points."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0)))

    @property
    def symmetric(self) -> bool:
        """Whether it looks the same turned about, so that nobody can tell its ends apart."""
        if self.kind == "charuco":
            return False
        if self.kind == "chessboard":
            return (self.columns + self.rows) % 2 == 0
        return looks_the_same_turned(self.points[:, :2])


def refuse_symmetric(target: Target) -> None:
    """Raise InputError for a target that looks the same turned about, where the way it lies matters."""
    if target.symmetric:
        raise InputError(
            f"--target {target.name}: looks the same turned about, which leaves the world's origin and axes open; "
            "expected a chessboard with an odd and an even number of inner corners (9x6), acircles with an odd number "
            "of rows (4x11), charuco, or an LED board without symmetry"
        )


def parse_target(text: str) -> Target:
    """The target that ``KIND:COLSxROWS:PITCH`` or ``leds:BOARD.yaml`` names. Raises InputError."""
    kind, _, rest = text.partition(":")
    if kind == "leds" and rest:
        return _led_board(Path(rest), text)
    return parse_board(text, "--target ", "; or leds:BOARD.yaml")


def parse_board(text: str, argument: str = "", also: str = "") -> Target:
    """The printed board that ``KIND:COLSxROWS:PITCH`` names; ``argument`` begins and ``also`` ends the sentence of an
    InputError.
    """
    kind, _, rest = text.partition(":")
    size, _, pitch_text = rest.partition(":")
    columns_text, _, rows_text = size.partition("x")
    try:
        pitch = float(pitch_text)
    except ValueError:
        pitch = 0.0
    counts = (columns_text, rows_text)
    whole = all(count.isascii() and count.isdigit() and len(count) < 9 for count in counts)
    if kind not in KINDS or not whole or not pitch > 0.0:
        raise InputError(f"{argument}{text}: {EXPECTED}{also}")
    columns, rows = int(columns_text), int(rows_text)
    least = 3 if kind == "chessboard" else 2
    if min(columns, rows) < least or columns * rows > MOST_POINTS:
        raise InputError(f"{argument}{text}: {columns} x {rows}, expected {least} x {least} to {MOST_POINTS} points")
    if pitch >= 1.0:
        raise InputError(
            f"{argument}{text}: {pitch:g} m from point to point; PITCH is in m: if you meant mm, say {pitch / 1e3:g}"
        )
    if kind == "acircles" and rows % 2 == 0:
        raise InputError(
            f"{argument}{text}: {rows} rows, expected an odd number: with an even one the board looks the same turned "
            "by half, and its dots are taken for one another"
        )
    if kind == "charuco":
        columns, rows = columns - 1, rows - 1
    row, column = np.divmod(np.arange(columns * rows), columns)
    if kind == "acircles":
        column = 2 * column + row % 2
    points = np.column_stack([column, row, np.zeros(len(row))]) * pitch
    return Target(kind, columns, rows, pitch, points, text)


def _led_board(path: Path, text: str) -> Target:
    section = read_yaml(path)
    section.only(("leds",))
    places = np.array(section.rows("leds", 3, "x, y, z in m"))
    if not LEAST_POINTS <= len(places) <= MOST_POINTS:
        raise section.error("leds", f"{len(places)} of them, expected {LEAST_POINTS} to {MOST_POINTS}")
    if np.ptp(places[:, 2]) > 1e-9:
        raise section.error("leds", "they are not in one plane z = constant, expected a flat board")
    places = places - [0.0, 0.0, places[0, 2]]
    apart = np.linalg.norm(places[:, None] - places[None], axis=-1) + np.diag(np.full(len(places), np.inf))
    if np.linalg.matrix_rank(places[:, :2] - places[:, :2].mean(axis=0), tol=0.02 * apart[apart < np.inf].max()) < 2:
        raise section.error("leds", "they are on one line, expected them spread over the board")
    return Target("leds", len(places), 1, float(apart.min()), places, text)
