"""How well light alone lets the centre of an LED's image be known: the Cramer-Rao bound, as a function of its size.

The image is a uniform ellipse blurred by a Gaussian point spread and summed over pixels, exactly, on a plane of
background. Noise is read noise, shot noise and rounding. An ellipse looks the same from both sides of its centre, so
that brightness, level, axes and blur do not mix with the centre; the slopes of the background do and are unknown as
well. The edge model (`edge_model`) comes within a few percent of this bound.
"""

import math
from functools import lru_cache

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.special import ndtr

from asterism.protocol.geometry import Floats
from asterism.server.simulation.simulate import Look, quadrature

ROUNDING = 1.0 / 12.0  # variance of rounding to whole grey levels
LEAST_ASPECT = 0.2  # ellipses flatter than that are taken as that flat
_RADII = np.geomspace(0.3, 40.0, 18)  # px
_ASPECTS = np.linspace(LEAST_ASPECT, 1.0, 6)


def centre_variances(a: float, b: float, level: float, look: Look, rounding: bool) -> tuple[float, float]:
    """Least variances, px^2, of an ellipse's centre along its semi-axes ``a`` and ``b`` (px), at best estimation.

    ``level`` is the light in grey levels where the ellipse is not dimmed by its blur; ``rounding`` adds that of the
    grey levels to the noise of ``look``.
    """
    half = math.ceil(max(a, b) + 4.0 * look.psf_px + 2.0)
    edges = np.arange(-half, half + 2, dtype=np.float64) - 0.5
    nodes, weights, spokes = quadrature(max(a, b), look.psf_px)
    angles = 2.0 * math.pi * (np.arange(spokes)[None] + 0.5 * (np.arange(len(nodes)) % 2)[:, None]) / spokes
    radii = np.sqrt(nodes)[:, None]
    share = np.repeat(math.pi * a * b * weights / spokes, spokes)
    points_x: Floats = (a * radii * np.cos(angles)).ravel()
    points_y: Floats = (b * radii * np.sin(angles)).ravel()
    across, slope_x = _blurred(points_x, edges, look.psf_px)
    down, slope_y = _blurred(points_y, edges, look.psf_px)
    shine = level * (down * share[:, None]).T @ across
    by_x = level * (down * share[:, None]).T @ slope_x
    by_y = level * (slope_y * share[:, None]).T @ across
    v, u = np.mgrid[-half : half + 1, -half : half + 1]
    weight = 1.0 / (look.read_noise**2 + look.gain * shine + (ROUNDING if rounding else 0.0))
    jacobian = np.stack([by_x, by_y, u, v], axis=-1).reshape(-1, 4)
    bound = np.linalg.inv(jacobian.T @ (weight.reshape(-1, 1) * jacobian))
    return float(bound[0, 0]), float(bound[1, 1])


def _blurred(places: Floats, edges: Floats, psf: float) -> tuple[Floats, Floats]:
    """Share (n, pixels) of a point's light in every pixel of a row, and its derivative by the point's place."""
    away = (edges[None] - places[:, None]) / psf
    density = np.exp(-0.5 * away * away) / (psf * math.sqrt(2.0 * math.pi))
    return np.diff(ndtr(away), axis=1), -np.diff(density, axis=1)


@lru_cache(maxsize=8)
def _table(look: Look, rounding: bool) -> RegularGridInterpolator:
    """Logarithms of both variances over the long semi-axis, by its logarithm, and the aspect, which dims it too."""
    values = np.array(
        [[centre_variances(a, q * a, q * look.brightness, look, rounding) for q in _ASPECTS] for a in _RADII]
    )
    return RegularGridInterpolator((np.log(_RADII), _ASPECTS), np.log(values), method="cubic")


def centre_covariances(
    points: Floats, normals: Floats, radius: float, focal: float, look: Look
) -> tuple[Floats, Floats]:
    """Covariances (..., 2, 2) px^2 of the centres of LEDs' images: from noise without rounding, and what rounding adds.

    ``points`` (..., 3) and unit ``normals`` (..., 3) of the discs in the camera's frame, ``radius`` m, ``focal`` px.
    """
    depth = points[..., 2]
    aspect = np.abs(np.einsum("...i,...i", points, normals)) / np.linalg.norm(points, axis=-1)
    # The short axis lies along the image of the normal.
    short = normals[..., :2] - points[..., :2] * (normals[..., 2:] / points[..., 2:])
    length = np.linalg.norm(short, axis=-1, keepdims=True)
    short = np.where(length > 1e-9, short / np.maximum(length, 1e-9), [1.0, 0.0])
    long = np.stack([-short[..., 1], short[..., 0]], axis=-1)
    at = np.stack(
        [
            np.log(np.clip(radius * focal / depth, _RADII[0], _RADII[-1])),
            np.clip(aspect, LEAST_ASPECT, 1.0),
        ],
        axis=-1,
    )
    along, across = long[..., :, None] * long[..., None, :], short[..., :, None] * short[..., None, :]
    both = []
    for rounding in (False, True):
        variances = np.exp(_table(look, rounding)(at))
        both.append(variances[..., :1, None] * along + variances[..., 1:, None] * across)
    return both[0], both[1] - both[0]
