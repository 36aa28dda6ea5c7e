"""The drill plan of a plate: outline, axes, six holes with their numbers, coordinates, and a bar to check the print.

Drawn as seen from the side on which the LEDs shine, x to the right and y up, like the rig's coordinates.
"""

import math

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.server.design.page import Circle, Line, Mark, Page, Words, columns_width
from asterism.server.design.paper import BAR, PAPER, scale_bar

_MARGIN = 15.0  # mm: no printer prints nearer to the edge than a third of it
_ABOVE = 40.0  # mm for the title
_BELOW = 75.0  # mm for bar and coordinates
_DIGIT = 4.0  # mm: size of a hole's number
_CROSS = 1.5  # times a hole's radius: half the length of the cross at its centre
LARGEST_DISC = 0.8  # m: fits on A0


def drill_plan(name: str, layout: Floats, disc: float, led_radius: float) -> Page:
    """The plan of one plate: ``layout`` (6, 2), the plate's diameter ``disc``, at most LARGEST_DISC, and
    ``led_radius`` in m, the origin at the plate's centre.
    """
    size = disc * 1e3
    paper, width, height = next(
        (paper, width, height)
        for paper, width, height in PAPER
        if size <= min(width - 2 * _MARGIN, height - _ABOVE - _BELOW)
    )
    x, y = width / 2, (height - _ABOVE + _BELOW) / 2
    marks: list[Mark] = [
        Words(_MARGIN, height - 20, name, 7.0),
        Words(
            _MARGIN,
            height - 27,
            f"plate {size:g} mm across, six holes of {led_radius * 2e3:g} mm, seen from the side where the LEDs shine",
        ),
        Words(_MARGIN, height - 32, f"{paper}: print at 100 %, without fitting to the page"),
    ]
    marks += _plate(x, y, size / 2)
    for number in range(len(layout)):
        marks += _hole(layout * 1e3, number, led_radius * 1e3, x, y, size / 2)
    bar = scale_bar(_MARGIN, 62.0, f"{BAR:g} mm: measure it before you drill")
    return Page(width, height, f"asterism drill plan {name}", (*marks, *bar, *_table(layout)))


def _plate(x: float, y: float, radius: float) -> list[Mark]:
    """Outline, centre, and the axes: x ends in an arrow, y in a short line."""
    tip, wing = x + radius + 8, 2.0
    return [
        Circle(x, y, radius, 0.25),
        Line(x - radius - 3, y, tip, y, 0.08),
        Line(x, y - radius - 3, x, y + radius + 5, 0.08),
        Line(tip, y, tip - wing, y + wing / 2, 0.25),
        Line(tip, y, tip - wing, y - wing / 2, 0.25),
        Line(tip - 5, y, tip, y, 0.25),
        Words(tip - 3.5, y + 2, "x", 4.0),
        Words(x + 1.5, y + radius + 3, "y", 4.0),
    ]


def _hole(holes: Floats, number: int, radius: float, x: float, y: float, plate: float) -> list[Mark]:
    """One of the ``holes`` (n, 2), from the centre (x, y) of a plate of radius ``plate``, with its number in that of
    four corners which is clearest of other holes, axes and rim.
    """
    others = np.delete(holes, number, axis=0)

    def clear(corner: Floats) -> float:
        away = float(np.linalg.norm(others - corner, axis=1).min()) - radius
        return min(away, plate - float(np.linalg.norm(corner)), float(np.abs(corner).min()))

    arm, away = _CROSS * radius, (radius + _DIGIT / 2) / math.sqrt(2) + 0.5
    digit = max((holes[number] + away * np.array([side, up]) for up in (1, -1) for side in (1, -1)), key=clear)
    hole_x, hole_y = x + float(holes[number, 0]), y + float(holes[number, 1])
    return [
        Circle(hole_x, hole_y, radius),
        Line(hole_x - arm, hole_y, hole_x + arm, hole_y, 0.1),
        Line(hole_x, hole_y - arm, hole_x, hole_y + arm, 0.1),
        Words(x + float(digit[0]) - 0.28 * _DIGIT, y + float(digit[1]) - 0.36 * _DIGIT, str(number), _DIGIT),
    ]


def _table(layout: Floats) -> list[Mark]:
    size, step = 3.4, 5.0
    rows = [f"{'LED':>3}{'x mm':>10}{'y mm':>10}"]
    rows += [f"{number:>3}{x:>10.2f}{y:>10.2f}" for number, (x, y) in enumerate((layout * 1e3 + 0.0).tolist())]
    top = 52.0
    marks: list[Mark] = [
        Words(_MARGIN, top - step * number, row, size, columns=True) for number, row in enumerate(rows)
    ]
    end = _MARGIN + columns_width(rows[0], size)
    return [*marks, Line(_MARGIN, top - 1.5, end, top - 1.5), Words(end + 8, top, "from the plate's centre", 3.2)]
