"""Where tools were, against what is known of paths: areas, times, passes, and what is left out."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.messages import Standing, State
from asterism.protocol.surface import Quadric, Surface
from asterism.protocol.surface_file import Stands
from asterism.server.coverage.accumulate import Coverage
from asterism.server.coverage.grid import pitch_for
from asterism.server.coverage.sightings import Told, Tool
from asterism.server.coverage.visits import Visits
from asterism.server.coverage.working import FINEST
from tests.helpers import random_rotation

RADIUS, PERIOD_S, BEGIN_NS = 0.01, 1 / 60, 10**18
TOOL = Tool(Stands("tool", np.array([0.0, 0.0, 1.0]), 5e-5), RADIUS)
EDGE = np.array([[-0.2, -0.2], [0.2, -0.2], [0.2, 0.2], [-0.2, 0.2]])
TURNED = Pose.from_matrix(random_rotation(np.random.default_rng(3)), np.array([0.3, -0.2, 0.1]))
FLAT = Surface(Quadric.plane(np.zeros(3), np.array([0.0, 0.0, 1.0])), TURNED, edge=EDGE)
STEEP = Surface(Quadric.plane(np.zeros(3), np.array([0.6, -0.5, 0.5])), TURNED, edge=EDGE)
BENT = Surface(Quadric(np.array([0.0, 0.1, -0.2, 1.0, 1.5, 1.0, 0.0, 0.4, 0.0, 0.0])), TURNED, edge=EDGE)
SURFACES = pytest.mark.parametrize("surface", [FLAT, STEEP, BENT], ids=["flat", "steep", "bent"])


def told(surface: Surface, xy: Floats, period_s: float = PERIOD_S) -> Told:
    """Poses of a tool that stands at these places of the surface's frame, one a frame."""
    n = len(xy)
    points = surface.T_world_surface.map(np.column_stack([xy, surface.ground(xy).heights]))
    times = BEGIN_NS + np.round(np.arange(n) * period_s * 1e9).astype(np.int64)
    covariances = np.tile(1e-10 * np.array([1.0, 0.0, 0.0, 1.0, 0.0, 1.0]), (n, 1))
    return Told(times, np.full(n, State.TRACKED), np.full(n, Standing.ON_SURFACE), points, covariances)


def none(surface: Surface, most: int = 250_000) -> Coverage:
    """Nothing yet."""
    return Coverage.none(surface, {"a": TOOL}, pitch_for(surface, RADIUS, FINEST, most), most)


def straightness(seen: Visits) -> Floats:
    """(rows, columns): 1 where the tool always went one way, 0 where it went to and fro; nan where it did not go."""
    with np.errstate(invalid="ignore"):
        straight: Floats = np.hypot(seen.shift_m[..., 0], seen.shift_m[..., 1]) / seen.path_m
    return straight


def visits(coverage: Coverage) -> Visits:
    """Of the one robot."""
    return coverage.map.robots["a"]


def lane(length: float = 0.2, frames: int = 601, turn: float = 0.3) -> Floats:
    """Straight, askew to the grid, at an even speed."""
    along = np.linspace(-0.5, 0.5, frames)[:, None] * length
    return 0.003 + along * np.array([np.cos(turn), np.sin(turn)])


def circle() -> Floats:
    """Once round."""
    angle = np.linspace(0.0, 2.0 * np.pi, 901)
    return 0.08 * np.column_stack([np.cos(angle), np.sin(angle)])


def raster() -> Floats:
    """To and fro, lane beside lane."""
    corners = [[side * (-1) ** k, -0.05 + 0.009 * k] for k in range(10) for side in (-0.1, 0.1)]
    ends = np.cumsum([0.0, *np.linalg.norm(np.diff(corners, axis=0), axis=1)])
    went = np.linspace(0.0, ends[-1], 3000)
    return np.column_stack([np.interp(went, ends, np.array(corners)[:, k]) for k in range(2)])


@SURFACES
@pytest.mark.parametrize("path", [lane(), circle(), raster()], ids=len)
def test_dwell_over_all_of_the_surface_is_time_times_the_disc(surface: Surface, path: Floats) -> None:
    found = none(surface).add({"a": told(surface, path)}, PERIOD_S)
    time_s = (len(path) - 1) * PERIOD_S
    assert visits(found).counted_s == pytest.approx(time_s, rel=1e-6)
    total = (visits(found).dwell_s * found.map.grid.areas).sum()
    assert total == pytest.approx(time_s * np.pi * RADIUS**2, rel=0.01)


@SURFACES
def test_a_tool_that_stands_is_over_the_middles_in_its_disc_all_the_time_and_over_no_other(surface: Surface) -> None:
    place = np.array([0.0031, -0.0042])
    found = none(surface).add({"a": told(surface, np.tile(place, (100, 1)))}, PERIOD_S)
    off = found.map.grid.middles - place
    away = np.sqrt((off**2).sum(axis=-1) + (off @ surface.ground(place[None]).slopes[0]) ** 2)
    assert np.allclose(visits(found).dwell_s, np.where(away <= RADIUS, 99 * PERIOD_S, 0.0), atol=1e-6)


@SURFACES
def test_a_lanes_area_is_that_of_a_band_with_round_ends(surface: Surface) -> None:
    found = none(surface).add({"a": told(surface, lane())}, PERIOD_S)
    feet = np.column_stack([lane(), surface.ground(lane()).heights])
    length = np.linalg.norm(np.diff(feet, axis=0), axis=1).sum()
    area = found.map.grid.areas[visits(found).visited].sum()
    assert area == pytest.approx(2.0 * RADIUS * length + np.pi * RADIUS**2, rel=0.01)


def test_a_circles_area_is_that_of_a_ring() -> None:
    found = none(FLAT).add({"a": told(FLAT, circle())}, PERIOD_S)
    area = found.map.grid.areas[visits(found).visited].sum()
    assert area == pytest.approx(4.0 * np.pi * 0.08 * RADIUS, rel=0.01)


def test_time_over_every_patch_of_a_lane_is_its_chord_by_the_speed() -> None:
    found = none(FLAT).add({"a": told(FLAT, lane(turn=0.0))}, PERIOD_S)
    speed, grid, seen = 0.2 / 10.0, found.map.grid, visits(found)
    off = np.abs(grid.y_m - 0.003)
    chord = 2.0 * np.sqrt(np.maximum(RADIUS**2 - off**2, 0.0))
    between = np.abs(grid.x_m - 0.003) < 0.1 - RADIUS
    assert np.allclose(seen.dwell_s[:, between], (chord / speed)[:, None], rtol=1e-6, atol=1e-9)
    assert np.allclose(seen.speed[seen.visited], speed, rtol=1e-6)
    assert np.allclose(seen.direction[seen.visited], 0.0, atol=1e-6)
    assert np.allclose(straightness(seen)[seen.visited], 1.0)
    middle = np.argmin(np.abs(grid.x_m)), np.argmin(off)
    left = BEGIN_NS + (grid.x_m[middle[0]] - 0.003 + 0.1 + 0.5 * chord[middle[1]]) / speed * 1e9
    assert seen.last_ns[middle[::-1]] == pytest.approx(left, abs=1e4)


def test_there_and_back_is_two_passes_to_no_direction() -> None:
    there = lane(turn=0.0)
    found = visits(none(FLAT).add({"a": told(FLAT, np.concatenate([there, there[-2::-1]]))}, PERIOD_S))
    assert set(np.unique(found.passes)) == {0, 1, 2}
    assert np.median(found.passes[found.visited]) == 2
    row, column = np.argwhere(found.passes == 2).mean(axis=0).astype(int)
    assert straightness(found)[row, column] < 0.01


def test_a_robot_that_shakes_passes_once(rng: np.random.Generator) -> None:
    path = 0.003 + 5e-5 * rng.normal(size=(600, 2))
    found = visits(none(FLAT).add({"a": told(FLAT, path)}, PERIOD_S))
    assert found.passes.max() == 1
    assert found.speed[found.dwell_s > 9.0].max() < 1e-3  # where from frame to frame it is 5 mm/s


def test_a_tool_that_rounds_and_comes_again_passes_again() -> None:
    twice = np.concatenate([circle(), circle()[1:]])
    found = visits(none(FLAT).add({"a": told(FLAT, twice)}, PERIOD_S))
    assert np.percentile(found.passes[found.visited], [10, 50]).tolist() == [2, 2]


@SURFACES
def test_however_poses_are_cut_into_batches_the_map_is_the_same(surface: Surface, rng: np.random.Generator) -> None:
    whole = told(surface, raster())
    one, many = none(surface).add({"a": whole}, PERIOD_S), none(surface)
    cuts = [0, *np.sort(rng.integers(0, 3000, 7)).tolist(), 3000]
    for begin, end in pairwise(cuts):
        many = many.add({"a": Told(*(column[begin:end] for column in whole))}, PERIOD_S)
    a, b = visits(one), visits(many)
    assert np.allclose(a.dwell_s, b.dwell_s, rtol=1e-9, atol=1e-12)
    assert np.array_equal(a.passes, b.passes)
    assert np.array_equal(a.last_ns, b.last_ns)
    assert (a.counted, dict(a.left_out)) == (b.counted, dict(b.left_out))


def test_what_says_nothing_is_left_out_by_its_reason() -> None:
    path = lane(frames=601)
    seen = told(FLAT, path)
    seen.states[100:103] = State.LOST
    seen.states[103:105] = State.TILT_AMBIGUOUS
    seen.covariances[200:204] *= (0.6 * RADIUS) ** 2 / 1e-10
    seen.covariances[210] = np.nan
    for k, standing in enumerate((Standing.LIFTED, Standing.SUNK, Standing.TILTED)):
        seen.standings[300 + 10 * k : 303 + 10 * k] = standing
    seen.points[400:402] = FLAT.T_world_surface.map(np.array([0.3, 0.0, 0.0]))
    found = visits(none(FLAT).add({"a": seen}, PERIOD_S))
    assert dict(found.left_out) == {
        "not tracked": 5, "not sure enough": 5, "lifted": 3, "sunk": 3, "tilted": 3, "beyond the edge": 2,
    }  # fmt: skip
    assert found.counted == 601 - 21
    # Over lost and unsure poses the way goes on; where the tool was somewhere else it does not.
    assert found.counted_s == pytest.approx(10.0 - (3 * 4 + 3) * PERIOD_S, abs=1e-6)


def test_nobody_knows_where_a_tool_was_in_a_gap() -> None:
    whole = told(FLAT, lane())
    kept = np.r_[0:200, 260:601]
    found = visits(none(FLAT).add({"a": Told(*(column[kept] for column in whole))}, PERIOD_S))
    assert dict(found.left_out) == {"gap": 1}
    assert found.counted_s == pytest.approx(10.0 - 61 * PERIOD_S, abs=1e-6)
    back = whole._replace(times_ns=np.r_[whole.times_ns[:300], whole.times_ns[:301]])
    assert dict(visits(none(FLAT).add({"a": back}, PERIOD_S)).left_out) == {"gap": 1}


def test_where_nobody_judged_it_a_tool_off_the_surface_is_lifted_or_sunk() -> None:
    seen = told(FLAT, lane())
    seen.standings[:] = Standing.STANDING_UNSPECIFIED
    up = FLAT.T_world_surface.rotation[:, 2]
    seen.points[:100] += 0.001 * up
    seen.points[100:150] -= 0.001 * up
    seen.points[150:] += 1e-4 * up
    assert dict(visits(none(FLAT).add({"a": seen}, PERIOD_S)).left_out) == {"lifted": 100, "sunk": 50}


def test_a_map_without_an_edge_grows_to_where_tools_are_and_no_farther() -> None:
    endless, whole = replace(FLAT, edge=np.zeros((0, 2))), told(FLAT, raster())
    found, known = none(endless), none(FLAT).add({"a": whole}, PERIOD_S)
    for part in range(3):
        found = found.add({"a": Told(*(column[1000 * part : 1000 * (part + 1)] for column in whole))}, PERIOD_S)
    assert not found.map.grid.ends
    rows, columns = found.map.grid.box.within(known.map.grid.box)
    assert np.allclose(visits(found).dwell_s, visits(known).dwell_s[rows, columns], rtol=1e-9, atol=1e-12)
    assert visits(found).dwell_s.sum() == pytest.approx(visits(known).dwell_s.sum())
    small = none(endless, most=4000).add({"a": told(FLAT, lane(frames=6)[:1])}, PERIOD_S)
    assert visits(small.add({"a": told(FLAT, lane())}, PERIOD_S)).left_out["off the map"] > 0
