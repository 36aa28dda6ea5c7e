"""By how much a filter's velocity lags behind, by what a robot does: for `tests.measure.smoothing`.

The lag is the area between true and told velocity over the change of velocity: the time by which a change comes late.
"""

from typing import NamedTuple

import numpy as np
from rich import box
from rich.table import Table

from asterism.protocol.geometry import Floats
from asterism.server.chain.turns import exp_rotations
from tests.chain.drives import Drives, covariances_of, drawn
from tests.chain.judging_motion import forwards

BEFORE_S, AFTER_S = 2.0, 1.0
RATES_HZ = (30.0, 60.0, 120.0)
NOISES_PX = (0.005, 0.02, 0.1)


class Change(NamedTuple):
    """A robot's speed m/s and turn rate rad/s before and after, and the time it takes, s."""

    name: str
    before: tuple[float, float]
    after: tuple[float, float]
    seconds: float


CHANGES = (
    Change("start, 0.2 m/s in 0.1 s", (0.0, 0.0), (0.2, 0.0), 0.1),
    Change("start, 0.2 m/s in 0.5 s", (0.0, 0.0), (0.2, 0.0), 0.5),
    Change("stop, 0.2 m/s in 0.05 s", (0.2, 0.0), (0.0, 0.0), 0.05),
    Change("turn on the spot, 2 rad/s in 0.1 s", (0.0, 0.0), (0.0, 2.0), 0.1),
    Change("straight to circle of 0.2 m in 0.1 s", (0.2, 0.0), (0.2, 1.0), 0.1),
)


def lags(count: int) -> Table:
    """Mean lags of ``count`` drawn drives each, ms."""
    table = Table(title="lag of the velocity, ms", box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("change")
    cases = [(rate, 0.02) for rate in RATES_HZ] + [(60.0, noise) for noise in NOISES_PX if noise != 0.02]
    for rate_hz, sigma_px in cases:
        table.add_column(f"{rate_hz:.0f} Hz, {sigma_px:g} px", justify="right")
    for change in CHANGES:
        table.add_row(change.name, *(f"{1e3 * lag_s(change, count, *case):.0f}" for case in cases))
    return table


def lag_s(change: Change, count: int, rate_hz: float, sigma_px: float) -> float:
    """Mean lag of ``count`` drives, s."""
    rng = np.random.default_rng([17, int(rate_hz), int(1e4 * sigma_px)])
    told = _driven(rng, change, count, rate_hz)
    covariances = covariances_of(told.positions, told.rotations, sigma_px)
    seen = drawn(rng, told.positions, told.rotations, covariances)
    behind = -forwards(told, *seen, covariances).twists[int((BEFORE_S - 0.2) * rate_hz) :]
    steps = np.subtract(change.after, change.before)
    column = 5 if steps[1] else 0
    return float(np.mean(np.sum(behind[..., column], axis=0)) / rate_hz / (steps[1] or steps[0]))


def _driven(rng: np.random.Generator, change: Change, count: int, rate_hz: float) -> Drives:
    """On a plane below the camera, each begun a little later than the one before."""
    fine = 1200
    late = rng.uniform(0.0, 1.0 / rate_hz, count)
    times = np.arange(int((BEFORE_S + AFTER_S) * fine)) / fine
    share = np.clip((times[:, None] - BEFORE_S - late) / change.seconds, 0.0, 1.0)
    speed, turn = (a + share * (b - a) for a, b in zip(change.before, change.after, strict=True))
    heading = rng.uniform(-np.pi, np.pi, count) + np.cumsum(turn, axis=0) / fine
    places = np.stack([np.cumsum(speed * np.cos(heading), axis=0), np.cumsum(speed * np.sin(heading), axis=0)], axis=-1)
    places = np.concatenate([places / fine, np.zeros((*heading.shape, 1))], axis=-1)
    places -= places[int(BEFORE_S * fine)]
    at = np.arange(0, len(times), int(fine / rate_hz))
    twists: Floats = np.zeros((*heading.shape, 6))
    twists[..., 0], twists[..., 5] = speed, turn
    rotations = exp_rotations(heading[..., None] * [0.0, 0.0, 1.0])
    return Drives(rate_hz, places[at], rotations[at], twists[at], np.zeros((len(at), count)))
