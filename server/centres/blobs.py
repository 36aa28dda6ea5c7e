"""Every bright spot of a frame, with its sub-pixel centre and its fate."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.protocol.messages import Fate
from asterism.server.centres.centre import refine_centres
from asterism.server.segmentation.segment import Scratch, describe, segment

Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Blobs:
    """n bright spots; row i of every array is the same spot.

    ``centres_px`` (n, 2); ``covariances_px2`` (n, 3) xx, xy, yy of the centres (0 for rejected spots); ``heights``
    (n,) grey levels above the local background; ``radii_px`` (n,); ``fates`` (n,) as in the frame report;
    ``robots`` and ``leds`` (n,) say whose LED it is, -1 for nobody's (robots in the rig's order); ``table`` is the spot
    table they come from.
    """

    centres_px: Floats
    covariances_px2: Floats
    heights: Floats
    radii_px: Floats
    fates: Ints
    robots: Ints
    leds: Ints
    table: Floats

    def __len__(self) -> int:
        return len(self.fates)

    @property
    def kept(self) -> Ints:
        """Rows of the spots that were not rejected."""
        return np.flatnonzero((self.fates == Fate.UNEXPLAINED) | (self.fates == Fate.LED))


def find_blobs(
    image: NDArray[np.uint8],
    largest_radius_px: float,
    masks: Ints,
    estimator: str,
    scratch: Scratch,
) -> Blobs:
    """Segment an (h, w) uint8 image and centre what looks like an LED.

    ``masks`` (m, 4) are x0, y0, x1, y1 px inclusive; ``estimator`` is one of protocol.rig.ESTIMATORS.
    """
    n = segment(image, largest_radius_px, masks, scratch)
    spots = scratch.spots[:n].copy()
    centres, covariances = np.empty((n, 2)), np.empty((n, 3))
    refine_centres(image, spots, estimator, centres, covariances)
    heights, radii = np.empty(n), np.empty(n)
    fates, robots, leds = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n, np.int64)
    describe(spots, heights, radii, fates, robots, leds)
    return Blobs(centres, covariances, heights, radii, fates, robots, leds, spots)
