"""Planes and separations of constellations, against slow and obvious references."""

import itertools

import numpy as np
import pytest

from asterism.protocol.constellation import confusions, extent, plane_of
from asterism.protocol.geometry import Floats
from tests.helpers import random_pose
from tests.rigs import random_layout


def separation_reference(seen: Floats, taken: Floats, same: bool, hidden: int) -> float:
    """The same by fitting an affine map to every labelling, one after the other."""
    count, best = 6 - hidden, np.inf
    for order in itertools.permutations(range(6), count):
        for subset in itertools.combinations(range(6), count):
            if same and order == subset:
                continue
            a = np.column_stack([taken[list(subset)], np.ones(count)])
            fit, *_ = np.linalg.lstsq(a, seen[list(order)], rcond=None)
            if np.linalg.det(fit[:2]) > 0:
                best = min(best, float(np.linalg.norm(a @ fit - seen[list(order)])))
    return best


@pytest.mark.parametrize("hidden", [0, 1])
def test_confusions_equal_the_fitted_ones(rng: np.random.Generator, hidden: int) -> None:
    layouts = [random_layout(rng) for _ in range(2)]
    found = {(c.seen, c.taken): c for c in confusions(layouts, hidden)}
    for seen, taken in ((0, 1), (1, 1)):
        expected = separation_reference(layouts[seen], layouts[taken], seen == taken, hidden)
        assert found[seen, taken].separation == pytest.approx(expected, rel=1e-6)


def test_the_confusion_says_which_leds(rng: np.random.Generator) -> None:
    layout = random_layout(rng)
    order = [3, 1, 5, 0, 2, 4]
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    nearest = next(c for c in confusions([layout, layout[order] @ turn.T + 0.01]) if (c.seen, c.taken) == (0, 1))
    assert nearest.separation < 1e-9
    assert [order[led] for led in nearest.taken_leds] == list(nearest.seen_leds)


def test_a_mirror_image_is_another_constellation(rng: np.random.Generator) -> None:
    layout = random_layout(rng)
    pair = [c.separation for c in confusions([layout, layout * [1, -1]]) if c.seen != c.taken]
    assert min(pair) > 0.001


def test_plane_of_is_a_rigid_frame_on_the_side_where_the_leds_shine(rng: np.random.Generator) -> None:
    for _ in range(50):
        flat = np.column_stack([random_layout(rng), np.zeros(6)])
        T_robot_made = random_pose(rng, 0.1)
        leds = T_robot_made.map(flat)
        axis = T_robot_made.rotation[:, 2]
        T_robot_plane, inside = plane_of(leds, axis)
        np.testing.assert_allclose(T_robot_plane.map(inside), leds, atol=1e-12)
        np.testing.assert_allclose(inside[:, 2], 0.0, atol=1e-12)
        np.testing.assert_allclose(inside.mean(axis=0), 0.0, atol=1e-12)
        assert T_robot_plane.rotation[:, 2] @ axis == pytest.approx(1.0)
        other, _ = plane_of(leds, -axis)
        assert other.rotation[:, 2] @ axis == pytest.approx(-1.0)


def test_extent_is_the_largest_distance() -> None:
    assert extent(np.array([[0.0, 0.0], [3.0, 4.0], [1.0, 1.0]])) == 5.0
