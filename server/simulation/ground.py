"""What simulated robots drive on: a free-form workpiece of the simulation's own, or the surface that their rig has."""

import math
from typing import Protocol

import numpy as np

from asterism.protocol.surface import Surface


class Ground(Protocol):
    """Heights over a table."""

    def at(self, x: float, y: float) -> tuple[float, float, float]:
        """Height at (x, y) m from the table's middle, m, and its slopes."""
        ...


class Workpiece:
    """A free-form workpiece on a table that reaches to ``half_x`` m to both sides."""

    def __init__(self, half_x: float) -> None:
        self._size = max(half_x, 0.1)

    def at(self, x: float, y: float) -> tuple[float, float, float]:
        """Height at (x, y) m from the table's middle, m, and its slopes."""
        rise = 0.16 * self._size
        k = 2.1 / self._size
        height = rise * math.cos(k * x) * math.cos(0.8 * k * y)
        slope_x = -rise * k * math.sin(k * x) * math.cos(0.8 * k * y)
        slope_y = -rise * 0.8 * k * math.cos(k * x) * math.sin(0.8 * k * y)
        return height, slope_x, slope_y


class RigSurface:
    """A rig's surface, in its own frame but for its ``middle`` (x, y) m, where the table's is."""

    def __init__(self, surface: Surface, middle: tuple[float, float]) -> None:
        self._surface = surface
        self._middle = np.array(middle)

    def at(self, x: float, y: float) -> tuple[float, float, float]:
        """Height at (x, y) m from the table's middle, m, and its slopes."""
        ground = self._surface.ground(self._middle + np.array([x, y]))
        return float(ground.heights[0]), float(ground.slopes[0, 0]), float(ground.slopes[0, 1])
