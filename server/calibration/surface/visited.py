"""Where robots were: nodes of a grid over a surface's x and y, and the outline of that."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from asterism.protocol.geometry import Floats

GAP_M = 0.03  # between two ways: what is narrower is no hole
MARGIN_M = 0.005  # about where touches were
LEAST_STEP_M = 0.005
MOST_NODES = 120  # along the longer side


@dataclass(frozen=True, slots=True, eq=False)
class Visited:
    """Nodes at ``origin`` (2,) + (i, j) * ``step``, m, and whether robots were at each (nx, ny)."""

    origin: Floats
    step: float
    there: NDArray[np.bool_]

    @property
    def nodes(self) -> Floats:
        """Where they are (nx * ny, 2) m."""
        i, j = np.indices(self.there.shape)
        places: Floats = self.origin + self.step * np.stack([i, j], axis=-1).reshape(-1, 2)
        return places

    @staticmethod
    def by(xy: Floats) -> "Visited":
        """Of touches at (n, 2) m: a little about each, and what lies between two that are near each other."""
        pad = GAP_M + 2.0 * LEAST_STEP_M
        low, high = xy.min(axis=0) - pad, xy.max(axis=0) + pad
        step = max(LEAST_STEP_M, float((high - low).max()) / MOST_NODES)
        shape = np.ceil((high - low) / step).astype(np.int64) + 1
        near = np.ones(shape, np.bool_)
        i, j = np.rint((xy - low) / step).astype(np.int64).T
        near[i, j] = False
        around = distance_transform_edt(near) * step <= 0.5 * GAP_M
        inside = distance_transform_edt(around) * step
        there = inside > 0.5 * GAP_M - MARGIN_M
        return Visited(low, step, np.asarray(there, np.bool_)).cropped()

    def cropped(self) -> "Visited":
        """Without the rows and columns at its sides where nobody was."""
        i, j = np.nonzero(self.there)
        i0, i1, j0, j1 = i.min(), i.max() + 1, j.min(), j.max() + 1
        return Visited(self.origin + self.step * np.array([i0, j0]), self.step, self.there[i0:i1, j0:j1])

    def outline(self) -> Floats:
        """One polygon (k, 2) m about it: rings about every part and hole, joined by lines that are gone there and back,
        which a ray crosses twice.
        """
        import cv2

        padded = np.pad(self.there.astype(np.uint8), 1)
        found, _ = cv2.findContours(padded, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
        rings = [cv2.approxPolyDP(ring, 0.5, True).reshape(-1, 2)[:, ::-1] - 1 for ring in found]
        rings = sorted((ring for ring in rings if len(ring) >= 3), key=len, reverse=True)
        if not rings:
            return np.zeros((0, 2))
        joined = [np.concatenate([ring, ring[:1]]) for ring in rings]
        back = [ring[:1] for ring in rings[-2::-1]] if len(rings) > 1 else []
        places: Floats = self.origin + self.step * np.concatenate([*joined, *back]).astype(np.float64)
        return places
