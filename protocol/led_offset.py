"""led.yaml: where an LED's light seems to come from, by the angle it is seen at.

By symmetry every ray that leaves an LED crosses its axis when it is prolonged backwards, so a film of the LED from any
side is told by one number an angle: where on the axis that crossing lies. The file holds it as a polynomial.
"""

from dataclasses import dataclass

import numpy as np

from asterism.protocol.geometry import Floats, frozen_array
from asterism.protocol.yaml_file import Section, parse_yaml

MOST_TERMS = 8
LARGEST_M = 0.05  # no LED's light seems to come from farther off


@dataclass(frozen=True, slots=True, eq=False)
class LedOffset:
    """The apparent place of an LED: ``position + shift(sin^2 angle) * led.axis``, angle between axis and line of sight.

    ``axial_shift`` (k,) m: coefficients of the powers 0, 1, 2, ... of sin^2 angle. Beyond ``up_to_rad`` the shift stays
    what it is there.
    """

    axial_shift: Floats
    up_to_rad: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "axial_shift", frozen_array(self.axial_shift, -1))

    @property
    def limit(self) -> float:
        """sin^2 of ``up_to_rad``."""
        return float(np.sin(self.up_to_rad) ** 2)

    def shift(self, sin2: Floats) -> Floats:
        """Along the axis, m, for any shape of sin^2 of the angle."""
        return np.asarray(np.polynomial.polynomial.polyval(np.minimum(sin2, self.limit), self.axial_shift), np.float64)


def parse_offset(text: str, name: str) -> LedOffset:
    """The offset that the text of a led.yaml describes. Raises InputError with file, key, what was found and what is
    accepted.
    """
    return _offset(parse_yaml(text, name))


def _offset(section: Section) -> LedOffset:
    section.only(("axial_shift", "up_to_deg"))
    values = section.values.get("axial_shift")
    count = len(values) if isinstance(values, list) else 1
    if not 1 <= count <= MOST_TERMS:
        raise section.error("axial_shift", f"{count} values, expected 1 to {MOST_TERMS} coefficients, m")
    shift = np.array(section.numbers("axial_shift", count, "coefficients of the powers of sin^2 of the angle, m"))
    up_to = section.number("up_to_deg", above=0)
    if up_to > 90:
        raise section.error("up_to_deg", f"{up_to:g}, expected at most 90")
    offset = LedOffset(shift, float(np.radians(up_to)))
    largest = float(np.abs(offset.shift(np.linspace(0.0, 1.0, 91))).max())
    if largest > LARGEST_M:
        raise section.error(
            "axial_shift", f"shifts the LED by up to {largest:g} m, expected at most {LARGEST_M:g} m; is that mm?"
        )
    return offset
