"""Where robots were: nodes of a grid over a surface's x and y, and the outline of that."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from asterism.protocol.geometry import Floats
from asterism.protocol.surface import crossing

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
        reach = 0.5 * GAP_M + step / np.sqrt(2.0)  # touches are taken to the nearest node
        around = distance_transform_edt(near) * step <= reach
        inside = distance_transform_edt(around) * step
        there = inside > reach - MARGIN_M
        return Visited(low, step, np.asarray(there, np.bool_)).cropped()

    def cropped(self) -> "Visited":
        """Without the rows and columns at its sides where nobody was."""
        i, j = np.nonzero(self.there)
        i0, i1, j0, j1 = i.min(), i.max() + 1, j.min(), j.max() + 1
        return Visited(self.origin + self.step * np.array([i0, j0]), self.step, self.there[i0:i1, j0:j1])

    def outline(self) -> Floats | None:
        """The polygon (k, 2) m about it; None where it is in parts, has holes, or is too narrow for one."""
        import cv2

        padded = np.pad(self.there.astype(np.uint8), 1)
        found, _ = cv2.findContours(padded, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
        if len(found) != 1:
            return None
        ring = cv2.approxPolyDP(found[0], 0.5, True).reshape(-1, 2)[:, ::-1] - 1
        places: Floats = self.origin + self.step * ring.astype(np.float64)
        return places if len(ring) >= 3 and crossing(places) is None else None
