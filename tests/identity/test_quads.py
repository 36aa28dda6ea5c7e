"""What the cold search is made of: invariants, the table, four spots in any perspective, neighbours."""

import itertools
import math

import numpy as np
import pytest

from asterism.protocol.geometry import Floats
from asterism.server.identity.neighbours import Spots, directions_of, first_from, nearest_neighbours
from asterism.server.identity.perspective import View
from asterism.server.identity.quads import CELLS, LAYERS, SLACKS, QuadTable, invariants, look_up, room_to_look_up
from asterism.server.pose.sphere import project, touch
from tests.helpers import facing_pose, random_rotation
from tests.rigs import random_layout


def test_invariants_do_not_change_under_affine_maps(rng: np.random.Generator) -> None:
    order, values, order2, values2 = np.empty(4, np.int64), np.empty(2), np.empty(4, np.int64), np.empty(2)
    for _ in range(300):
        points = rng.normal(size=(4, 2))
        a = rng.normal(size=(2, 2))
        if np.linalg.det(a) < 0.05:
            continue
        kind, area = invariants(points, order, values)
        moved = points @ a.T + rng.normal(size=2)
        kind2, area2 = invariants(moved, order2, values2)
        assert kind == kind2
        assert order.tolist() == order2.tolist()
        np.testing.assert_allclose(values2, values, atol=1e-7)
        assert area2 == pytest.approx(area * np.linalg.det(a), rel=1e-6)


def test_invariants_mean_what_they_say(rng: np.random.Generator) -> None:
    order, values = np.empty(4, np.int64), np.empty(2)
    for _ in range(300):
        points = rng.normal(size=(4, 2))
        kind, _ = invariants(points, order, values)
        q, (s, t) = points[order], values
        if kind == 0:
            np.testing.assert_allclose(q[0] + s * (q[2] - q[0]), q[1] + t * (q[3] - q[1]), atol=1e-9)
        else:
            np.testing.assert_allclose(s * q[0] + t * q[1] + (1 - s - t) * q[2], q[3], atol=1e-9)
            assert min(s, t, 1 - s - t) >= 0
    line = np.column_stack([np.arange(4.0), np.arange(4.0)])
    assert invariants(line, order, values)[0] == -1


def test_the_table_holds_every_quad_in_every_rotation(rng: np.random.Generator) -> None:
    layouts = np.array([random_layout(rng) for _ in range(3)])
    table = QuadTable.of(layouts, np.full(3, 1.5))
    order, values = np.empty(4, np.int64), np.empty(2)
    for robot, layout in enumerate(layouts):
        for leds in itertools.permutations(range(6), 4):
            kind, _ = invariants(np.ascontiguousarray(layout[list(leds)]), order, values)
            ring = [robot, *[leds[k] for k in order]]
            for layer in range(len(SLACKS) * len(LAYERS)):
                cell = ((2 * layer + kind) * CELLS + int(values[0] * CELLS)) * CELLS + int(values[1] * CELLS)
                held = table.held[table.starts[cell] : table.starts[cell + 1]]
                (entry,) = [k for k in held if table.entries[k].tolist() == ring]
                assert np.abs(table.numbers[entry, :2] - values).max() < 1e-9


@pytest.mark.parametrize(("near", "far"), [(0.2, 0.4), (0.8, 2.0)])
def test_four_leds_are_looked_up_in_any_perspective_and_their_mirror_image_is_not(
    rng: np.random.Generator, near: float, far: float
) -> None:
    """Every four LEDs of a near, tilted plate are among the matches of their spots, anywhere in the image, with a map
    that puts the other two where they are; the mirrored spots find nothing with the same labels.
    """
    spot, layouts = 1.5e-4, np.array([random_layout(rng) for _ in range(4)])
    table = QuadTable.of(layouts, np.full(4, math.sin(math.radians(75)) / (0.8 * near)))
    room, order, values, frame = room_to_look_up(), np.empty(4, np.int64), np.empty(2), np.empty((3, 3))
    view = View(0.6 / far, 1.6 / near, 0.8 * math.cos(math.radians(75)), spot, 1e-5)
    wanted = np.ones(4, np.bool_)

    def looked_up(flat: Floats, leds: tuple[int, ...]) -> list[list[int]]:
        room.four[:] = flat[list(leds)]
        count = look_up(room, table, view, wanted)
        assert count < len(room.matches)
        return [table.entries[k].tolist() for k in room.matches[:count]]

    tried = missed = strayed = 0
    for _ in range(60):
        robot, tilt = int(rng.integers(4)), rng.uniform(0.0, 72.0)
        pose = facing_pose(rng, (near, far), (tilt, tilt))
        seen = pose.map(np.column_stack([layouts[robot], np.zeros(6)])) @ random_rotation(rng, 1.0).T
        seen *= [1.0, -1.0, 1.0]
        if (seen[:, 2] < 0.01).any():
            continue
        units = seen / np.linalg.norm(seen, axis=1, keepdims=True)
        touch(units[0], frame)
        exact = np.array([project(frame, unit) for unit in units])
        flat = exact + 0.3 * spot * rng.standard_normal((6, 2))
        for leds in itertools.combinations(range(6), 4):
            found = looked_up(flat, leds)
            area = invariants(np.ascontiguousarray(flat[list(leds)]), order, values)[1]
            label = [robot, *[leds[k] for k in order]]
            if area > 0.02 * np.ptp(flat, axis=0).max() ** 2:
                tried += 1
                missed += label not in found
                if label in found:
                    mapped = np.column_stack([layouts[robot], np.ones(6)]) @ room.hs[found.index(label)].T
                    strayed += np.abs(mapped[:, :2] / mapped[:, 2:] - exact).max() > 25 * spot
            mirrored = looked_up(flat * [-1.0, 1.0], leds)
            assert [robot, *[leds[k] for k in room.order]] not in mirrored
    assert tried > 450
    assert missed <= 0.02 * tried
    assert strayed <= 0.02 * tried


def test_a_touching_plane_keeps_angles_and_turns_the_shortest_way(rng: np.random.Generator) -> None:
    frame = np.empty((3, 3))
    for _ in range(50):
        unit = rng.normal(size=3)
        unit /= np.sign(unit[2]) * np.linalg.norm(unit)
        touch(unit, frame)
        np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(frame) > 0.0
        assert np.trace(frame) == pytest.approx(1.0 + 2.0 * unit[2])
        away = 0.1 * rng.normal(size=2)
        other = frame.T @ np.append(away, 1.0)
        np.testing.assert_allclose(project(frame, other / np.linalg.norm(other)), away, atol=1e-12)


def test_nearest_neighbours_equal_sorting_all_distances(rng: np.random.Generator) -> None:
    """Over the whole half sphere, far off the axis too."""
    angles = rng.uniform([0.0, 0.0], [2 * math.pi, 1.5], (80, 2))
    rays = np.tan(angles[:, 1:]) * np.column_stack([np.cos(angles[:, 0]), np.sin(angles[:, 0])])
    usable = rng.random(80) < 0.8
    ranks, heights, radii = rng.permutation(80), rng.uniform(20, 200, 80), rng.uniform(1, 4, 80)
    spots = Spots(rays, rays, heights, heights, radii, usable)
    directions = directions_of(rays)
    np.testing.assert_allclose(directions.units[:, :2] / directions.units[:, 2:], rays * [1.0, -1.0], rtol=1e-9)
    lists, counts = nearest_neighbours(spots, directions, ranks, 0.7, (0.5, 0.6), 6)
    for i in np.flatnonzero(usable):
        away = np.linalg.norm(directions.units - directions.units[i], axis=1)
        unlike = (heights < 0.5 * heights[i]) | (np.minimum(radii, radii[i]) < 0.6 * np.maximum(radii, radii[i]))
        away[i], away[~usable | unlike | (ranks < ranks[i])] = np.inf, np.inf
        expected = [j for j in np.argsort(away)[:6] if away[j] <= 0.7]
        assert lists[i, : counts[i]].tolist() == expected
    assert counts.max() == 6


def test_the_first_place_equals_searchsorted(rng: np.random.Generator) -> None:
    xs = np.sort(rng.integers(0, 50, 40).astype(float))
    for x in [-1.0, 60.0, *rng.integers(0, 50, 30).astype(float)]:
        assert first_from(xs, x) == np.searchsorted(xs, x, side="left")
