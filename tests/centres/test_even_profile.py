"""The even profile and the odd light against slow and obvious references: dense least squares, loops over pixels."""

from itertools import pairwise

import numpy as np
import pytest

from asterism.protocol.geometry import Floats
from asterism.server.centres.edge_sums import BLUR, CX, CY, N_UV, N_XX, N_XY, PARAMETERS, R_V, R_X, RISE, SUMS
from asterism.server.centres.even_profile import (
    ANGLE_ERROR,
    AT,
    AWAY_X,
    AWAY_Y,
    EDGE_KNOT,
    KNOTS,
    LEFT,
    PROFILE_ERROR,
    ROWS,
    STEEP,
    TURN,
    WEIGHT,
    add_up_freed,
    even_room,
    learn_profile,
    spacing_of,
    subtract_profile,
)
from asterism.server.centres.oddness import LEAST_PIXELS, TAKEN, ZONES, Moved, Odd, judge, take_step
from asterism.server.segmentation.pixels import LANES, PX, PY, room_for

PIXELS = 14 * LANES
FLOOR = 1.5


def drawn(rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """Pixels around a spot, rows of residuals at random, and the model's parameters."""
    pixels = room_for(PIXELS)
    pixels[PX, :PIXELS], pixels[PY, :PIXELS] = rng.uniform(-7, 7, (2, PIXELS))
    p = np.zeros(PARAMETERS)
    p[CX], p[CY], p[RISE], p[BLUR] = 0.2, -0.3, 150.0, 0.9
    rows = np.zeros((ROWS, PIXELS), np.float32)
    away = np.hypot(pixels[PX, :PIXELS] - p[CX], pixels[PY, :PIXELS] - p[CY])
    rows[AT] = np.clip((2.5 - away) / spacing_of(p) + EDGE_KNOT, 0, KNOTS - 1.001)
    rows[AWAY_X] = (pixels[PX, :PIXELS] - p[CX]) / away
    rows[AWAY_Y] = (pixels[PY, :PIXELS] - p[CY]) / away
    rows[LEFT] = rng.normal(0, 3, PIXELS) + 5 * np.sin(rows[AT])
    rows[WEIGHT] = rng.uniform(0.1, 0.6, PIXELS) * (rng.random(PIXELS) > 0.1)
    rows[STEEP] = rng.uniform(0, 60, PIXELS)
    rows[TURN] = rng.normal(0, 20, PIXELS)
    return pixels, rows, p


def hats(rows: Floats) -> Floats:
    """The piecewise linear profile's columns (pixels, KNOTS)."""
    at = rows[AT].astype(np.float64)
    return np.maximum(0.0, 1.0 - np.abs(at[:, None] - np.arange(KNOTS)))


def test_the_profile_is_that_of_dense_least_squares_with_its_prior(rng: np.random.Generator) -> None:
    _, rows, p = drawn(rng)
    room = even_room(PIXELS)
    turn, determined = learn_profile(rows, PIXELS, p[RISE], room)
    columns = np.column_stack([hats(rows), rows[TURN]])
    prior = np.append(np.full(KNOTS, 1.0 / (PROFILE_ERROR * p[RISE]) ** 2), 1.0 / ANGLE_ERROR**2)
    information = columns.T @ (rows[WEIGHT][:, None] * columns)
    solution = np.linalg.solve(information + np.diag(prior), columns.T @ (rows[WEIGHT] * rows[LEFT]))
    assert turn == pytest.approx(np.clip(solution[-1], -2 * ANGLE_ERROR, 2 * ANGLE_ERROR), rel=1e-4, abs=1e-6)
    np.testing.assert_allclose(room.score, solution[:-1], atol=1e-3)
    without = information[:-1, :-1]
    expected = np.trace(np.linalg.solve(without + np.diag(prior[:-1]), without))
    assert determined == pytest.approx(expected + 1.0, abs=1e-3)


def test_the_odd_block_is_summed_over_what_the_profile_leaves(rng: np.random.Generator) -> None:
    pixels, rows, p = drawn(rng)
    profile, turn = rng.normal(0, 5, KNOTS), 0.03
    before, columns = rows.astype(np.float64), hats(rows)
    subtract_profile(rows, PIXELS, p, turn, profile)
    left = before[LEFT] - columns @ profile - turn * before[TURN]
    np.testing.assert_allclose(rows[LEFT], left, atol=1e-3)
    steep = before[STEEP] + (np.diff(profile)[before[AT].astype(int)]) / spacing_of(p)
    np.testing.assert_allclose(rows[STEEP], steep, atol=1e-3)
    sums = np.zeros(SUMS)
    add_up_freed(pixels, PIXELS, p, rows, sums)
    gx, gy = steep * before[AWAY_X], steep * before[AWAY_Y]
    x, y = pixels[PX, :PIXELS] - p[CX], pixels[PY, :PIXELS] - p[CY]
    w = before[WEIGHT]
    for place, value in ((N_XX, gx * gx), (N_XY, gx * gy), (N_UV, x * y), (R_X, gx * left), (R_V, y * left)):
        assert sums[place] == pytest.approx(np.sum(w * value), rel=1e-3, abs=1.0)


def harmonic(rows: Floats, number: int) -> Floats:
    """cos and sin of so many times the outward direction (pixels, 2)."""
    angles = number * np.arctan2(rows[AWAY_Y].astype(np.float64), rows[AWAY_X].astype(np.float64))
    return np.column_stack([np.cos(angles), np.sin(angles)])


def reference(rows: Floats, p: Floats, determined: float) -> Odd:
    """`oddness.judge`, zone by zone with dense least squares."""
    w, left = rows[WEIGHT].astype(np.float64), rows[LEFT].astype(np.float64)
    inwards = (rows[AT] - EDGE_KNOT) * spacing_of(p) / p[BLUR]
    odd, freedom, finer, finer_freedom, taken = 0.0, 0, 0.0, 0, PARAMETERS + determined
    for low, high in pairwise(ZONES):
        zone = (inwards > low) & (inwards <= high) & (w > 0)
        if np.count_nonzero(zone) < LEAST_PIXELS:
            continue
        root, left_here = np.sqrt(w[zone]), left[zone].copy()
        explained = []
        for number in (1, 3, 5):
            columns = root[:, None] * harmonic(rows, number)[zone]
            explained.append(np.sum(np.square(columns @ np.linalg.lstsq(columns, root * left_here, rcond=None)[0])))
        odd += explained[0]
        finer, finer_freedom = finer + explained[1] + explained[2], finer_freedom + 4
        quadrupole = harmonic(rows, 2)[zone]
        amplitudes = np.linalg.lstsq(root[:, None] * quadrupole, root * left_here, rcond=None)[0]
        left[zone] = left_here - quadrupole @ amplitudes
        freedom, taken = freedom + 2, taken + 2
    freedom -= TAKEN
    misfit = (np.sum(w * left * left) - odd) / (np.count_nonzero(w) - taken - freedom)
    return Odd(misfit, odd, freedom, finer, finer_freedom)


@pytest.mark.parametrize("dipole", [0.0, 4.0])
def test_odd_light_is_told_from_noise_as_the_reference_tells_it(rng: np.random.Generator, dipole: float) -> None:
    _, rows, p = drawn(rng)
    rows[LEFT] = rng.normal(0, 1.8, PIXELS) + dipole * rows[AWAY_X] * np.cos(rows[AT])
    expected = reference(rows.copy(), p, 8.0)
    odd = judge(rows, PIXELS, p, FLOOR, 8.0, np.zeros(SUMS))
    np.testing.assert_allclose(odd, expected, rtol=1e-3)
    assert (odd.dipoles / odd.misfit > 20.0) == (dipole > 0.0)


def test_an_even_pattern_of_any_size_is_no_odd_light(rng: np.random.Generator) -> None:
    # Pixels in pairs on opposite sides: whatever is the same on both leaves no odd harmonic at all.
    _, rows, p = drawn(rng)
    half = PIXELS // 2
    rows[:, half:] = rows[:, :half]
    rows[[AWAY_X, AWAY_Y], half:] *= -1.0
    odd = judge(rows, PIXELS, p, FLOOR, 8.0, np.zeros(SUMS))
    assert odd.dipoles == pytest.approx(0.0, abs=1e-3)
    assert odd.finer == pytest.approx(0.0, abs=1e-3)
    assert odd.dipoles_freedom + odd.finer_freedom == 6 + 20


def test_a_step_takes_what_it_explains(rng: np.random.Generator) -> None:
    pixels, rows, p = drawn(rng)
    moved = Moved(0.1, -0.2, 0.3, 0.4)
    x, y = pixels[PX, :PIXELS] - p[CX], pixels[PY, :PIXELS] - p[CY]
    shift = rows[STEEP] * (rows[AWAY_X] * moved.x + rows[AWAY_Y] * moved.y) + x * moved.u + y * moved.v
    expected = rows[LEFT] - shift
    take_step(pixels, PIXELS, p, moved, rows)
    np.testing.assert_allclose(rows[LEFT], expected, atol=1e-3)
