"""The kept spots as the matching sees them: undistorted."""

import math
from typing import NamedTuple

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.server.centres.blobs import Blobs, Ints
from asterism.server.compiled import compiled
from asterism.server.identity.plan import Plan
from asterism.server.pose.lens import undistort
from asterism.server.segmentation.spot_table import UNEXPLAINED


class Rays(NamedTuple):
    """Spots; row i of every array is blob ``rows[i]``."""

    rows: Ints
    flat: Floats  # (n, 2) ideal px about the principal point, y up
    rays: Floats  # (n, 2) x / z, y / z
    covariances: Floats  # (n, 3) of the rays
    variances: Floats  # (n,) of the rays, mean of both axes
    heights: Floats  # (n,)
    radii: Floats  # (n,) px

    def first(self, n: int) -> "Rays":
        """The first so many."""
        spots = self.rows[:n], self.flat[:n], self.rays[:n], self.covariances[:n]
        return Rays(*spots, self.variances[:n], self.heights[:n], self.radii[:n])


class Spotted(NamedTuple):
    """What is taken over from the `Blobs`: ``fates`` (n,), ``centres_px`` (n, 2) and ``covariances_px2`` (n, 3),
    ``heights`` and ``radii_px`` (n,).
    """

    fates: Ints
    centres_px: Floats
    covariances_px2: Floats
    heights: Floats
    radii_px: Floats


@compiled
def undistort_kept(lens, focal, blobs, seen):
    """Fill `Rays` with the spots of `Spotted` whose fate is UNEXPLAINED, without those that no ray of the lens model
    reaches; returns how many there are.
    """
    kept = 0
    for k in range(blobs.fates.shape[0]):
        if blobs.fates[k] == UNEXPLAINED:
            seen.rows[kept] = k
            seen.flat[kept, 0], seen.flat[kept, 1] = blobs.centres_px[k, 0], blobs.centres_px[k, 1]
            for i in range(3):
                seen.covariances[kept, i] = blobs.covariances_px2[k, i]
            kept += 1
    spreads = seen.covariances[:kept]
    undistort(lens, seen.flat[:kept], spreads, seen.rays, spreads)
    count = 0
    for k in range(kept):
        x, y = seen.rays[k, 0], seen.rays[k, 1]
        if math.isfinite(x):
            seen.rows[count] = row = seen.rows[k]
            seen.rays[count, 0], seen.rays[count, 1] = x, y
            seen.flat[count, 0], seen.flat[count, 1] = x * focal, y * -focal
            for i in range(3):
                seen.covariances[count, i] = seen.covariances[k, i]
            seen.variances[count] = 0.5 * (seen.covariances[k, 0] + seen.covariances[k, 2])
            seen.heights[count], seen.radii[count] = blobs.heights[row], blobs.radii_px[row]
            count += 1
    return count


def rays_of(blobs: Blobs, plan: Plan) -> Rays:
    """The kept spots, undistorted; what no ray of the lens model reaches is left out."""
    n = len(blobs)
    rows, flat, rays, covariances = np.empty(n, np.int64), np.empty((n, 2)), np.empty((n, 2)), np.empty((n, 3))
    room = Rays(rows, flat, rays, covariances, np.empty(n), np.empty(n), np.empty(n))
    spotted = Spotted(blobs.fates, blobs.centres_px, blobs.covariances_px2, blobs.heights, blobs.radii_px)
    count = undistort_kept(plan.lens, plan.focal, spotted, room)
    return room if count == n else room.first(count)
