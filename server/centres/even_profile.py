"""What is even about a spot's centre, learned from the spot's own residuals: no symmetric misfit moves or widens it.

No lens blurs as the model of `edge_model` says: diffraction rings, defocus discs and halos leave residuals of several
sigmas in bright spots. They look the same from both sides of the centre, and sums over odd times even terms vanish:
whatever is even about the centre can be left free, and costs its covariance nothing. So every spot has a profile of
its own. The residuals r of the fitted ellipse, with weights w, are explained by

    r = h(d) + turn * d told / d angle,

h piecewise linear in the distance d to the ellipse, its values at the knots shrunk to zero by a prior of PROFILE_ERROR
of the rise, so that dim spots keep the parametric profile: least squares whose matrix is tridiagonal with a border (the
angle, which moments alone had told). Centre and slopes then take one step of scoring on what is left, along the
profile's true slope, that of the model and of h. Where the profile is right, the covariance is that of the bound; where
it is not quite, gradients that are a few percent off change it in second order only.
"""

from typing import Any, NamedTuple

import numpy as np

from asterism.server.centres.blurred_ellipse import REACH32, distance_to_ellipse, normal
from asterism.server.centres.edge_sums import (
    BASE,
    BLUR,
    CX,
    CY,
    MODEL_ERROR,
    N_UU,
    N_UV,
    N_VV,
    N_XU,
    N_XV,
    N_XX,
    N_XY,
    N_YU,
    N_YV,
    N_YY,
    R_U,
    R_V,
    R_X,
    R_Y,
    RISE,
    SIZE_A,
    SIZE_B,
    STRANGE_LIGHT,
    SX,
    SY,
    weight,
)
from asterism.server.compiled import compiled, compiled_sums
from asterism.server.segmentation.pixels import COUNTS, GREY, LANES, PX, PY, SPARE, ZERO, f32
from asterism.server.segmentation.spot_table import SEMI_A, SEMI_B

PROFILE_ERROR = 0.05  # of the rise: the misfit of the profile that is expected, one sigma
ANGLE_ERROR = 0.1  # rad, of the moments' angle, one sigma
KNOTS, EDGE_KNOT = 20, 11  # of the profile, and which of them lies on the ellipse; the rest is flat
LEAST_SPACING_PX, SPACING = 0.6, 0.55  # of the knots: px, sigmas of blur
LAST_KNOT = f32(KNOTS - 1.001)

# Rows of what a pixel gives: its place among the knots, residual, weight, slope of the profile, the outward direction,
# the derivative by the angle, light of the spot.
AT, LEFT, WEIGHT, STEEP, AWAY_X, AWAY_Y, TURN, LIT = range(8)
ROWS = 8


class EvenRoom(NamedTuple):
    """Room: ``rows`` (ROWS, capacity) float32 as above; the normal equations of the profile, ``diagonal``, ``beside``
    (with the next knot), ``score`` and the ``border`` (KNOTS,), solved in place: ``score`` ends as the profile;
    ``work`` (2, KNOTS).
    """

    rows: Any
    diagonal: Any
    beside: Any
    score: Any
    border: Any
    work: Any


@compiled
def even_room(cells):
    """Empty `EvenRoom` for windows of so many pixels."""
    return EvenRoom(
        np.empty((ROWS, int(cells) + SPARE), np.float32),
        np.empty(KNOTS),
        np.empty(KNOTS),
        np.empty(KNOTS),
        np.empty(KNOTS),
        np.empty((2, KNOTS)),
    )


@compiled
def spacing_of(p):
    """Distance between the knots of the profile, px, for the model's parameters."""
    return max(LEAST_SPACING_PX, SPACING * p[BLUR])


@compiled_sums
def lay_out(pixels, n, p, fitted, rows):
    """Fill ``rows`` with what the first ``n`` of ``pixels`` give; arguments as in `edge_sums.add_up_shape`."""
    xs, ys, values, counts = pixels[PX], pixels[PY], pixels[GREY], pixels[COUNTS]
    at, left, weights, steeps = rows[AT], rows[LEFT], rows[WEIGHT], rows[STEEP]
    aways_x, aways_y, turns, lits = rows[AWAY_X], rows[AWAY_Y], rows[TURN], rows[LIT]
    spot = fitted.spot
    cx, cy, slope_x, slope_y = f32(p[CX]), f32(p[CY]), f32(p[SX]), f32(p[SY])
    level, rise, per_blur, per_spacing = f32(p[BASE]), f32(p[RISE]), f32(1.0 / p[BLUR]), f32(1.0 / spacing_of(p))
    a, b = spot[SEMI_A] * p[SIZE_A], spot[SEMI_B] * p[SIZE_B]
    per_a2, per_b2 = f32(1.0 / (a * a)), f32(1.0 / (b * b))
    cos, sin = f32(fitted.cos), f32(fitted.sin)
    floor, gain, loose = f32(fitted.floor), f32(fitted.gain), f32((MODEL_ERROR * p[RISE]) ** 2)
    limit = f32(STRANGE_LIGHT * STRANGE_LIGHT)
    for i in range(n // LANES * LANES):
        dx, dy = xs[i] - cx, ys[i] - cy
        u, v, pu, pv, distance, outward, bend = distance_to_ellipse(dx, dy, cos, sin, per_a2, per_b2)
        t = min(max(distance * per_blur, -REACH32), REACH32)
        step, bell = normal(t)
        lit = rise * step
        told = level + slope_x * dx + slope_y * dy + lit
        steep = rise * bell * per_blur
        du, dv = pu * (outward - bend * per_a2), pv * (outward - bend * per_b2)
        at[i] = min(max(distance * per_spacing + f32(EDGE_KNOT), ZERO), LAST_KNOT)
        left[i] = values[i] - told
        weights[i] = weight(values[i], told, floor + gain * lit, counts[i], loose, limit)
        steeps[i] = steep
        aways_x[i], aways_y[i] = dv * sin - du * cos, -du * sin - dv * cos
        turns[i] = steep * (du * v - dv * u)
        lits[i] = lit


@compiled
def _add_up_profile(rows, n, room):
    """The normal equations of the profile, without its prior; returns those of the angle: information and score."""
    diagonal, beside, score, border = room.diagonal, room.beside, room.score, room.border
    diagonal[:] = 0.0
    beside[:] = 0.0
    score[:] = 0.0
    border[:] = 0.0
    angle, angle_score = 0.0, 0.0
    for i in range(n):
        w = float(rows[WEIGHT, i])
        if w == 0.0:
            continue
        at, left, turn = float(rows[AT, i]), float(rows[LEFT, i]), float(rows[TURN, i])
        k = int(at)
        upper = at - k
        lower = 1.0 - upper
        wl, wu, wr, wt = w * lower, w * upper, w * left, w * turn
        diagonal[k] += wl * lower
        diagonal[k + 1] += wu * upper
        beside[k] += wl * upper
        score[k] += lower * wr
        score[k + 1] += upper * wr
        border[k] += lower * wt
        border[k + 1] += upper * wt
        angle += wt * turn
        angle_score += wt * left
    return angle, angle_score


@compiled
def learn_profile(rows, n, rise, room):
    """Solve for the profile from the ``n`` pixels of ``rows``; it is left in ``room.score``, grey levels at the knots.

    Returns the angle's step, rad, and how many parameters the pixels, not the prior, have determined.
    """
    angle, angle_score = _add_up_profile(rows, n, room)
    diagonal, beside, score, border, work = room.diagonal, room.beside, room.score, room.border, room.work
    angle += 1.0 / ANGLE_ERROR**2
    prior = 1.0 / (PROFILE_ERROR * rise) ** 2
    raw_border = work[0]
    raw_border[:] = border
    # Forward elimination; the pivots are kept, those of the backward one are wanted for the inverse's diagonal.
    pivots = work[1]
    for k in range(KNOTS):
        pivots[k] = diagonal[k] + prior
        if k > 0:
            share = beside[k - 1] / pivots[k - 1]
            pivots[k] -= share * beside[k - 1]
            score[k] -= share * score[k - 1]
            border[k] -= share * border[k - 1]
    determined, after = float(KNOTS), 0.0
    for j in range(KNOTS):
        k = KNOTS - 1 - j
        whole = diagonal[k] + prior
        backward = whole - after
        determined -= prior / (pivots[k] + backward - whole)
        if k > 0:
            after = beside[k - 1] * beside[k - 1] / backward
        if j > 0:
            score[k] -= beside[k] * score[k + 1]
            border[k] -= beside[k] * border[k + 1]
        score[k] /= pivots[k]
        border[k] /= pivots[k]
    for k in range(KNOTS):
        angle_score -= raw_border[k] * score[k]
        angle -= raw_border[k] * border[k]
    turn = min(max(angle_score / angle, -2.0 * ANGLE_ERROR), 2.0 * ANGLE_ERROR)
    for k in range(KNOTS):
        score[k] -= turn * border[k]
    return turn, determined + 1.0


@compiled
def subtract_profile(rows, n, p, turn, profile):
    """Change the row LEFT to what the ``profile`` and the angle's step ``turn`` leave, and STEEP to the true slope."""
    at, left, steep, turns = rows[AT], rows[LEFT], rows[STEEP], rows[TURN]
    per_spacing, turn = f32(1.0 / spacing_of(p)), f32(turn)
    for i in range(n):
        k = int(at[i])
        here = f32(profile[k])
        rising = f32(profile[k + 1]) - here
        left[i] -= here + (at[i] - f32(k)) * rising + turn * turns[i]
        steep[i] += rising * per_spacing


@compiled_sums
def add_up_freed(pixels, n, p, rows, sums):
    """Information and score of the odd block, N_ and R_ of ``sums``, of what is left of the first ``n`` pixels."""
    xs, ys = pixels[PX], pixels[PY]
    lefts, weights, steeps, aways_x, aways_y = rows[LEFT], rows[WEIGHT], rows[STEEP], rows[AWAY_X], rows[AWAY_Y]
    cx, cy = f32(p[CX]), f32(p[CY])
    n_xx = n_xy = n_yy = n_xu = n_xv = n_yu = n_yv = n_uu = n_uv = n_vv = r_x = r_y = r_u = r_v = ZERO
    for i in range(n // LANES * LANES):
        dx, dy, w, left = xs[i] - cx, ys[i] - cy, weights[i], lefts[i]
        gx, gy = steeps[i] * aways_x[i], steeps[i] * aways_y[i]
        wx, wy, wu, wv = w * gx, w * gy, w * dx, w * dy
        n_xx += wx * gx
        n_xy += wx * gy
        n_yy += wy * gy
        n_xu += wx * dx
        n_xv += wx * dy
        n_yu += wy * dx
        n_yv += wy * dy
        n_uu += wu * dx
        n_uv += wu * dy
        n_vv += wv * dy
        r_x += wx * left
        r_y += wy * left
        r_u += wu * left
        r_v += wv * left
    sums[N_XX], sums[N_XY], sums[N_YY] = n_xx, n_xy, n_yy
    sums[N_XU], sums[N_XV], sums[N_YU], sums[N_YV] = n_xu, n_xv, n_yu, n_yv
    sums[N_UU], sums[N_UV], sums[N_VV] = n_uu, n_uv, n_vv
    sums[R_X], sums[R_Y], sums[R_U], sums[R_V] = r_x, r_y, r_u, r_v
