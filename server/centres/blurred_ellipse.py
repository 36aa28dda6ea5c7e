"""The model that spots are fitted with, a blurred ellipse, pixel by pixel in single precision: distance and profile."""

import math

from asterism.server.compiled import compiled_sums
from asterism.server.segmentation.pixels import HALF, ONE, TWO, ZERO, f32

REACH = 4.5  # sigmas of blur beyond which the edge is over
TINY = f32(1e-12)
REACH32 = f32(REACH)


@compiled_sums
def distance_to_ellipse(dx, dy, cos, sin, per_a2, per_b2):
    """Distance of a pixel to the ellipse, px, positive inside, and what its derivatives are made of.

    Returns u, v (the pixel along the axes), u / a^2, v / b^2, distance, and the factors ``outward`` and ``bend`` of
    d distance = outward (pu du + pv dv) - bend (pu du / a^2 + pv dv / b^2).
    """
    u, v = cos * dx + sin * dy, cos * dy - sin * dx
    pu, pv = u * per_a2, v * per_b2
    slope2 = pu * pu + pv * pv + TINY
    reach2 = u * pu + v * pv + TINY
    # Roots and quotients are what takes the time: two of each are made to do.
    reach = math.sqrt(reach2)
    per_both = ONE / math.sqrt(slope2 * reach2)
    per_slope = reach * per_both
    distance = (reach - reach2) * per_slope
    return u, v, pu, pv, distance, per_both - TWO * per_slope, distance * per_slope * per_slope


@compiled_sums
def gauss(square):
    """exp(-square / 2) at square <= REACH^2: the sixteenth power of a polynomial, 1e-4 of itself at the far end."""
    s = square * f32(0.5 / 16.0)
    e = ONE - s * (ONE - s * (HALF - s * (f32(1.0 / 6.0) - s * (f32(1.0 / 24.0) - s * f32(1.0 / 120.0)))))
    e = e * e
    e = e * e
    e = e * e
    return e * e


@compiled_sums
def normal(t):
    """The normal distribution function and its density at |t| <= REACH.

    Both are made of polynomials (that of the former by least squares on Chebyshev nodes, 4e-6): what wide registers are
    good at.
    """
    r = t * t * f32(1.0 / (REACH * REACH))
    f = f32(5.52169579) - f32(0.946988853) * r
    f = f * r - f32(14.3616313)
    f = f * r + f32(22.1794949)
    f = f * r - f32(22.9223258)
    f = f * r + f32(16.997319)
    f = f * r - f32(9.46363688)
    f = f * r + f32(4.05310171)
    f = f * r - f32(1.3448406)
    f = f * r + f32(0.398921712)
    e = f32(0.3989422804014327) * gauss(t * t)
    return HALF + t * f, e if abs(t) < REACH32 else ZERO
