"""Rotations of many at once, as `protocol.geometry` has them one by one."""

import numpy as np

from asterism.protocol.geometry import Floats, log_rotation

SMALL2 = 1e-12  # rad^2, below which an angle is taken for so large
SMALL = 1e-150
HALF_TURN = -0.99  # its cosine, nearly


def hats(vectors: Floats) -> Floats:
    """The matrices (..., 3, 3) that take the cross product with vectors (..., 3)."""
    out = np.zeros((*vectors.shape, 3))
    out[..., 2, 1], out[..., 0, 2], out[..., 1, 0] = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    out[..., 1, 2], out[..., 2, 0], out[..., 0, 1] = -vectors[..., 0], -vectors[..., 1], -vectors[..., 2]
    return out


def exp_rotations(vectors: Floats) -> Floats:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3), rad (Rodrigues)."""
    angle2 = np.maximum(np.sum(vectors * vectors, axis=-1), SMALL2)[..., None, None]
    angle = np.sqrt(angle2)
    hat = hats(vectors)
    turned: Floats = np.eye(3) + np.sin(angle) / angle * hat + (1.0 - np.cos(angle)) / angle2 * (hat @ hat)
    return turned


def log_rotations(rotations: Floats) -> Floats:
    """Rotation vectors (..., 3), rad, length at most pi, of rotation matrices (..., 3, 3)."""
    across = 0.5 * (rotations - np.swapaxes(rotations, -1, -2))
    vectors: Floats = np.stack([across[..., 2, 1], across[..., 0, 2], across[..., 1, 0]], axis=-1)
    sine = np.sqrt(np.sum(vectors * vectors, axis=-1))
    cosine = 0.5 * (np.trace(rotations, axis1=-2, axis2=-1) - 1.0)
    vectors *= (np.arctan2(sine, cosine) / np.maximum(sine, SMALL))[..., None]
    # Half a turn has lost its axis there.
    for place in map(tuple, np.argwhere(cosine < HALF_TURN)):
        vectors[place] = log_rotation(rotations[place])
    return vectors
