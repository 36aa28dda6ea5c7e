"""Centre of a spot by fitting a blurred ellipse to its pixels: the default estimator.

Model: grey level = plane + height * Phi(d / s), with d the first-order signed distance of the pixel to the ellipse
(positive inside), Phi the normal distribution function and s the blur of point spread and pixel together. The shape
comes from the spot's moments; the centre is refined by Fisher scoring, every pixel weighted with its own variance
(read noise plus shot noise). It reaches 1.0 to 1.1 times the Cramer-Rao bound for radii from 1.5 px on.
"""

import math

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.spots import (
    ANGLE,
    HEIGHT,
    LEVEL,
    NOISE,
    SEMI_A,
    SEMI_B,
    SLOPE_X,
    SLOPE_Y,
    WX0,
    WX1,
    WY0,
    WY1,
    X,
    Y,
)

_REACH = 4.5  # sigmas of blur that the table spans
_STEPS = 512  # table entries each side of zero
_T = np.linspace(-_REACH, _REACH, 2 * _STEPS + 1)
_STEP = np.array([0.5 * (1.0 + math.erf(t / math.sqrt(2.0))) for t in _T])
_BELL = np.exp(-0.5 * _T * _T) / math.sqrt(2.0 * math.pi)

EVENNESS = 0.004  # of a spot's light: how uneven the model's own error leaves what is outside the ellipse, one sigma
OUTSIDE = (_REACH - 1.0) * _STEPS / _REACH  # table position of a pixel one sigma of blur outside the edge
LONGEST_STEP_PX = 0.7  # of one scoring iteration
NEIGHBOUR_MARGIN_PX = 1.0  # pixels nearer than this to another spot are left out
MODEL_ERROR = 0.05  # of the height: how far the model may be off without anything being wrong
STRANGE_LIGHT = 3.0  # sigmas above the model beyond which a pixel's light is somebody else's
SATURATED = 255


@compiled
def fit_edge_model(image, spot, neighbours, blur, gain, iterations, out):
    """Refine the centre of one spot.

    ``spot`` is a row of the spot table; ``neighbours`` (k, 3) the x, y and radius (px) of spots nearby; ``blur`` px;
    ``gain`` grey levels of variance per grey level of light. ``out`` (6,) receives x, y, the covariance xx, xy, yy
    (px^2) for that gain, and how far, in sigmas, the light outside the ellipse lies to one side: noise and a wrong
    shape leave it even, other light beside the spot does not.
    """
    height, width = image.shape
    x0, x1 = max(int(spot[WX0]), 0), min(int(spot[WX1]), width)
    y0, y1 = max(int(spot[WY0]), 0), min(int(spot[WY1]), height)
    middle_x, middle_y = 0.5 * (spot[WX0] + spot[WX1] - 1.0), 0.5 * (spot[WY0] + spot[WY1] - 1.0)
    a, b = spot[SEMI_A], spot[SEMI_B]
    cos, sin = math.cos(spot[ANGLE]), math.sin(spot[ANGLE])
    per_a2, per_b2 = 1.0 / (a * a), 1.0 / (b * b)
    rise = spot[HEIGHT]
    floor = spot[NOISE] * spot[NOISE] + 0.02
    scale = _STEPS / _REACH
    beyond = (2.0 * _REACH * blur) ** 2
    cx, cy = spot[X], spot[Y]
    nxx = nxy = nyy = 1e-12
    side_x = side_y = side_variance = 0.0
    for trial in range(iterations):
        nxx = nxy = nyy = 1e-12
        rx = ry = 0.0
        side_x = side_y = side_variance = 0.0
        for y in range(y0, y1):
            for x in range(x0, x1):
                dx, dy = x - cx, y - cy
                u, v = cos * dx + sin * dy, cos * dy - sin * dx
                p, q = u * per_a2, v * per_b2
                slope2 = p * p + q * q
                inside = 1.0 - (u * p + v * q)
                far = inside * inside >= beyond * slope2
                if far and (trial < iterations - 1 or inside > 0.0):
                    continue  # too far from the edge to tell anything about the centre
                taken = False
                for k in range(neighbours.shape[0]):
                    away = (x - neighbours[k, 0]) ** 2 + (y - neighbours[k, 1]) ** 2
                    if away < (neighbours[k, 2] + NEIGHBOUR_MARGIN_PX) ** 2:
                        taken = True
                if taken:
                    continue
                if far:
                    plane = spot[LEVEL] + spot[SLOPE_X] * (x - middle_x) + spot[SLOPE_Y] * (y - middle_y)
                    away = math.sqrt(dx * dx + dy * dy)
                    side_x += (float(image[y, x]) - plane) * dx / away
                    side_y += (float(image[y, x]) - plane) * dy / away
                    side_variance += 0.5 * floor
                    continue
                slope = math.sqrt(slope2)
                t = (inside / (2.0 * slope * blur) + _REACH) * scale
                entry = int(t)
                part = t - entry
                step = _STEP[entry] + part * (_STEP[entry + 1] - _STEP[entry])
                bell = _BELL[entry] + part * (_BELL[entry + 1] - _BELL[entry])
                plane = spot[LEVEL] + spot[SLOPE_X] * (x - middle_x) + spot[SLOPE_Y] * (y - middle_y)
                told = plane + rise * step
                value = float(image[y, x])
                if value >= SATURATED and told >= SATURATED:
                    continue  # a saturated pixel says no more than the model does
                lit = rise * step
                residual = value - told
                if inside < 0.0 and t < OUTSIDE:
                    away = math.sqrt(dx * dx + dy * dy)
                    side_x += residual * dx / away
                    side_y += residual * dy / away
                    side_variance += 0.5 * (floor + gain * lit)
                if trial > 0 and residual > 0.0:
                    usual = floor + gain * lit + (MODEL_ERROR * rise) ** 2
                    if residual * residual > STRANGE_LIGHT * STRANGE_LIGHT * usual:
                        continue
                weight = 1.0 / (floor + gain * lit)
                # Derivative of the first-order distance by the centre, through the ellipse's own axes.
                bend = inside / (2.0 * slope2 * slope)
                du, dv = -p / slope - bend * p * per_a2, -q / slope - bend * q * per_b2
                steep = rise * bell / blur
                gx, gy = -steep * (du * cos - dv * sin), -steep * (du * sin + dv * cos)
                nxx += weight * gx * gx
                nxy += weight * gx * gy
                nyy += weight * gy * gy
                rx += weight * gx * residual
                ry += weight * gy * residual
        det = nxx * nyy - nxy * nxy
        if not det > 0.0:
            break
        step_x = (nyy * rx - nxy * ry) / det
        step_y = (nxx * ry - nxy * rx) / det
        cx += min(max(step_x, -LONGEST_STEP_PX), LONGEST_STEP_PX)
        cy += min(max(step_y, -LONGEST_STEP_PX), LONGEST_STEP_PX)
    det = nxx * nyy - nxy * nxy
    if not det > 0.0:
        # No pixel tells where the edge is: the coarse centre, and what that may be worth.
        out[0], out[1], out[2], out[3], out[4], out[5] = spot[X], spot[Y], a * a, 0.0, a * a, 0.0
        return
    out[0], out[1] = cx, cy
    out[2], out[3], out[4] = nyy / det, -nxy / det, nxx / det
    usual = side_variance + (EVENNESS * rise * math.pi * a * b) ** 2
    out[5] = math.sqrt((side_x * side_x + side_y * side_y) / max(usual, 1e-9))
