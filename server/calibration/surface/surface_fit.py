"""What a calibration of the surface found."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.protocol.surface import Heights, Surface
from asterism.protocol.surface_file import Stands
from asterism.server.calibration.surface.contacts import Contacts


@dataclass(frozen=True, slots=True)
class Score:
    """How well a kind of surface tells touches that it was not fitted to: ``held_out_m``, RMS along the normal with the
    touches' own noise in it; ``numbers``: how many the kind has, of a spline as many as its stiffness leaves it.
    """

    kind: str
    held_out_m: float
    numbers: float


@dataclass(frozen=True, slots=True, eq=False)
class Stood:
    """How a robot stood: in how many of its ``touches``, ``used``; how far its point is off what all robots say, by
    LEDs or by the point itself: ``offset_m`` along the normal, positive above, +- ``offset_sigma_m``; what its distance
    scatters beside its poses' noise, ``play_m``; where its axis leans from the normal on average, ``lean_rad``, and
    how much that scatters beside the poses' noise, ``sway_rad``. ``stands`` is what the rig may say of it.
    """

    id: str
    touches: int
    used: int
    offset_m: float
    offset_sigma_m: float
    play_m: float
    lean_rad: float
    sway_rad: float
    stands: Stands


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceFit:
    """The ``surface`` in the world, of the ``kind`` that tells best what it was not fitted to, and the ``scores`` of
    every kind tried, the simplest first.

    ``map`` is the surface on a grid in its own frame, with one sigma of the height along the normal at every node, nan
    where no robot was, whatever the kind: with what all touches share and what a surface so stiff cannot follow.
    ``contacts`` are all touches; ``used`` (n,) those that count; ``distances`` (n,) m of each above the surface along
    the normal, its robot's own offset left in; ``sigmas`` (n,) m of their noise. ``rms_m``: of those that are used,
    offsets taken off. ``robots`` by `Contacts.ids`.
    """

    surface: Surface
    kind: str
    scores: tuple[Score, ...]
    map: Heights
    contacts: Contacts
    used: NDArray[np.bool_]
    distances: Floats
    sigmas: Floats
    rms_m: float
    robots: tuple[Stood, ...]

    @property
    def area_m2(self) -> float:
        """Of the surface where robots were."""
        steps = self.map.step
        slopes = np.gradient(self.map.values, *steps)
        there = np.isfinite(self.map.values)
        stretched = np.sqrt(1.0 + np.nan_to_num(slopes[0]) ** 2 + np.nan_to_num(slopes[1]) ** 2)
        return float(stretched[there].sum() * steps.prod())
