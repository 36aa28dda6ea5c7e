"""Gaps and overworked patches of maps in which they are known."""

from dataclasses import replace

import numpy as np
import pytest

from asterism.protocol.geometry import Pose, exp_rotation
from asterism.protocol.surface import Quadric, Surface
from asterism.server.coverage.added import added_by
from asterism.server.coverage.grid import Box
from asterism.server.coverage.regions import gaps_of, overworked_of
from tests.coverage.made_maps import DAY_NS, FLAT, PITCH, RADIUS, SINCE_NS, between, made, visited

TOOL_M2 = np.pi * RADIUS**2


def test_a_gap_is_where_no_tool_has_been() -> None:
    covered = made()
    everywhere = between(covered, (-1, 1), (-1, 1))
    gap = between(covered, (0.1, 0.2), (-0.05, 0.1)) | between(covered, (0.0, 0.1), (-0.05, 0.0))  # an L
    speck = between(covered, (-0.2, -0.19), (0.0, 0.01))
    gaps = gaps_of(visited(covered, "alpha", everywhere & ~gap & ~speck, 1.0))
    (found,) = gaps.found
    assert found.area_m2 == pytest.approx(0.1 * 0.15 + 0.1 * 0.05)
    assert (found.robots, found.last_ns, found.most_s) == ((), 0, 0.0)
    assert between(covered, (0.1, 0.2), (0.0, 0.1))[gaps.numbers == 1].any()
    assert 0.1 < found.xy[0] < 0.2  # where it is widest: not in the foot of the L
    assert found.length_m > found.width_m > 0.1
    np.testing.assert_array_equal(gaps.numbers > 0, gap)
    assert (gaps.specks, gaps.least_m2) == (1, pytest.approx(TOOL_M2))
    assert gaps.specks_m2 == pytest.approx(1e-4)


def test_gaps_are_sorted_by_their_area_on_the_surface_itself() -> None:
    """A slope of 60 degrees doubles what lies on it; and the world is not the surface's frame."""
    steep = Surface(
        Quadric.plane(np.zeros(3), np.array([-np.sqrt(0.75), 0.0, 0.5])),
        Pose.from_matrix(exp_rotation(np.array([0.0, -np.radians(60.0), 0.0])), np.array([0.1, 0.2, 0.3])),
        edge=FLAT.edge,
    )
    covered = made(steep)
    small, large = between(covered, (-0.2, -0.15), (-0.1, 0.1)), between(covered, (0.0, 0.1), (-0.15, 0.15))
    gaps = gaps_of(visited(covered, "alpha", covered.grid.inside & ~small & ~large, 1.0))
    assert [each.area_m2 for each in gaps.found] == [pytest.approx(0.06), pytest.approx(0.02)]
    assert [(each.length_m, each.width_m) for each in gaps.found] == [
        (pytest.approx(0.3, abs=0.004), pytest.approx(0.2, abs=0.004)),
        (pytest.approx(0.2, abs=0.004), pytest.approx(0.1, abs=0.004)),
    ]
    place = steep.T_world_surface.inverse().map(gaps.found[1].place)
    assert place[2] == pytest.approx(np.sqrt(3.0) * place[0])
    np.testing.assert_allclose(place[:2], gaps.found[1].xy, atol=1e-12)
    assert -0.2 < place[0] < -0.15


def test_with_a_stated_time_a_gap_is_also_what_was_visited_for_less() -> None:
    covered = made()
    left, right = between(covered, (-1, 0), (-1, 1)), between(covered, (0, 1), (-1, 1))
    covered = visited(visited(covered, "alpha", left, 2.0), "bravo", right, 0.5, at_s=7.0)
    covered = visited(covered, "alpha", right, 0.25, at_s=5.0)
    assert gaps_of(covered).found == ()
    (gap,) = gaps_of(covered, 1.0).found
    assert gap.area_m2 == pytest.approx(0.3 * 0.4)
    assert gap.robots == (("bravo", pytest.approx(2 / 3)), ("alpha", pytest.approx(1 / 3)))
    assert gap.last_ns == SINCE_NS + 7_000_000_000
    assert (gap.mean_s, gap.most_s) == (pytest.approx(0.75), 0.75)


def test_overworked_is_what_lies_far_above_the_median_of_visited_patches() -> None:
    covered = made()
    half = between(covered, (-1, 0), (-1, 1))  # the other half was never visited, and does not count
    disc = covered.grid.inside & (np.hypot(*np.moveaxis(covered.grid.middles - [-0.1, 0.05], -1, 0)) < RADIUS)
    covered = visited(visited(covered, "alpha", half, 1.0), "bravo", disc, 2.5)
    few = between(covered, (-0.2, -0.19), (-0.1, -0.09))
    covered = visited(covered, "alpha", few, 9.0)
    overworked = overworked_of(covered)
    assert overworked.limit_s == 3.0
    (found,) = overworked.found  # a tool that stood still: not left out as too small
    assert found.area_m2 == pytest.approx(TOOL_M2, rel=0.1)
    assert (found.most_s, found.mean_s) == (3.5, pytest.approx(3.5))
    assert [robot for robot, _ in found.robots] == ["bravo", "alpha"]
    assert (overworked.specks, overworked.specks_m2) == (1, pytest.approx(4 * PITCH**2))
    assert np.linalg.norm(found.xy - [-0.1, 0.05]) < PITCH
    assert not overworked_of(visited(made(), "alpha", half, 1.0)).found


def test_nothing_visited_is_one_gap_and_nothing_overworked() -> None:
    covered = made()
    (gap,) = gaps_of(covered).found
    assert gap.area_m2 == pytest.approx(0.6 * 0.4)
    overworked = overworked_of(covered)
    assert (overworked.found, overworked.specks, overworked.limit_s) == ((), 0, 0.0)


def test_of_a_surface_without_an_end_a_gap_is_what_is_closed_in() -> None:
    covered = made(replace(FLAT, edge=np.zeros((0, 2))), box=Box(-50, -50, 50, 50))
    ring = between(covered, (-0.2, 0.2), (-0.15, 0.15)) & ~between(covered, (-0.1, 0.1), (-0.05, 0.05))
    (gap,) = gaps_of(visited(covered, "alpha", ring, 1.0)).found
    assert gap.area_m2 == pytest.approx(0.2 * 0.1)


def test_what_a_recording_added_is_told_from_the_maps_before_and_after_it() -> None:
    start = made(replace(FLAT, edge=np.zeros((0, 2))), box=Box(-20, -20, 20, 20))
    first = visited(start, "alpha", between(start, (-0.05, 0.05), (-0.05, 0.05)), 1.0)
    grown = first.reaching(Box(-60, -40, 60, 40))
    second = visited(grown, "bravo", between(grown, (0.0, 0.2), (-0.05, 0.05)), 1.0, at_s=90_000.0)
    added = added_by("tuesday", SINCE_NS + DAY_NS, SINCE_NS + DAY_NS + 1, first, second)
    assert (added.new_m2, added.over_m2) == (pytest.approx(0.15 * 0.1), pytest.approx(0.2 * 0.1))
    assert (added.counted, added.counted_s, added.left_out) == (60, pytest.approx(1.0), 0)
