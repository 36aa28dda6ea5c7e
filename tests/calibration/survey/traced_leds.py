"""LEDs under glass traced ray by ray, by Snell's law in vector form: nothing is shared with the product's formulas.

The ray that ends in the camera's centre (the origin) is searched for; the point where it leaves the glass is where the
camera sees the LED.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from asterism.protocol.geometry import Floats


@dataclass(frozen=True)
class Cover:
    """Glass over a chip: a dome about the LED's position, or (``radius`` None) a flat window through it.

    ``depth`` m of the chip below the LED's position. ``reflection`` is the further shift, m, across the line of sight
    and away from the axis, by the angle (rad) the LED is seen at.
    """

    index: float
    radius: float | None
    depth: float
    reflection: Callable[[float], float] = lambda _: 0.0


def reflected(alpha: float) -> float:
    """A wall that comes into view at about 35 degrees: up to 0.12 mm."""
    return 0.12e-3 * (1.0 / (1.0 + np.exp(-(np.degrees(alpha) - 35.0) / 6.0)) - 1.0 / (1.0 + np.exp(35.0 / 6.0)))


DOME = Cover(1.5, 2.5e-3, 1.25e-3, reflected)
WINDOW = Cover(1.52, None, 1.0e-3, reflected)


def seen_at(cover: Cover, led: Floats, axis: Floats) -> Floats:
    """The point (3,) in whose direction the camera sees an LED at ``led`` with unit ``axis``, camera's frame, m."""
    across = -led - (-led @ axis) * axis
    width = float(np.linalg.norm(across))
    if width < 1e-12:
        return led
    across = across / width
    camera = np.array([-led @ axis, width])  # along the axis, across it

    def leaves(phi: float) -> tuple[Floats, Floats]:
        """Where and in which direction a ray leaves that starts at phi to the axis."""
        start, way = np.array([-cover.depth, 0.0]), np.array([np.cos(phi), np.sin(phi)])
        if cover.radius is None:
            point, normal = start + way * cover.depth / way[0], np.array([1.0, 0.0])
        else:
            middle = start @ way
            point = start + way * (-middle + np.sqrt(middle**2 - start @ start + cover.radius**2))
            normal = point / cover.radius
        cosine = way @ normal
        out = cover.index * way
        out = out + (np.sqrt(1.0 - cover.index**2 * (1.0 - cosine**2)) - cover.index * cosine) * normal
        return point, out

    def misses(phi: float) -> float:
        point, out = leaves(phi)
        to = camera - point
        return float(out[0] * to[1] - out[1] * to[0])

    steepest = np.arcsin(1.0 / cover.index) - 1e-9 if cover.radius is None else np.pi / 2
    point, _ = leaves(brentq(misses, 0.0, steepest, xtol=1e-15, rtol=1e-14))
    place = led + point[0] * axis + point[1] * across
    # The reflection moves it across the line of sight, away from the side the camera is on.
    sight = place / np.linalg.norm(place)
    away = -across - (-across @ sight) * sight
    alpha = float(np.arctan2(width, camera[0]))
    shifted: Floats = place + cover.reflection(alpha) * away / np.linalg.norm(away)
    return shifted
