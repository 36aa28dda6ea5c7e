"""led.yaml: where an LED's light seems to come from, by the angle and the distance it is seen at, and how surely.

By symmetry every ray that leaves an LED crosses its axis when it is prolonged backwards, so a film of the LED from any
side is told by one number an angle: where on the axis that crossing lies. A chip in a reflector cup makes that number
turn up and down with the angle, too fast for a polynomial; so the file holds it at evenly spaced angles. What is seen
is a picture of so many pixels, of which an estimator of centres makes more or less of the parts; so that the number
changes with the distance too.
"""

import math
from dataclasses import dataclass

import numpy as np

from asterism.protocol.geometry import Floats, frozen_array
from asterism.protocol.yaml_file import Section, parse_yaml

MOST_TERMS = 8  # of a polynomial
MOST_KNOTS = 24
MOST_DOUBTS = 12
LARGEST_M = 0.05  # no LED's light seems to come from farther off
LARGEST_SCATTER_PX = 2.0
KEYS = ("up_to_deg", "shift", "per_metre", "distance", "doubt", "scatter_px", "strange_px", "centre", "axial_shift")
WEIGHTED = "weighted"


@dataclass(frozen=True, slots=True, eq=False)
class LedOffset:
    """The apparent place of an LED: ``position + shift(angle, distance) * led.axis``, angle between axis and line of
    sight.

    ``values`` (k,) m: the shift at k angles, evenly from 0 to ``up_to_rad``; beyond, it stays what it is there.
    Between them it is the cubic through the four nearest (Catmull and Rom, 1974), even in the angle. ``per_metre`` (k,)
    m for every metre that the LED is farther from the camera than ``distance_m``. ``doubts`` (d, k) m: the shift may be
    wrong by each of these functions, one sigma, independently of one another; an error that all LEDs of a robot share.
    ``scatter_px``: what a centre is off besides its noise, each LED and axis by itself, one sigma; nan: not known. It
    takes the place of what an estimator of centres allows for light that it cannot explain, up to ``strange_px`` of it:
    an LED with a cup is strange to it, but always in the same way. ``weighted``: the centres it holds for are weighted
    means of the spots' light, whatever estimator the rig names.
    """

    values: Floats
    up_to_rad: float
    per_metre: Floats
    distance_m: float
    doubts: Floats
    scatter_px: float
    strange_px: float
    weighted: bool = False

    def __post_init__(self) -> None:
        knots = len(self.values)
        object.__setattr__(self, "values", frozen_array(self.values, -1))
        object.__setattr__(self, "per_metre", frozen_array(self.per_metre, knots))
        object.__setattr__(self, "doubts", frozen_array(np.reshape(self.doubts, (-1, knots)), -1, knots))

    @staticmethod
    def table(values: Floats, up_to_rad: float) -> "LedOffset":
        """By the angle alone, without doubt."""
        return LedOffset(values, up_to_rad, np.zeros(len(values)), 1.0, np.zeros((0, len(values))), math.nan, 0.0)

    @staticmethod
    def polynomial(coefficients: Floats, up_to_rad: float) -> "LedOffset":
        """Coefficients of the powers 0, 1, 2, ... of sin^2 of the angle, m, as files held them before."""
        angles = np.linspace(0.0, up_to_rad, MOST_KNOTS)
        return LedOffset.table(np.polynomial.polynomial.polyval(np.sin(angles) ** 2, coefficients), up_to_rad)

    @property
    def angles(self) -> Floats:
        """Those of ``values`` (k,), rad."""
        return np.linspace(0.0, self.up_to_rad, len(self.values))

    def shift(self, angle: Floats, distance: Floats | float | None = None) -> Floats:
        """Along the axis, m, for any shape of angles, rad; ``distance`` None: at that of the file."""
        weights = knot_weights(np.asarray(angle, np.float64), self.up_to_rad, len(self.values))
        shift: Floats = weights @ self.values
        if distance is not None:
            shift = shift + (distance - self.distance_m) * (weights @ self.per_metre)
        return shift


def knot_weights(angle: Floats, up_to: float, knots: int) -> Floats:
    """What every one of ``knots`` values counts (..., knots) in the cubic at angles (...), rad.

    Catmull and Rom's cubic; before 0 comes the mirror image, beyond the end a straight line.
    """
    if knots == 1:
        return np.ones((*angle.shape, 1))
    place = np.clip(angle / up_to, 0.0, 1.0) * (knots - 1)
    before = np.minimum(place.astype(np.int64), knots - 2)
    t = (place - before)[..., None]
    four = np.concatenate(
        [
            -0.5 * t + t**2 - 0.5 * t**3,
            1.0 - 2.5 * t**2 + 1.5 * t**3,
            0.5 * t + 2.0 * t**2 - 1.5 * t**3,
            -0.5 * t**2 + 0.5 * t**3,
        ],
        axis=-1,
    )
    # Rows: the value before 0, those there are, the one beyond the end.
    ghosts = np.vstack([np.eye(knots)[1], np.eye(knots), 2.0 * np.eye(knots)[-1] - np.eye(knots)[-2]])
    weights: Floats = sum(four[..., j : j + 1] * ghosts[before + j] for j in range(4))
    return weights


def parse_offset(text: str, name: str) -> LedOffset:
    """The offset that the text of a led.yaml describes. Raises InputError with file, key, what was found and what is
    accepted.
    """
    return _offset(parse_yaml(text, name))


def _offset(section: Section) -> LedOffset:
    section.only(KEYS)
    if "axial_shift" in section:
        section.only(("axial_shift", "up_to_deg"))
        shift = _list(section, "axial_shift", MOST_TERMS, "coefficients of the powers of sin^2 of the angle, m")
        offset = LedOffset.polynomial(shift, _up_to(section))
        _refuse_large(section, "axial_shift", offset.values)
        return offset
    values = _list(section, "shift", MOST_KNOTS, "shifts along the axis, evenly from 0 to up_to_deg, m")
    knots, up_to = len(values), _up_to(section)
    per_metre, distance, doubts = np.zeros(knots), 1.0, np.zeros((0, knots))
    if "per_metre" in section:
        per_metre = np.array(section.numbers("per_metre", knots, "as many as shift has, m for every metre"))
        distance = section.number("distance", above=0.0)
    if "doubt" in section:
        doubts = np.array(section.rows("doubt", knots, "as many as shift has, m"))
        if len(doubts) > MOST_DOUBTS:
            raise section.error("doubt", f"{len(doubts)} rows, expected at most {MOST_DOUBTS}")
    scatter, strange = math.nan, 0.0
    if "scatter_px" in section:
        scatter, strange = section.number("scatter_px", least=0.0), section.number("strange_px", least=0.0)
        for key, value in (("scatter_px", scatter), ("strange_px", strange)):
            if value > LARGEST_SCATTER_PX:
                raise section.error(key, f"{value:g}, expected at most {LARGEST_SCATTER_PX:g}")
    weighted = "centre" in section and section.text("centre", (WEIGHTED,)) == WEIGHTED
    if weighted and math.isnan(scatter):
        raise section.error("centre", f"{WEIGHTED} without scatter_px, expected both or neither")
    for key, numbers in (("shift", values), ("per_metre", per_metre), ("doubt", doubts)):
        _refuse_large(section, key, numbers)
    return LedOffset(values, up_to, per_metre, distance, doubts, scatter, strange, weighted)


def _list(section: Section, key: str, most: int, what: str) -> Floats:
    values = section.values.get(key)
    count = len(values) if isinstance(values, list) else 1
    if not 1 <= count <= most:
        raise section.error(key, f"{count} values, expected 1 to {most} {what}")
    return np.array(section.numbers(key, count, what))


def _up_to(section: Section) -> float:
    up_to = section.number("up_to_deg", above=0)
    if up_to > 90:
        raise section.error("up_to_deg", f"{up_to:g}, expected at most 90")
    return float(np.radians(up_to))


def _refuse_large(section: Section, key: str, numbers: Floats) -> None:
    largest = float(np.abs(numbers).max(initial=0.0))
    if largest > LARGEST_M:
        raise section.error(
            key, f"shifts the LED by up to {largest:g} m, expected at most {LARGEST_M:g} m; is that mm?"
        )
