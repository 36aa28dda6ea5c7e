"""Scoring steps of the blurred ellipse's two blocks of parameters, from the sums of `edge_sums`."""

import math

from asterism.server.centres.edge_sums import (
    BASE,
    BLUR,
    CX,
    CY,
    M_AA,
    M_AB,
    M_AW,
    M_BB,
    M_BW,
    M_LA,
    M_LB,
    M_LL,
    M_LR,
    M_LW,
    M_RA,
    M_RB,
    M_RR,
    M_RW,
    M_WW,
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
    Q_A,
    Q_B,
    Q_L,
    Q_R,
    Q_W,
    R_U,
    R_V,
    R_X,
    R_Y,
    RISE,
    SIZE_A,
    SIZE_B,
    SX,
    SY,
)
from asterism.server.compiled import compiled

BLUR_PX = 0.85  # expected blur; the fit finds the spot's own
BLUR_SIGMA = 0.15  # how far the fit may go from the expected blur and from the size that the moments say, softly
SIZE_SIGMA = 0.1
LONG_STEP = 0.06, 0.1, 0.1  # of log size, blur (px) and rise (share), after which another step is needed
LONGEST_STEP_PX = 0.7


@compiled
def _solve2(xx, xy, yy, rx, ry):
    """The step of the centre, px, no longer than is reasonable, and whether the centre can be told at all."""
    det = xx * yy - xy * xy
    if not det > 1e-12 * xx * yy:
        return 0.0, 0.0, False
    step_x, step_y = (yy * rx - xy * ry) / det, (xx * ry - xy * rx) / det
    return (
        min(max(step_x, -LONGEST_STEP_PX), LONGEST_STEP_PX),
        min(max(step_y, -LONGEST_STEP_PX), LONGEST_STEP_PX),
        True,
    )


@compiled
def _solve5(m, q, per):
    """Solve m x = q for symmetric positive definite m (5, 5; its lower triangle), in place; q becomes x, ``per`` (5,)
    one over the pivots. False if m is not that. Elimination without roots, and with few quotients: they take longest.
    """
    for k in range(5):
        if not m[k, k] > 0.0:
            return False
        per[k] = 1.0 / m[k, k]
        for i in range(k + 1, 5):
            share = m[i, k] * per[k]
            q[i] -= share * q[k]
            for j in range(k + 1, i + 1):
                m[i, j] -= share * m[j, k]
    for k in range(4, -1, -1):
        for i in range(k + 1, 5):
            q[k] -= m[i, k] * q[i]
        q[k] *= per[k]
    return True


@compiled
def improve_shape(sums, p, start_rise, m, q):
    """One scoring step of the even block; whether it was so long that there should be another.

    ``m`` (6, 5) and ``q`` (5,) are room.
    """
    m[0, 0], m[1, 0], m[2, 0], m[3, 0], m[4, 0] = sums[M_LL], sums[M_LR], sums[M_LA], sums[M_LB], sums[M_LW]
    m[1, 1], m[2, 1], m[3, 1], m[4, 1] = sums[M_RR], sums[M_RA], sums[M_RB], sums[M_RW]
    m[2, 2], m[3, 2], m[4, 2] = sums[M_AA], sums[M_AB], sums[M_AW]
    m[3, 3], m[4, 3], m[4, 4] = sums[M_BB], sums[M_BW], sums[M_WW]
    # What the moments and the expected blur say; sizes are derived by their logarithms.
    size_information, blur_information = 1.0 / SIZE_SIGMA**2, 1.0 / BLUR_SIGMA**2
    m[2, 2] += size_information
    m[3, 3] += size_information
    m[4, 4] += blur_information
    q[0], q[1] = sums[Q_L], sums[Q_R]
    q[2] = sums[Q_A] - size_information * math.log(p[SIZE_A])
    q[3] = sums[Q_B] - size_information * math.log(p[SIZE_B])
    q[4] = sums[Q_W] - blur_information * (p[BLUR] - BLUR_PX)
    for k in range(5):
        m[k, k] *= 1.0 + 1e-9
    if _solve5(m, q, m[5]):
        # Light that the ceiling cuts off, size and blur are told apart by little: long steps lead in circles.
        most = max(abs(q[1]) / (0.3 * p[RISE]), abs(q[2]) / 0.2, abs(q[3]) / 0.2, abs(q[4]) / (0.3 * p[BLUR]))
        if most > 1.0:
            for k in range(5):
                q[k] /= most
        p[BASE] += q[0]
        p[RISE] = min(max(p[RISE] + q[1], 0.6 * start_rise), 4.0 * start_rise)
        p[SIZE_A] *= math.exp(q[2])
        p[SIZE_B] *= math.exp(q[3])
        p[BLUR] = min(max(p[BLUR] + q[4], 0.45), 5.0)
    size, blur, rise = LONG_STEP
    return max(abs(q[2]), abs(q[3])) > size or abs(q[4]) > blur or abs(q[1]) > rise * start_rise


@compiled
def improve_centre(sums, p):
    """One scoring step of the odd block.

    Returns the centre's information xx, xy, yy with the slopes eliminated, and whether the centre can be told.
    """
    uu, uv, vv = sums[N_UU] + 1e-9, sums[N_UV], sums[N_VV] + 1e-9
    per_det = 1.0 / (uu * vv - uv * uv)
    ux, uy, vx, vy = sums[N_XU], sums[N_YU], sums[N_XV], sums[N_YV]
    # Rows of N_cs N_ss^-1.
    xu, xv = (ux * vv - vx * uv) * per_det, (vx * uu - ux * uv) * per_det
    yu, yv = (uy * vv - vy * uv) * per_det, (vy * uu - uy * uv) * per_det
    xx, xy = sums[N_XX] - xu * ux - xv * vx, sums[N_XY] - xu * uy - xv * vy
    yy = sums[N_YY] - yu * uy - yv * vy
    rx = sums[R_X] - xu * sums[R_U] - xv * sums[R_V]
    ry = sums[R_Y] - yu * sums[R_U] - yv * sums[R_V]
    step_x, step_y, told = _solve2(xx, xy, yy, rx, ry)
    ru = sums[R_U] - ux * step_x - uy * step_y
    rv = sums[R_V] - vx * step_x - vy * step_y
    p[CX] += step_x
    p[CY] += step_y
    p[SX] += (vv * ru - uv * rv) * per_det
    p[SY] += (uu * rv - uv * ru) * per_det
    # The plane is told at the spot's centre, which has moved.
    p[BASE] += p[SX] * step_x + p[SY] * step_y
    return xx, xy, yy, told
