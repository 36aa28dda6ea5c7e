"""Touches in patches of a few mm taken together, so that thousands of them can be reckoned with jointly."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.calibration.surface.contacts import Contacts
from asterism.server.calibration.surface.register_left import Left

MOST_UNITS = 1000
FINEST_M = 0.004  # of a patch


class Units(NamedTuple):
    """u patches: touches ``off`` the drawing by (u,) m with ``variances``, on average; how that changes as the drawing
    moves, ``by_pose`` (u, 6), and with causes that a robot's touches share and its own offset, the last, ``by_robots``
    (u, r (k + 1)); their ``places`` (u, 3) m in the world. Patches have sides of ``size_m``.
    """

    off: Floats
    variances: Floats
    by_pose: Floats
    by_robots: Floats
    places: Floats
    size_m: float


def units_of(left: Left, contacts: Contacts, used: NDArray[np.bool_], most: int = MOST_UNITS) -> Units:
    """Touches that are ``used`` in patches as small as can be, ``most`` of them at most."""
    size = FINEST_M
    while True:
        # By places in the drawing and not in the world: height, the worst known, has no say in what is together.
        _, index = np.unique(np.floor(left.xy[used] / size).astype(np.int64), axis=0, return_inverse=True)
        count = int(index.max()) + 1
        if count <= most:
            break
        size *= 1.1
    index = index.reshape(-1)
    weights = 1.0 / left.variances[used]
    total = np.bincount(index, weights, count)

    def mean(values: Floats) -> Floats:
        columns = values[used].reshape(len(index), -1).T
        return np.column_stack([np.bincount(index, weights * column, count) / total for column in columns])

    off = mean(left.off)[:, 0]
    return Units(off, 1.0 / total, mean(left.by_pose), mean(by_robots(left, contacts)), mean(contacts.points), size)


def by_robots(left: Left, contacts: Contacts) -> Floats:
    """How touches depend on every robot's causes and offset (n, r (k + 1))."""
    own = np.concatenate([left.by_causes, np.ones((len(contacts), 1))], axis=1)
    whose = (contacts.robots[:, None] == np.arange(len(contacts.ids))).astype(np.float64)
    return np.asarray((whose[:, :, None] * own[:, None]).reshape(len(contacts), -1))
