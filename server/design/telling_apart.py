"""What a separation of constellations is worth in an image.

A separation d, m, is d f / Z px at distance Z, and cos(tilt) of that where the plate leans along it. One constellation
is taken for another with probability Q(d_px / 2 sigma), sigma the standard deviation of a centre: SIGMAS of it, 3e-7.
"""

import math

SIGMAS = 10.0
TILT_DEG = 60.0  # the worst that is reckoned with


def image_px(separation_m: float, focal_px: float, distance_m: float, tilt_deg: float = TILT_DEG) -> float:
    """The least separation in the image, px, at that distance and tilt."""
    return separation_m * focal_px / distance_m * math.cos(math.radians(tilt_deg))


def needed_m(sigma_px: float, focal_px: float, distance_m: float, tilt_deg: float = TILT_DEG) -> float:
    """The separation, m, that is SIGMAS ``sigma_px`` in the image at that distance and tilt."""
    return SIGMAS * sigma_px / image_px(1.0, focal_px, distance_m, tilt_deg)
