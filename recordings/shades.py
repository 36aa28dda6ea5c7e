"""Numbers as colours: from dark blue over green to yellow, evenly bright from step to step.

Source: viridis (van der Walt, Smith: "A better default colormap for matplotlib", 2015), every eighth of its way.
"""

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats

_ANCHORS = np.array([
    (68, 1, 84), (71, 45, 123), (59, 82, 139), (44, 114, 142), (33, 145, 140), (40, 174, 128), (94, 201, 98),
    (173, 220, 48), (253, 231, 37),
], np.float64)  # fmt: skip


def shades(shares: Floats) -> NDArray[np.uint8]:
    """Red, green, blue (n, 3) uint8 of shares (n,) from 0 to 1; what is beyond is as its end."""
    places = np.linspace(0.0, 1.0, len(_ANCHORS))
    channels = [np.interp(shares, places, channel) for channel in _ANCHORS.T]
    return np.stack(channels, axis=-1).round().astype(np.uint8)
