"""How far apart the clocks of two cameras are, from the way of robots that both see.

A robot's way as one camera has it and as the other has it are one way, seen from two places: the shift of time under
which they lie on each other best, whatever the places, is how far the clocks are apart. First all shifts are tried,
each with the best place (Kabsch's method), then shift, drift and place are fitted together (Gauss-Newton, weighted by
the positions' covariances; what the residuals leave beyond them widens all). A robot that stands still tells nothing,
and one that goes straight at an even pace cannot be told from a camera that stands elsewhere: the standard deviation
says so.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.server.pose.place import turning

FEWEST = 8  # pairs of positions
MOST_GAP = 3.5  # frame periods: a way with a longer gap is not followed across it
DRIFT_SIGMA = 1e-4  # of clocks, before anything tells: crystals are made to 20 to 100 ppm
OFFSET_SIGMA_S = 10.0  # likewise: next to nothing is known
STEPS = 15
FAR_OFF = 4.0  # times the median of the residuals
LEAST_OVERLAP = 0.4  # of the shorter way, below which a shift of time is not tried
MEDIAN_CHI2 = 2.366  # of three degrees of freedom
MOST_PAIRS, PAIRS_TRIED = 2000, 150
CLEARLY = 0.7  # of how far ways are apart without a shift: what another must come down to
AROUND = 4  # frames before and after, which tell a velocity
MOVES = 3.0  # times what noise alone would make of the velocities: below it, robots are taken to stand still


@dataclass(frozen=True, slots=True, eq=False)
class Way:
    """Where a robot was by one camera, in any frame that does not move: ``times_s`` (n,) rising, by that camera's
    clock; ``places`` (n, 3) m with ``covariances`` (n, 3, 3).
    """

    times_s: Floats
    places: Floats
    covariances: Floats
    period_s: float = field(init=False)  # from one frame to the next, usually

    def __post_init__(self) -> None:
        period = float(np.median(np.diff(self.times_s))) if len(self.times_s) > 1 else 0.0
        object.__setattr__(self, "period_s", period)


@dataclass(frozen=True, slots=True, eq=False)
class ClockFit:
    """The second clock shows ``offset_s`` more than the first when it shows ``at_s`` itself, and gains ``drift`` s in
    every s; ``covariance`` (2, 2) of both. ``T_first_second`` maps the second's frame into the first's; ``rms_m`` is
    how far the ways then are apart, ``pairs`` how many positions told.
    """

    offset_s: float
    drift: float
    at_s: float
    covariance: Floats
    T_first_second: Pose
    rms_m: float
    pairs: int

    @property
    def offset_sigma_s(self) -> float:
        """Standard deviation of the offset."""
        return float(np.sqrt(self.covariance[0, 0]))

    @property
    def drift_sigma(self) -> float:
        """Standard deviation of the drift."""
        return float(np.sqrt(self.covariance[1, 1]))


def clock_between(ways: Sequence[tuple[Way, Way]], within_s: float = 0.0) -> ClockFit | None:
    """The clocks of two cameras from the ways of the same robots by the first and by the second.

    Shifts up to ``within_s`` are tried; with 0 the clocks must agree to about a frame already. None where too few
    positions lie within the same time.
    """
    ways = [(first, second) for first, second in ways if len(first.times_s) > 1 and len(second.times_s) > 0]
    if not ways:
        return None
    tried = list(_tried(ways, within_s if any(map(_moves, ways)) else 0.0))
    best = min(tried, default=(0.0, 0.0))
    # Where robots stand still, all shifts are alike.
    without = next((away for away, offset in tried if offset == 0.0), np.inf)
    return _fitted(ways, best[1] if best[0] < CLEARLY * without else 0.0)


def _tried(ways: Sequence[tuple[Way, Way]], within_s: float) -> Iterator[tuple[float, float]]:
    """For every shift how far apart the ways are then, m, and the shift, s."""
    period = max(min(min(way.period_s or np.inf for way in pair) for pair in ways), 1e-3)
    period = period if np.isfinite(period) else 1e-3
    steps = int(np.ceil(within_s / (0.5 * period)))
    # Linearly between frames, also where some are missing: that is near enough to find the shift.
    some = [(first, _spread(len(second.times_s), PAIRS_TRIED // len(ways)), second) for first, second in ways]
    seconds = np.concatenate([second.places[rows] for _, rows, second in some])
    most = 0
    for k in sorted(range(-steps, steps + 1), key=abs):
        firsts, inside = [], []
        for first, rows, second in some:
            times = second.times_s[rows] - 0.5 * period * k
            firsts.append(np.column_stack([np.interp(times, first.times_s, axis) for axis in first.places.T]))
            inside.append((times >= first.times_s[0]) & (times <= first.times_s[-1]))
        there = np.concatenate(inside)
        most = max(most, int(there.sum()))
        if there.sum() < max(FEWEST, LEAST_OVERLAP * most):
            continue
        here = np.concatenate(firsts)[there]
        T = _laid(here, seconds[there])
        yield float(np.median(((T.map(seconds[there]) - here) ** 2).sum(axis=1))) ** 0.5, 0.5 * period * k


@dataclass(frozen=True, slots=True, eq=False)
class _Pairs:
    """Positions ``seconds`` (m, 3) of the second, at its ``times_s`` (m,), the first's at the same time, its velocity
    there, m/s, and the covariances of both (m, 3, 3).
    """

    times_s: Floats
    firsts: Floats
    seconds: Floats
    velocities: Floats
    first_covariances: Floats
    second_covariances: Floats


def _pairs(ways: Sequence[tuple[Way, Way]], offset_s: float, drift: float, at_s: float) -> _Pairs:
    """The second's positions with the first's, interpolated at their times by the first's clock."""
    columns: list[tuple[Floats, ...]] = []
    for first, second in ways:
        rows = _spread(len(second.times_s), MOST_PAIRS // len(ways))
        told = second.times_s[rows]
        times = told - offset_s - drift * (told - at_s)
        after = np.clip(np.searchsorted(first.times_s, times, side="right"), 1, len(first.times_s) - 1)
        before = after - 1
        gap = first.times_s[after] - first.times_s[before]
        share = (times - first.times_s[before]) / np.maximum(gap, 1e-9)
        good = (share >= 0.0) & (share <= 1.0) & (gap <= MOST_GAP * first.period_s) & (gap > 0.0)
        a, b, s, rows = before[good], after[good], share[good, None], rows[good]
        places = first.places[a] * (1.0 - s) + first.places[b] * s
        low, high = np.maximum(a - AROUND, 0), np.minimum(b + AROUND, len(first.times_s) - 1)
        span = first.times_s[high] - first.times_s[low]
        velocities = (first.places[high] - first.places[low]) / span[:, None]
        s = s[..., None]
        spread = first.covariances[a] * (1.0 - s) ** 2 + first.covariances[b] * s**2
        columns.append((told[good], places, second.places[rows], velocities, spread, second.covariances[rows]))
    return _Pairs(*(np.concatenate(column) for column in zip(*columns, strict=True)))


def _spread(count: int, most: int) -> NDArray[np.int64]:
    """Rows of so many, evenly spread."""
    return np.unique(np.linspace(0, count - 1, min(count, max(most, 1))).round().astype(np.int64))


def _laid(firsts: Floats, seconds: Floats) -> Pose:
    """T_first_second that lays points onto others best (Kabsch 1976, Umeyama 1991)."""
    a, b = firsts.mean(axis=0), seconds.mean(axis=0)
    u, _, vt = np.linalg.svd((firsts - a).T @ (seconds - b))
    turn = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return Pose.from_matrix(turn, a - turn @ b)


def _fitted(ways: Sequence[tuple[Way, Way]], offset_s: float) -> ClockFit | None:
    """Shift, drift and place together."""
    drift, T, moves = 0.0, None, any(map(_moves, ways))
    told = np.concatenate([second.times_s for _, second in ways])
    at_s = float(0.5 * (told.min() + told.max()))
    prior = np.diag([OFFSET_SIGMA_S**-2, DRIFT_SIGMA**-2, *[0.0] * 6])
    for _ in range(STEPS):
        pairs = _pairs(ways, offset_s, drift, at_s)
        if len(pairs.firsts) < FEWEST:
            return None
        if T is None:
            T = _laid(pairs.firsts, pairs.seconds)
        by, away, weights, scale = _linearised(pairs, T, at_s)
        if not moves:
            by[:, :, :2] = 0.0
        weighted = np.swapaxes(by, 1, 2) @ weights
        normal = (weighted @ by).sum(axis=0) / scale + prior
        right = (weighted @ away[..., None]).sum(axis=0)[:, 0] / scale - prior @ np.array([0.0, drift, *[0.0] * 6])
        # A way that is a line, or a place, leaves a rotation open.
        sizes = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-12))
        across = np.outer(sizes, sizes)
        covariance = across * np.linalg.pinv(normal * across, rcond=1e-12, hermitian=True)
        step = covariance @ right
        offset_s, drift = offset_s + float(step[0]), drift + float(step[1])
        T = Pose.from_matrix(exp_rotation(step[5:]) @ T.rotation, T.position + step[2:5])
        if abs(step[0]) < 1e-9:
            break
    assert T is not None
    rms = float(np.sqrt((away**2).sum(axis=1).mean()))
    return ClockFit(offset_s, drift, at_s, covariance[:2, :2], T, rms, len(pairs.firsts))


def _moves(pair: tuple[Way, Way]) -> bool:
    """Whether a robot moves: noise alone makes velocities too, which would seem to tell something."""
    way = pair[0]
    low, high = np.arange(len(way.times_s))[: -2 * AROUND], np.arange(len(way.times_s))[2 * AROUND :]
    if len(low) == 0:
        return True
    steps = way.places[high] - way.places[low]
    spread = np.linalg.inv(way.covariances[high] + way.covariances[low])
    return float(np.mean((steps[:, None] @ spread @ steps[..., None])[:, 0, 0])) > MOVES * 3.0


def _linearised(pairs: _Pairs, T: Pose, at_s: float) -> tuple[Floats, Floats, Floats, float]:
    """Derivatives (m, 3, 8) of the second's positions in the first's frame, less the first's, by offset, drift, place
    (m, rad about the first's axes, about its origin of the second); the first's less the second's (m, 3); weights
    (m, 3, 3), robust; and by how much the squares exceed what the covariances say.
    """
    arms = pairs.seconds @ T.rotation.T
    away = pairs.firsts - arms - T.position
    by = np.zeros((len(away), 3, 8))
    by[:, :, 0] = pairs.velocities
    by[:, :, 1] = pairs.velocities * (pairs.times_s - at_s)[:, None]
    by[:, :, 2:5] = np.eye(3)
    by[:, :, 5:] = turning(arms)
    spread = pairs.first_covariances + T.rotation @ pairs.second_covariances @ T.rotation.T
    weights = np.asarray(np.linalg.inv(spread), np.float64)
    squared = (away[:, None] @ weights @ away[..., None])[:, 0, 0]
    scale = max(float(np.median(squared)) / MEDIAN_CHI2, 1e-12)
    good = squared < FAR_OFF**2 * 3.0 * scale
    return by, away, weights * good[:, None, None], max(scale, 1.0)
