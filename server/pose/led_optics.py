"""Refraction at an LED's cover, by Snell's law: where its light seems to come from, by the angle it is seen at.

`dome_depth` and `window_depth` return how far below the reference point a ray that leaves at an angle ``alpha`` to the
axis crosses the axis when prolonged backwards; the axial shift of `protocol.led_offset` is minus that.
"""

import numpy as np

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats

LARGEST_INDEX = 3.0
LARGEST_M = 0.05  # of an LED


def check_cover(dome: tuple[float, ...] | None, window: tuple[float, ...] | None) -> None:
    """Raise InputError for a cover that cannot be."""
    if dome is not None:
        index, radius, depth = dome
        told = f"--dome {index:g},{radius:g},{depth:g}"
        if not (1.0 < index < LARGEST_INDEX and depth < radius / index):
            raise InputError(
                f"{told}: expected an index from 1 to {LARGEST_INDEX:g}, the dome's radius, and how far the chip is "
                "below its centre, less than radius / index, m"
            )
        _check_size(told, max(radius, depth))
    if window is not None:
        index, depth = window
        told = f"--window {index:g},{depth:g}"
        if not 1.0 < index < LARGEST_INDEX:
            raise InputError(f"{told}: expected an index from 1 to {LARGEST_INDEX:g}, then the chip's depth, m")
        _check_size(told, depth)


def _check_size(told: str, size: float) -> None:
    if size > LARGEST_M:
        raise InputError(f"{told}: a length of {size:g} m, expected m, at most {LARGEST_M:g}; is that mm?")


def dome_depth(index: float, radius: float, depth: float, alpha: Floats) -> Floats:
    """Apparent depth (n,) m below the dome's centre O of a chip at ``depth`` below O, dome of ``radius``, m.

    A ray leaves the chip at phi to the axis and meets the dome at Q. In the triangle chip, O, Q the law of sines gives
    the angle of incidence, sin i = (depth / radius) sin phi; Snell sin r = index sin i; the normal at Q stands at
    phi + i, so the ray goes on at alpha = phi + i - r. Its distance from O is radius sin r = index depth sin phi, so it
    crosses the axis index depth sin phi / sin alpha below O. Near the axis that is index depth /
    (1 - (index - 1) depth / radius). phi of alpha is found by bisection, which needs alpha to grow with phi: it does
    where depth < radius / index, the dome then being no magnifier that casts all light into a beam.

    Raises InputError for a dome through which the angles asked for are not seen.
    """
    low, high = np.zeros_like(alpha), np.full_like(alpha, np.pi / 2)
    for _ in range(60):
        phi = 0.5 * (low + high)
        too_far = _leaves_at(index, radius, depth, phi) > alpha
        low, high = np.where(too_far, low, phi), np.where(too_far, phi, high)
    if (_leaves_at(index, radius, depth, high) < alpha - 1e-6).any():
        raise InputError(
            f"--dome {index:g},{radius:g},{depth:g}: no light of the chip leaves it at "
            f"{np.degrees(alpha.max()):.0f} degrees, at which robots were seen; are these index, radius, depth, m?"
        )
    paraxial = 1.0 - (index - 1.0) * depth / radius
    near = alpha < 1e-6
    ratio = np.where(near, 1.0 / paraxial, np.sin(0.5 * (low + high)) / np.where(near, 1.0, np.sin(alpha)))
    depths: Floats = index * depth * ratio
    return depths


def _leaves_at(index: float, radius: float, depth: float, phi: Floats) -> Floats:
    incidence = np.arcsin(depth / radius * np.sin(phi))
    angle: Floats = phi + incidence - np.arcsin(np.minimum(index * np.sin(incidence), 1.0))
    return angle


def window_depth(index: float, depth: float, alpha: Floats) -> Floats:
    """Apparent depth (n,) m below a flat window of a chip at ``depth`` below it.

    Snell: sin alpha = index sin phi. The ray meets the window depth tan phi from the axis, so it crosses the axis
    depth tan phi / tan alpha = depth cos alpha / sqrt(index^2 - sin^2 alpha) below it.
    """
    depths: Floats = depth * np.cos(alpha) / np.sqrt(index**2 - np.sin(alpha) ** 2)
    return depths
