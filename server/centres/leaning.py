"""Centre of a spot that other light leans on (a dim mirror image in a polished floor, a lamp's halo): both are fitted.

Model: `lights`, by Levenberg-Marquardt, every pixel weighted with its own variance; what the pixels may not tell
(shape, blurs, the plane) has soft expectations. The covariance is the centre's block of the inverse normal matrix, so
it owns up to what the second light leaves undetermined.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from asterism.server.centres.lights import (
    BASE,
    BLUR,
    CX,
    CY,
    OF_A_LIGHT,
    PARAMETERS,
    PLANE,
    RESIDUAL,
    RISE,
    ROWS,
    SEMI_U,
    SEMI_V,
    SLOPE_U,
    SLOPE_V,
    TURN,
    WEIGHT,
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
OTHER_SIZE_SIGMA, TURN_SIGMA, BLUR_SIGMA, HAZE_SIGMA, BASE_SIGMA, SLOPE_SIGMA = 0.4, 0.4, 0.15, 1.0, 2.0, 0.3
TOO_LARGE_PX, LEAST_SIZE = 0.28, 0.6  # moments find semi-axes too large
FARTHEST_PX = 2.0  # the centre may be moved so far, and a semi-axis
DIMMEST, BRIGHTEST = 0.2, 2.0  # of the spot's height, its rise; of that, the other light
LEAST_PX, LARGEST = 0.4, 4.0  # semi-axes, px; of the spot's
LEAST_BLUR_PX, WIDEST_SPOT_PX, WIDEST_PX = 0.45, 1.8, 6.0
THIRD_PX = 1.2  # semi-axes that a third light begins with
GOOD = 1.2  # chi squared per degree of freedom beyond which a third light is tried
LONG = 1.6  # semi-axis over the other
ALIKE = 0.75  # times the brighter light, one that is as bright as this may be the LED as well
NEIGHBOUR_MARGIN_PX = 1.0
# Beyond these the model does not hold: misfit, of the spot's height, RMS; chi squared per degree of freedom.
WORST_MISFIT, WORST_SCALE = 0.08, 4.0
PATIENCE, HOPELESS = 8, 4.0  # iterations after which a fit that is so many times too bad is given up
LEAST_LIGHT = 5.0  # sigmas: a second light dimmer than that may not be there


class Fit(NamedTuple):
    """What came of a fit of so many ``lights``: chi squared, the squared residuals, how many pixels count."""

    lights: int
    chi2: float
    plain: float
    number: float


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
def _begin(spot, room):
    """Fill the plane, and what is expected of it."""
    p, known = room.p, room.known
    p[BASE], p[SLOPE_U], p[SLOPE_V] = spot[LEVEL], spot[SLOPE_X], spot[SLOPE_Y]
    known[:] = 0.0
    known[BASE] = 1.0 / BASE_SIGMA**2
    known[SLOPE_U] = known[SLOPE_V] = 1.0 / SLOPE_SIGMA**2
    room.expected[:PLANE] = p[:PLANE]


@compiled
def _add_light(light, like, sigma, blur, blur_sigma, room):
    """Let the fit begin with a light that is ``like`` (6,): centre (px from the window's middle), rise, semi-axes and
    angle.

    Semi-axes are known to ``sigma``, of themselves; the ``blur`` to ``blur_sigma`` px.
    """
    first = PLANE + light * OF_A_LIGHT
    p, known = room.p, room.known
    for i in range(BLUR):
        p[first + i] = like[i]
    p[first + BLUR] = blur
    for semi in (first + SEMI_U, first + SEMI_V):
        known[semi] = 1.0 / (sigma * p[semi]) ** 2
    known[first + TURN], known[first + BLUR] = 1.0 / TURN_SIGMA**2, 1.0 / blur_sigma**2
    room.expected[first : first + OF_A_LIGHT] = p[first : first + OF_A_LIGHT]


@compiled
def _measure(pixels, count, spot, gain, room, p, n, r):
    """Normal matrix and right side, expectations included, at ``p``; chi squared with and without these, the squared
    residuals, and the number of pixels that count.
    """
    parameters = r.shape[0]
    lights = (parameters - PLANE) // OF_A_LIGHT
    look(pixels, count, lights, p, spot[NOISE] * spot[NOISE] + 0.02, gain, room.table)
    chi2, plain, number = add_up(room.table, count, parameters, n, r)
    whole = chi2
    for j in range(parameters):
        off = p[j] - room.expected[j]
        whole += room.known[j] * off * off
        n[j, j] += room.known[j]
        r[j] -= room.known[j] * off
    return whole, chi2, plain, number


@compiled
def _is_allowed(trial, lights, spot, expected):
    """Clamp what cannot be otherwise; whether the centres stay near where they are ``expected``."""
    near = True
    for light in range(lights):
        first = PLANE + light * OF_A_LIGHT
        for semi in (first + SEMI_U, first + SEMI_V):
            trial[semi] = min(max(trial[semi], LEAST_PX), LARGEST * spot[SEMI_A])
        trial[first + BLUR] = min(max(trial[first + BLUR], LEAST_BLUR_PX), WIDEST_PX if light > 0 else WIDEST_SPOT_PX)
        least, most = (DIMMEST * spot[HEIGHT], 1e6) if light == 0 else (0.0, BRIGHTEST * trial[PLANE + RISE])
        trial[first + RISE] = min(max(trial[first + RISE], least), most)
        away = math.hypot(trial[first + CX] - expected[first + CX], trial[first + CY] - expected[first + CY])
        near &= away < (FARTHEST_PX + 0.5 * spot[SEMI_A] if light == 0 else FARTHEST_PX + 3.0 * spot[SEMI_A])
    return near


@compiled
def _descend(pixels, count, spot, gain, room, lights):
    """Fit so many lights from where they begin; chi squared, squared residuals, and how many pixels count."""
    k = PLANE + lights * OF_A_LIGHT
    p, n, r, work, move, trial = room.p, room.n[:k, :k], room.r[:k], room.work[:k, :k], room.move[:k], room.trial
    trial_n, trial_r = room.trial_n[:k, :k], room.trial_r[:k]
    whole, chi2, plain, number = _measure(pixels, count, spot, gain, room, p, n, r)
    damping = 1e-2
    for iteration in range(ITERATIONS):
        if iteration >= PATIENCE and chi2 > HOPELESS * WORST_SCALE * (number - k):
            break
        work[:, :] = n
        move[:] = r
        for j in range(k):
            work[j, j] *= 1.0 + damping
            work[j, j] += 1e-9
        if not cholesky_solve(work, move):
            damping *= 10.0
            continue
        trial[:k] = p[:k] + move
        if not _is_allowed(trial, lights, spot, room.expected):
            damping *= 10.0
            continue
        found = _measure(pixels, count, spot, gain, room, trial, trial_n, trial_r)
        if found[0] < whole:
            gained = whole - found[0]
            p[:k], n[:, :], r[:] = trial[:k], trial_n, trial_r
            whole, chi2, plain, number = found
            damping *= 0.2
            if gained < 1e-3 * whole:
                break
        else:
            damping *= 6.0
    return Fit(lights, chi2, plain, number)


@compiled
def _is_sure(room, k, column, scale):
    """Whether a light's rise is beyond what may be noise."""
    work, move = room.work[:k, :k], room.move[:k]
    work[:, :] = room.n[:k, :k]
    move[:] = 0.0
    move[column] = 1.0
    return cholesky_solve(work, move) and room.p[column] ** 2 >= LEAST_LIGHT**2 * scale * move[column]


@compiled
def _take(spot, fit, light, room, out):
    """Write into ``out`` the centre of one of two or more lights; whether the fit is any good."""
    k = PLANE + fit.lights * OF_A_LIGHT
    first = PLANE + light * OF_A_LIGHT
    dof = fit.number - k
    if dof < 10 or math.sqrt(fit.plain / fit.number) > WORST_MISFIT * spot[HEIGHT]:
        return False
    # Light that is spread wider than a lens does is no LED's.
    if room.p[first + BLUR] > WIDEST_SPOT_PX:
        return False
    scale = max(fit.chi2 / dof, 1.0)
    for third in range(2, fit.lights):
        if room.p[PLANE + third * OF_A_LIGHT + RISE] > ALIKE * room.p[first + RISE]:
            return False
    if scale > WORST_SCALE or not _is_sure(room, k, PLANE + (1 - light) * OF_A_LIGHT + RISE, scale):
        return False
    work, move = room.work[:k, :k], room.move[:k]
    for axis in range(2):
        work[:, :] = room.n[:k, :k]
        move[:] = 0.0
        move[first + axis] = 1.0
        if not cholesky_solve(work, move):
            return False
        out[2 + axis], out[3 + axis] = scale * move[first], scale * move[first + 1]
    out[0] = room.p[first] + 0.5 * (spot[WX0] + spot[WX1] - 1.0)
    out[1] = room.p[first + 1] + 0.5 * (spot[WY0] + spot[WY1] - 1.0)
    out[5], out[6] = scale, fit.lights
    return True


@compiled
def _brightest_left(pixels, count, width, like, room):
    """Fill ``like`` with a small light where the residuals leave most: in the middle of what nine pixels tell.

    ``pixels`` are those of a box, row by row of so many.
    """
    xs, ys, table = pixels[0], pixels[1], room.table
    best, at = 0.0, -1
    for i in range(count):
        if table[WEIGHT, i] <= 0.0 or table[RESIDUAL, i] <= 0.0:
            continue
        total = 0.0
        for row in (-width, 0, width):
            for j in range(max(i + row - 1, 0), min(i + row + 2, count)):
                if abs(xs[i] - xs[j]) < 1.5 and abs(ys[i] - ys[j]) < 1.5:
                    total += table[RESIDUAL, j] * math.sqrt(table[WEIGHT, j])
        if total > best:
            best, at = total, i
    if at < 0:
        return False
    like[CX], like[CY], like[RISE], like[TURN] = xs[at], ys[at], max(1.5 * table[RESIDUAL, at], 1.0), 0.0
    like[SEMI_U] = like[SEMI_V] = THIRD_PX
    return True


@compiled
def _fit(pixels, count, width, spot, gain, room):
    """Fit two lights to the pixels of a box so many wide, from where they begin; a third where they leave too much."""
    fit = _descend(pixels, count, spot, gain, room, 2)
    k = PLANE + 2 * OF_A_LIGHT
    if fit.chi2 < GOOD * (fit.number - k):
        return fit
    like = np.empty(BLUR)
    look(pixels, count, 2, room.p, spot[NOISE] * spot[NOISE] + 0.02, gain, room.table)
    if not _brightest_left(pixels, count, width, like, room):
        return fit
    room.expected[PLANE : PLANE + OF_A_LIGHT] = room.p[PLANE : PLANE + OF_A_LIGHT]
    _add_light(2, like, 1.0, 1.0, HAZE_SIGMA, room)
    return _descend(pixels, count, spot, gain, room, 3)


@compiled
def _like(source, spot, like):
    """Fill ``like`` (6,) with x, y, height, semi-axes and angle of the moments, as the fit begins with them."""
    like[CX], like[CY] = (
        source[0] - 0.5 * (spot[WX0] + spot[WX1] - 1.0),
        source[1] - 0.5 * (spot[WY0] + spot[WY1] - 1.0),
    )
    like[RISE], like[SEMI_U], like[SEMI_V], like[TURN] = source[2], _real(source[3]), _real(source[4]), source[5]


@compiled
def fit_leaning(image, spot, other, neighbours, shape, blur, gain, out):
    """Fit a spot and the light beside it; arguments and the first of ``out`` (7,) as in `edge_model.fit_edge_model`.

    ``other`` (6,) is the spot that was split from this one: x, y, height, semi-axes, angle; its height is 0 where there
    is none, and the light is looked for: beside the spot, then within it. ``shape`` (4,) is what other LEDs of its
    robot look like: semi-axes and angle of the moments, and how well that is known, a share. ``out`` ends with chi
    squared per degree of freedom, at least 1, and how many lights there are. Returns False where the lights do not
    explain the pixels or may not be there.
    """
    height, width = image.shape
    # The other light reaches beyond the spot's own window.
    wider = 2 if other[2] == 0.0 else 6
    x0, x1 = max(int(spot[WX0]) - wider, 0), min(int(spot[WX1]) + wider, width)
    y0, y1 = max(int(spot[WY0]) - wider, 0), min(int(spot[WY1]) + wider, height)
    box = Box(x0, x1, y0, y1)
    pixels, count = _gather(image, spot, neighbours, box)
    room, like, own = _room(pixels.shape[1]), np.empty(6), np.empty(6)
    own[0], own[1], own[2], own[3:] = spot[X], spot[Y], spot[HEIGHT], shape[:3]
    is_split = other[2] > 0.0
    if not is_split:
        other[0], other[1], other[2] = _light_beside(image, spot, neighbours, box)
        other[3], other[4], other[5] = spot[SEMI_A], spot[SEMI_B], spot[ANGLE]
    second = PLANE + OF_A_LIGHT
    if other[2] > 0.0:
        _begin(spot, room)
        _like(own, spot, like)
        _add_light(0, like, shape[3], blur, BLUR_SIGMA, room)
        _like(other, spot, like)
        like[RISE] = min(like[RISE], BRIGHTEST * spot[HEIGHT])
        _add_light(1, like, OTHER_SIZE_SIGMA, 1.2 * blur, HAZE_SIGMA, room)
        fit = _fit(pixels, count, x1 - x0, spot, gain, room)
        # Two lights as bright in one spot may have shared it wrongly.
        parted = is_split or room.p[second + RISE] < ALIKE * room.p[PLANE + RISE]
        # A long one that no sibling vouches for may still be both.
        long = room.p[PLANE + SEMI_U] > LONG * room.p[PLANE + SEMI_V]
        parted &= is_split or shape[3] < OTHER_SIZE_SIGMA / 2.0 or not long
        if parted and _take(spot, fit, 0, room, out):
            return True
    if is_split:
        return False
    _begin(spot, room)
    apart = max(spot[SEMI_A] - spot[SEMI_B], 0.2 * spot[SEMI_A])
    along_x, along_y = apart * math.cos(spot[ANGLE]), apart * math.sin(spot[ANGLE])
    own[3], own[4] = min(shape[0], spot[SEMI_B]), min(shape[1], spot[SEMI_B])
    _like(own, spot, like)
    like[CX], like[CY], like[RISE] = like[CX] + along_x, like[CY] + along_y, 0.8 * spot[HEIGHT]
    _add_light(0, like, shape[3], blur, BLUR_SIGMA, room)
    like[CX], like[CY], like[RISE] = like[CX] - 2.0 * along_x, like[CY] - 2.0 * along_y, 0.6 * spot[HEIGHT]
    _add_light(1, like, OTHER_SIZE_SIGMA, 1.2 * blur, HAZE_SIGMA, room)
    fit = _fit(pixels, count, x1 - x0, spot, gain, room)
    # Of two lights in one spot the brighter is the LED's; it must be much brighter.
    rise, other_rise = room.p[PLANE + RISE], room.p[second + RISE]
    led = 0 if rise >= other_rise else 1
    return min(rise, other_rise) < ALIKE * max(rise, other_rise) and _take(spot, fit, led, room, out)
