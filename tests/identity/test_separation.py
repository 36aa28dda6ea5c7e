"""Separations of constellations: the compiled search against trying everything, and their laws."""

import itertools

import numpy as np
import pytest

from asterism.protocol.constellation import confusions
from asterism.protocol.geometry import Floats
from asterism.server.identity.separation import TABLES, nearest, separations, strength, tabulate
from tests.helpers import exp_rotation
from tests.identity.separations import brute_force
from tests.rigs import random_layout

HEXAGON = 0.05 * np.array([[np.cos(a), np.sin(a)] for a in np.radians(np.arange(0, 360, 60))])


def few(rng: np.random.Generator, count: int = 3) -> Floats:
    return np.array([random_layout(rng) for _ in range(count)])


def tables_of(layout: Floats) -> Floats:
    tables = np.empty(TABLES)
    assert tabulate(layout, tables)
    return tables


def test_trying_everything_is_fitting_an_affine_map_to_every_labelling(rng: np.random.Generator) -> None:
    seen, taken = few(rng, 2)
    for hidden, mirrors in itertools.product((0, 1), (False, True)):
        count, best = 6 - hidden, np.inf
        for order in itertools.permutations(range(6), count):
            for leds in itertools.combinations(range(6), count):
                a = np.column_stack([taken[list(leds)], np.ones(count)])
                fit = np.linalg.lstsq(a, seen[list(order)], rcond=None)[0]
                if mirrors or np.linalg.det(fit[:2]) > 0:
                    best = min(best, float(np.linalg.norm(a @ fit - seen[list(order)])))
        assert brute_force([seen, taken], hidden, mirrors)[0, 1] == pytest.approx(best, rel=1e-9)


@pytest.mark.parametrize("hidden", [0, 1])
@pytest.mark.parametrize("mirrors", [False, True])
def test_the_search_finds_what_trying_everything_finds(rng: np.random.Generator, hidden: int, mirrors: bool) -> None:
    layouts = few(rng, 8)
    np.testing.assert_allclose(
        separations(layouts, hidden, mirrors), brute_force(layouts, hidden, mirrors), rtol=1e-9, atol=1e-12
    )


@pytest.mark.parametrize("hidden", [0, 1])
def test_mirror_images_are_seen_by_both_in_the_same_way(rng: np.random.Generator, hidden: int) -> None:
    layouts = few(rng)
    found = np.empty((3, 3))
    for mirrored in (False, True):
        for confusion in confusions(list(layouts), hidden, mirrored):
            place = confusion.seen, confusion.taken
            found[place] = min(found[place], confusion.separation) if mirrored else confusion.separation
    np.testing.assert_allclose(found, brute_force(layouts, hidden, True), rtol=1e-6)


def test_separations_do_not_depend_on_place_turn_and_order(rng: np.random.Generator) -> None:
    layouts = few(rng)
    moved = np.empty_like(layouts)
    for k, layout in enumerate(layouts):
        turn = exp_rotation(np.array([0.0, 0.0, rng.uniform(0, 7)]))[:2, :2]
        moved[k] = (layout @ turn.T + rng.normal(size=2))[rng.permutation(6)]
    for hidden, mirrors in itertools.product((0, 1), (False, True)):
        plain = separations(layouts, hidden, mirrors)
        np.testing.assert_allclose(separations(moved, hidden, mirrors), plain, rtol=1e-6)
        np.testing.assert_allclose(separations(layouts * [-1, 1], hidden, mirrors), plain, rtol=1e-9)
        np.testing.assert_allclose(separations(3.0 * layouts, hidden, mirrors), 3.0 * plain, rtol=1e-9)


def test_hiding_an_led_and_counting_mirror_images_bring_constellations_nearer(rng: np.random.Generator) -> None:
    layouts = few(rng, 6)
    assert (separations(layouts, 1, False) < separations(layouts, 0, False)).all()
    assert (separations(layouts, 0, True) <= separations(layouts, 0, False)).all()


def test_a_regular_hexagon_is_taken_for_itself_turned() -> None:
    one = HEXAGON[None]
    assert separations(one, 0, False)[0, 0] < 1e-9
    assert separations(one, 1, False)[0, 0] < 1e-9


def test_a_limit_is_returned_where_the_separation_is_larger(rng: np.random.Generator) -> None:
    one, other = few(rng, 2)
    full = nearest(one, other, tables_of(other), False, 1, True, np.inf)
    assert nearest(one, other, tables_of(other), False, 1, True, 0.9 * full) == pytest.approx(0.9 * full)
    assert nearest(one, other, tables_of(other), False, 1, True, 1.1 * full) == full


def test_strength_is_the_worst_of_both_directions(rng: np.random.Generator) -> None:
    layouts = few(rng, 2)
    visible, hidden = brute_force(layouts, 0, True), brute_force(layouts, 1, True)
    tables = [tables_of(layout) for layout in layouts]
    for ratio in (1.0, 3.2, 50.0):
        pair = strength(layouts[0], tables[0], layouts[1], tables[1], False, ratio, np.inf)
        assert pair == pytest.approx(min(hidden[0, 1], hidden[1, 0], visible[0, 1] / ratio, visible[1, 0] / ratio))
        alone = strength(layouts[0], tables[0], layouts[0], tables[0], True, ratio, np.inf)
        assert alone == pytest.approx(min(hidden[0, 0], visible[0, 0] / ratio))


def test_four_leds_on_a_line_have_no_tables() -> None:
    layout = np.array([[0.0, 0.0], [0.02, 0.0], [0.04, 0.0], [0.06, 0.0], [0.01, 0.03], [0.05, -0.02]])
    for turn in (0.0, 0.5, np.pi / 2):
        turned = layout @ exp_rotation(np.array([0.0, 0.0, turn]))[:2, :2].T
        assert not tabulate(turned, np.empty(TABLES))
