"""Second moments of the light of robots that moved while the shutter was open: how far each LED's spot is drawn out.

A spot that moves by d (px) during the exposure has d d' / 12 in its second moments beside those of the resting spot.
"""

import math

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.segmentation.spot_table import (
    ANGLE,
    LEVEL,
    SEMI_A,
    SEMI_B,
    SLOPE_X,
    SLOPE_Y,
    TOUCHING,
    WX0,
    WX1,
    WY0,
    WY1,
)

# Semi-axes' ratio, seen from the front, from which on a robot's spots are streaks: 0.6 times as long as they are wide.
# What a shorter one does to the centres is less than a tenth of what one does that is twice as long as wide.
DRAWN_OUT = 1.2
FEWEST = 4  # spots whose moments tell a motion


@compiled
def _is_drawn_out(spots, rows, rotation, t):
    """Whether the spots of a robot, rows (6,) of the table, are streaks: on average no discs at T_camera_plane.

    A tilted disc is flat along the image of its normal, the less so the more the lens blurs it. So what it is stretched
    by there, to be round, is asked of the spots themselves, between nothing and what the tilt alone would make it.
    """
    ex = rotation[0, 2] - t[0] * rotation[2, 2] / t[2]
    ey = rotation[1, 2] - t[1] * rotation[2, 2] / t[2]
    length = max(math.sqrt(ex * ex + ey * ey), 1e-9)
    ex, ey = ex / length, ey / length
    facing = abs(rotation[0, 2] * t[0] + rotation[1, 2] * t[1] + rotation[2, 2] * t[2])
    most = (math.sqrt(t[0] ** 2 + t[1] ** 2 + t[2] ** 2) / max(facing, 0.1)) ** 2
    along = across = 0.0
    for k in rows:
        if k >= 0:
            ee, _, ff = _turned(spots[k], ex, ey)
            along, across = along + ee, across + ff
    stretch = min(max(across / max(along, 1e-9), 1.0), most)
    drawn, count = 0.0, 0
    for k in rows:
        if k >= 0:
            ee, ef, ff = _turned(spots[k], ex, ey)
            u, v = stretch * ee, math.sqrt(stretch) * ef
            half = math.sqrt((0.5 * (u - ff)) ** 2 + v * v)
            drawn += (0.5 * (u + ff) + half) / max(0.5 * (u + ff) - half, 1e-3)
            count += 1
    return drawn > DRAWN_OUT**2 * count


@compiled
def _turned(spot, ex, ey):
    """The spot's squared semi-axes as a matrix, along the direction (ex, ey), mixed, and across it."""
    a2, b2, angle = spot[SEMI_A] ** 2, spot[SEMI_B] ** 2, spot[ANGLE]
    c, s = math.cos(angle) * ex + math.sin(angle) * ey, math.sin(angle) * ex - math.cos(angle) * ey
    return a2 * c * c + b2 * s * s, (b2 - a2) * c * s, a2 * s * s + b2 * c * c


@compiled
def _moments(image, spot, out):
    """Fill ``out`` (3,) with the second moments xx, xy, yy px^2 of the light in a spot's window."""
    x0, x1, y0, y1 = int(spot[WX0]), int(spot[WX1]), int(spot[WY0]), int(spot[WY1])
    middle_x, middle_y = 0.5 * (x0 + x1 - 1), 0.5 * (y0 + y1 - 1)
    s = sx = sy = sxx = sxy = syy = 0.0
    for y in range(y0, y1):
        for x in range(x0, x1):
            u, v = x - middle_x, y - middle_y
            q = image[y, x] - (spot[LEVEL] + spot[SLOPE_X] * u + spot[SLOPE_Y] * v)
            s += q
            sx += q * u
            sy += q * v
            sxx += q * u * u
            sxy += q * u * v
            syy += q * v * v
    if s <= 0.0:
        return False
    out[0], out[1], out[2] = sxx / s - (sx / s) ** 2, sxy / s - sx * sy / (s * s), syy / s - (sy / s) ** 2
    return out[0] > 0.0 and out[2] > 0.0


@compiled
def streak_moments(image, spots, robots, rotations, ts, moments):
    """Fill ``moments`` (m, 6, 3) px^2 of the LEDs of robots whose spots are streaks; returns how many these are.

    ``robots`` (m, 6) are the rows of their LEDs' spots in the spot table ``spots``, -1 for those not seen;
    ``rotations`` (m, 3, 3) and ``ts`` (m, 3) T_camera_plane. nan: not told, or no streak.
    """
    count = 0
    for k in range(robots.shape[0]):
        moments[k, :, :] = np.nan
        rows = robots[k]
        if not _is_drawn_out(spots, rows, rotations[k], ts[k]):
            continue
        told = 0
        for led in range(rows.shape[0]):
            if rows[led] >= 0 and spots[rows[led], TOUCHING] == 0.0:
                if _moments(image, spots[rows[led]], moments[k, led]):
                    told += 1
                else:
                    moments[k, led, :] = np.nan
        if told < FEWEST:
            moments[k, :, :] = np.nan
        else:
            count += 1
    return count
