"""Centre of a spot that other light leans on (a dim mirror image in a polished floor, a lamp's halo): both are fitted.

Model: `two_lights`, by Levenberg-Marquardt, every pixel weighted with its own variance; what the pixels may not tell
(shape, blurs, the plane) has soft expectations. The covariance is the centre's block of the inverse normal matrix, so
it owns up to what the second light leaves undetermined.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from asterism.server.centres.two_lights import (
    A1,
    A2,
    B1,
    B2,
    BASE,
    BLUR1,
    BLUR2,
    PARAMETERS,
    RISE1,
    RISE2,
    ROWS,
    SLOPE_U,
    SLOPE_V,
    TURN1,
    TURN2,
    X1,
    X2,
    Y1,
    Y2,
    add_up,
    look,
)
from asterism.server.centres.window import leave_out
from asterism.server.compiled import compiled
from asterism.server.pose.planar import cholesky_solve
from asterism.server.segmentation.pixels import Box, cells_of, gather_box, pad, room_for
from asterism.server.segmentation.spot_table import (
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

ITERATIONS = 25
# Soft expectations, one sigma: of semi-axes and those of the other light (shares), angles (rad); of blurs (px), and of
# the plane (grey levels, and per px).
SIZE_SIGMA, OTHER_SIZE_SIGMA, TURN_SIGMA, BLUR_SIGMA, HAZE_SIGMA, BASE_SIGMA, SLOPE_SIGMA = (
    0.3,
    0.4,
    0.4,
    0.15,
    1.0,
    2.0,
    0.3,
)
TOO_LARGE_PX, LEAST_SIZE = 0.28, 0.6  # moments find semi-axes too large
FARTHEST_PX = 2.0  # the centre may be moved so far, and a semi-axis
DIMMEST, BRIGHTEST = 0.2, 2.0  # of the spot's height, its rise; of that, the other light
LEAST_PX, LARGEST = 0.4, 4.0  # semi-axes, px; of the spot's
ALIKE = 0.75  # times the brighter light, one that is as bright as this may be the LED as well
NEIGHBOUR_MARGIN_PX = 1.0
# Beyond these the model does not hold: misfit, of the spot's height, RMS; chi squared per degree of freedom.
WORST_MISFIT, WORST_SCALE = 0.08, 4.0
PATIENCE, HOPELESS = 8, 4.0  # iterations after which a fit that is so many times too bad is given up
LEAST_LIGHT = 5.0  # sigmas: a second light dimmer than that may not be there


class LeaningRoom(NamedTuple):
    """Work arrays of one fit: ``table`` of the pixels; parameters ``p`` with the ``expected`` ones and the information
    on them ``known``; normal matrices and right sides.
    """

    table: Any
    p: Any
    expected: Any
    known: Any
    n: Any
    r: Any
    work: Any
    move: Any
    trial: Any
    trial_n: Any
    trial_r: Any


@compiled
def _room(cells):
    k = PARAMETERS
    table = np.empty((ROWS, cells), np.float32)
    p, expected, known, r, move, trial = np.empty(k), np.empty(k), np.empty(k), np.empty(k), np.empty(k), np.empty(k)
    n, work, trial_n, trial_r = np.empty((k, k)), np.empty((k, k)), np.empty((k, k)), np.empty(k)
    return LeaningRoom(table, p, expected, known, n, r, work, move, trial, trial_n, trial_r)


@compiled
def _gather(image, spot, neighbours, box):
    """The pixels of a box, told from the middle of the spot's own; neighbours' do not count."""
    middle_x, middle_y = 0.5 * (spot[WX0] + spot[WX1] - 1.0), 0.5 * (spot[WY0] + spot[WY1] - 1.0)
    pixels = room_for(cells_of(box))
    count = pad(pixels, 0, gather_box(image, box, middle_x, middle_y, pixels, 0))
    leave_out(pixels, count, neighbours, middle_x, middle_y)
    return pixels, count


@compiled
def _light_beside(image, spot, neighbours, box):
    """Centre and height of what shines outside the spot's ellipse; height 0 if nothing does."""
    middle_x, middle_y = 0.5 * (spot[WX0] + spot[WX1] - 1.0), 0.5 * (spot[WY0] + spot[WY1] - 1.0)
    s = sx = sy = most = 0.0
    for y in range(box.y0, box.y1):
        for x in range(box.x0, box.x1):
            if math.hypot(x - spot[X], y - spot[Y]) < spot[SEMI_A] + 1.0:
                continue
            plane = spot[LEVEL] + spot[SLOPE_X] * (x - middle_x) + spot[SLOPE_Y] * (y - middle_y)
            z = float(image[y, x]) - plane
            if z <= 3.0 * spot[NOISE]:
                continue
            taken = False
            for k in range(neighbours.shape[0]):
                away2 = (x - neighbours[k, 0]) ** 2 + (y - neighbours[k, 1]) ** 2
                taken |= away2 < (neighbours[k, 2] + NEIGHBOUR_MARGIN_PX) ** 2
            if not taken:
                s += z
                sx += z * x
                sy += z * y
                most = max(most, z)
    if s <= 0.0:
        return 0.0, 0.0, 0.0
    return sx / s, sy / s, most


@compiled
def _real(semi):
    """A semi-axis, px, from that of the moments, which find it too large."""
    return max(semi - TOO_LARGE_PX, LEAST_SIZE * semi)


@compiled
def _start(spot, other, blur, room):
    """Fill the parameters that the fit starts from, what is expected of them, and how well that is known."""
    p, expected, known = room.p, room.expected, room.known
    middle_x, middle_y = 0.5 * (spot[WX0] + spot[WX1] - 1.0), 0.5 * (spot[WY0] + spot[WY1] - 1.0)
    p[X1], p[Y1], p[X2], p[Y2] = spot[X] - middle_x, spot[Y] - middle_y, other[0] - middle_x, other[1] - middle_y
    p[RISE1], p[RISE2] = spot[HEIGHT], min(other[2], BRIGHTEST * spot[HEIGHT])
    p[A1], p[B1], p[TURN1], p[BLUR1] = _real(spot[SEMI_A]), _real(spot[SEMI_B]), spot[ANGLE], blur
    p[A2], p[B2], p[TURN2], p[BLUR2] = _real(other[3]), _real(other[4]), other[5], 1.2 * blur
    p[BASE], p[SLOPE_U], p[SLOPE_V] = spot[LEVEL], spot[SLOPE_X], spot[SLOPE_Y]
    expected[:] = p
    known[:] = 0.0
    known[A1], known[B1] = 1.0 / (SIZE_SIGMA * p[A1]) ** 2, 1.0 / (SIZE_SIGMA * p[B1]) ** 2
    known[TURN1], known[BLUR1] = 1.0 / TURN_SIGMA**2, 1.0 / BLUR_SIGMA**2
    known[A2], known[B2] = 1.0 / (OTHER_SIZE_SIGMA * p[A2]) ** 2, 1.0 / (OTHER_SIZE_SIGMA * p[B2]) ** 2
    known[TURN2], known[BLUR2] = 1.0 / TURN_SIGMA**2, 1.0 / HAZE_SIGMA**2
    known[BASE] = 1.0 / BASE_SIGMA**2
    known[SLOPE_U] = known[SLOPE_V] = 1.0 / SLOPE_SIGMA**2


@compiled
def _start_within(spot, blur, room):
    """As `_start`, with both lights within the spot, at the ends of its long axis."""
    p = room.p
    other = np.empty(6)
    other[0], other[1], other[2] = spot[X], spot[Y], 0.6 * spot[HEIGHT]
    other[3], other[4], other[5] = spot[SEMI_B], spot[SEMI_B], spot[ANGLE]
    _start(spot, other, blur, room)
    apart = max(spot[SEMI_A] - spot[SEMI_B], 0.2 * spot[SEMI_A])
    along_x, along_y = apart * math.cos(spot[ANGLE]), apart * math.sin(spot[ANGLE])
    p[X1], p[Y1], p[A1] = p[X1] + along_x, p[Y1] + along_y, p[B1]
    p[X2], p[Y2] = p[X2] - along_x, p[Y2] - along_y
    p[RISE1] *= 0.8
    room.expected[:] = p


@compiled
def _measure(pixels, count, p, spot, gain, room, n, r):
    """Normal matrix and right side, expectations included, at ``p``; chi squared with and without these, the squared
    residuals, and the number of pixels that count.
    """
    look(pixels, count, p, spot[NOISE] * spot[NOISE] + 0.02, gain, room.table)
    chi2, plain, number = add_up(room.table, count, n, r)
    whole = chi2
    for j in range(PARAMETERS):
        off = p[j] - room.expected[j]
        whole += room.known[j] * off * off
        n[j, j] += room.known[j]
        r[j] -= room.known[j] * off
    return whole, chi2, plain, number


@compiled
def _is_allowed(trial, spot, expected):
    """Clamp what cannot be otherwise; whether the centre stays near where it is ``expected``."""
    for semi in (A1, B1, A2, B2):
        trial[semi] = min(max(trial[semi], LEAST_PX), LARGEST * spot[SEMI_A])
    trial[BLUR1], trial[BLUR2] = min(max(trial[BLUR1], 0.45), 1.8), min(max(trial[BLUR2], 0.45), 6.0)
    trial[RISE1] = max(trial[RISE1], DIMMEST * spot[HEIGHT])
    trial[RISE2] = min(max(trial[RISE2], 0.0), BRIGHTEST * trial[RISE1])
    return math.hypot(trial[X1] - expected[X1], trial[Y1] - expected[Y1]) < FARTHEST_PX + 0.5 * spot[SEMI_A]


@compiled
def _descend(pixels, count, spot, gain, room):
    """Fit both lights from where `_start` left them; chi squared, squared residuals, and how many pixels count."""
    p, n, r, work, move, trial = room.p, room.n, room.r, room.work, room.move, room.trial
    whole, chi2, plain, number = _measure(pixels, count, p, spot, gain, room, n, r)
    damping = 1e-2
    for iteration in range(ITERATIONS):
        if iteration >= PATIENCE and chi2 > HOPELESS * WORST_SCALE * (number - PARAMETERS):
            break
        work[:, :] = n
        move[:] = r
        for j in range(PARAMETERS):
            work[j, j] *= 1.0 + damping
            work[j, j] += 1e-9
        if not cholesky_solve(work, move):
            damping *= 10.0
            continue
        trial[:] = p + move
        if not _is_allowed(trial, spot, room.expected):
            damping *= 10.0
            continue
        found = _measure(pixels, count, trial, spot, gain, room, room.trial_n, room.trial_r)
        if found[0] < whole:
            gained = whole - found[0]
            p[:], n[:, :], r[:] = trial, room.trial_n, room.trial_r
            whole, chi2, plain, number = found
            damping *= 0.2
            if gained < 1e-3 * whole:
                break
        else:
            damping *= 6.0
    return chi2, plain, number


@compiled
def _take(spot, chi2, plain, number, first, room, out):
    """Write into ``out`` the centre of the light whose parameters begin at ``first``; whether the fit is any good."""
    p, work, move = room.p, room.work, room.move
    dof = number - PARAMETERS
    if dof < 10 or math.sqrt(plain / number) > WORST_MISFIT * spot[HEIGHT]:
        return False
    scale = max(chi2 / dof, 1.0)
    if scale > WORST_SCALE:
        return False
    other = RISE2 if first == X1 else RISE1
    work[:, :] = room.n
    move[:] = 0.0
    move[other] = 1.0
    if not cholesky_solve(work, move) or p[other] ** 2 < LEAST_LIGHT**2 * scale * move[other]:
        return False
    for axis in range(2):
        work[:, :] = room.n
        move[:] = 0.0
        move[first + axis] = 1.0
        if not cholesky_solve(work, move):
            return False
        out[2 + axis], out[3 + axis] = scale * move[first], scale * move[first + 1]
    out[0] = p[first] + 0.5 * (spot[WX0] + spot[WX1] - 1.0)
    out[1] = p[first + 1] + 0.5 * (spot[WY0] + spot[WY1] - 1.0)
    out[5] = scale
    return True


@compiled
def fit_leaning(image, spot, other, neighbours, blur, gain, out):
    """Fit a spot and the light beside it; arguments and ``out`` as in `edge_model.fit_edge_model`.

    ``other`` (6,) is the spot that was split from this one: x, y, height, semi-axes, angle; its height is 0 where there
    is none, and the light is looked for: beside the spot, then within it. ``out`` ends with chi squared per degree of
    freedom, at least 1. Returns False where the two do not explain the pixels or the light may not be there.
    """
    height, width = image.shape
    # The other light reaches beyond the spot's own window.
    wider = 2 if other[2] == 0.0 else 6
    x0, x1 = max(int(spot[WX0]) - wider, 0), min(int(spot[WX1]) + wider, width)
    y0, y1 = max(int(spot[WY0]) - wider, 0), min(int(spot[WY1]) + wider, height)
    box = Box(x0, x1, y0, y1)
    pixels, count = _gather(image, spot, neighbours, box)
    room = _room(pixels.shape[1])
    is_split = other[2] > 0.0
    if not is_split:
        other[0], other[1], other[2] = _light_beside(image, spot, neighbours, box)
        other[3], other[4], other[5] = spot[SEMI_A], spot[SEMI_B], spot[ANGLE]
    if other[2] > 0.0:
        _start(spot, other, blur, room)
        chi2, plain, number = _descend(pixels, count, spot, gain, room)
        # Two lights as bright in one spot may have shared it wrongly.
        parted = is_split or room.p[RISE2] < ALIKE * room.p[RISE1]
        if parted and _take(spot, chi2, plain, number, X1, room, out):
            return True
    if is_split:
        return False
    _start_within(spot, blur, room)
    chi2, plain, number = _descend(pixels, count, spot, gain, room)
    # Of two lights in one spot the brighter is the LED's; it must be much brighter.
    brighter, dimmer = max(room.p[RISE1], room.p[RISE2]), min(room.p[RISE1], room.p[RISE2])
    first = X1 if room.p[RISE1] >= room.p[RISE2] else X2
    return dimmer < ALIKE * brighter and _take(spot, chi2, plain, number, first, room, out)
