"""How far apart constellations are, by trying every labelling: slow, obvious, and without anything of the product's."""

import itertools
from collections.abc import Sequence

import numpy as np
from scipy.linalg import null_space

from asterism.protocol.geometry import Floats


def brute_force(layouts: Sequence[Floats], hidden: int, mirrors: bool) -> Floats:
    """Separations (n, n), m: row what is seen, column what it would be taken for.

    Every order of every 6 - ``hidden`` LEDs of the one (720 either way), against every choice of as many of the other:
    what the best affine map leaves is the part of the seen LEDs in the null space of the other's (x, y, 1). With
    ``mirrors`` maps of negative determinant count as well.
    """
    count = 6 - hidden
    orders = list(itertools.permutations(range(6), count))
    chosen = list(itertools.combinations(range(6), count))
    found = np.full((len(layouts), len(layouts)), np.inf)
    seen_points = np.stack([layout[np.array(orders)] for layout in layouts])  # (n, orders, count, 2)
    for taken, layout in enumerate(layouts):
        for leds in chosen:
            homogeneous = np.column_stack([layout[list(leds)], np.ones(count)])
            left = np.einsum("kc,nocx->nokx", null_space(homogeneous.T).T, seen_points)
            residual = np.sqrt((left**2).sum(axis=(2, 3)))  # (n, orders)
            if not mirrors:
                maps = np.einsum("kc,nocx->nokx", np.linalg.pinv(homogeneous)[:2], seen_points)
                residual[np.linalg.det(maps) < 0] = np.inf
            residual[taken, orders.index(leds)] = np.inf  # every LED in its own place
            found[:, taken] = np.minimum(found[:, taken], residual.min(axis=1))
    return found
