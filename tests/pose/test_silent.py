"""Wrong in silence: never, of poses of all kinds, alone; odds that are meant; covariances of what is seen in front."""

import numpy as np
import pytest

from asterism.protocol.geometry import Floats, exp_rotation, log_rotation
from asterism.server.chain.answers import SURE
from tests.helpers import numeric_jacobian
from tests.measure.silent import FAR, LEDS, Drawn, Judged, Kind, draw, judge

POSES = 3000


def drawn_and_judged(rng: np.random.Generator, lit: int, count: int = POSES) -> tuple[Drawn, Judged]:
    drawn = draw(rng, Kind(lit), count)
    return drawn, judge(drawn)


@pytest.mark.parametrize("lit", [4, 5, 6])
def test_no_pose_is_wrong_in_silence(rng: np.random.Generator, lit: int) -> None:
    _, judged = drawn_and_judged(rng, lit)
    alone = judged.odds >= SURE
    assert not (alone & (judged.nees > FAR)).any()
    # Neither by being ambiguous wherever it might go wrong, nor by covariances far too wide.
    assert alone.mean() > 0.3
    assert 4.5 < judged.nees[alone].mean() < 6.6


def test_odds_are_meant(rng: np.random.Generator) -> None:
    _, judged = drawn_and_judged(rng, 6, 20_000)
    far = judged.nees > FAR  # that the other one is the truth, and not what lies between
    told = (judged.odds > 10.0) & (judged.odds < 1e4)
    wrong, expected = (far & told).sum(), (1.0 / (1.0 + judged.odds[told])).sum()
    assert 0.2 * expected < wrong < expected + 3.0 * np.sqrt(expected)


def slow_tilts(drawn: Drawn, judged: Judged, k: int) -> tuple[Floats, Floats]:
    """Turns (n, 3) from pose ``k`` to tilts on a grid around it, and what each costs at its best."""
    best = judged.choices.best[k]
    rotation, t = judged.solutions.rotations[k, best], judged.solutions.ts[k, best]
    points, spots = drawn.layouts[k], drawn.lit[k]
    inverse = np.linalg.inv(drawn.measured.covariances[spots][:, [[0, 1], [1, 2]]])
    sight = t / np.linalg.norm(t)
    across = np.linalg.svd(sight[None])[2][1:]
    middle, reach = (
        across @ rotation[:, 2],
        5.0 * np.sqrt(np.linalg.eigvalsh(judged.choices.covariances[k][3:, 3:])[-1]),
    )
    turns, costs = [], []
    for x in middle[0] + np.linspace(-reach, reach, 31):
        for y in middle[1] + np.linspace(-reach, reach, 31):
            normal = x * across[0] + y * across[1] - sight * np.sqrt(1.0 - x * x - y * y)
            turn = np.cross(rotation[:, 2], normal)
            turn *= np.arctan2(np.linalg.norm(turn), rotation[:, 2] @ normal) / max(np.linalg.norm(turn), 1e-12)

            def residuals(rest: Floats, turn: Floats = turn) -> Floats:
                moved = exp_rotation(rest[3] * sight) @ exp_rotation(turn) @ rotation
                mapped = points @ moved.T + t + rest[:3]
                off = drawn.measured.rays[spots] - mapped[:, :2] / mapped[:, 2:]
                return np.einsum("kji,kj->ki", np.linalg.cholesky(inverse), off).ravel()

            rest = np.zeros(4)
            for _ in range(3):
                jacobian = numeric_jacobian(residuals, rest, 1e-6)
                rest -= np.linalg.lstsq(jacobian, residuals(rest), rcond=None)[0]
            turns.append(turn + rest[3] * sight)
            costs.append(np.square(residuals(rest)).sum())
    return np.array(turns), np.array(costs)


def test_seen_in_front_the_covariance_is_that_of_all_tilts(rng: np.random.Generator) -> None:
    drawn, judged = drawn_and_judged(rng, 6)
    # Exact spots, minima that are one valley, and a tilt that is not known to a tenth of itself.
    sure = np.array([not (costs < 1e17).all() for costs in judged.solutions.costs])
    slight = (drawn.tilts < np.radians(3.0)) & (drawn.sigmas < 0.03) & sure & (judged.solutions.costs.min(axis=1) < 4.0)
    checked = 0
    for k in np.flatnonzero(slight)[:5]:
        turns, costs = slow_tilts(drawn, judged, k)
        above = costs - costs.min()
        weights = np.exp(-0.5 * above)
        moment = np.einsum("n,ni,nj->ij", weights, turns, turns) / weights.sum()
        told = judged.choices.covariances[k][3:, 3:]
        widths, axes = np.linalg.eigh(told)
        ratio = np.einsum("ji,jk,ki->i", axes, moment, axes)[1:] / widths[1:]
        # No narrower than what the spots allow, and wider only to cover what they do not rule out.
        assert (ratio < 1.15).all()
        assert (ratio > 0.3).all()
        inside = turns[above < 12.0]
        assert np.einsum("ni,ij,nj->n", inside, np.linalg.pinv(told), inside).max() < FAR
        checked += 1
    assert checked >= 3


def test_the_error_is_that_of_the_truth(rng: np.random.Generator) -> None:
    # The measure itself: without noise to speak of, every pose is found as it was drawn.
    drawn, judged = drawn_and_judged(rng, LEDS, 50)
    k = int(np.argmin(drawn.sigmas))
    found = judged.solutions.rotations[k, judged.choices.best[k]]
    assert np.linalg.norm(log_rotation(found @ drawn.rotations[k].T)) == pytest.approx(judged.turned[k])
