"""The surface for the kernels is that of `protocol.surface`: places, normals, edges; and how a pose is off it."""

import numpy as np
import pytest

from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.protocol.surface import Heights, Quadric, Surface
from asterism.server.pose.ground import Terrain, fill_ground, is_within, sigma_at, touch, touching_room
from asterism.server.pose.on_surface import Feet, Underfoot, fill_stance, stance_room
from tests.on_surface import BENT


def grid(rng: np.random.Generator, holes: int = 12) -> Heights:
    """Hills of a few centimetres, with holes, known here better than there."""
    x, y = np.meshgrid(0.02 * np.arange(26) - 0.25, 0.03 * np.arange(20) - 0.3, indexing="ij")
    values = 0.02 * np.sin(9.0 * x) * np.cos(7.0 * y) + 0.3 * x * y
    values[rng.integers(0, 26, holes), rng.integers(0, 20, holes)] = np.nan
    return Heights(np.array([-0.25, -0.3]), np.array([0.02, 0.03]), values, rng.uniform(1e-5, 1e-4, values.shape))


def surfaces(rng: np.random.Generator) -> dict[str, Surface]:
    """One of every kind."""
    ball = Quadric(np.array([-0.09, 0, 0, 0, 1.0, 1.0, 1.0, 0, 0, 0]), np.array([0.0, 0.0, -0.3]))
    edge = np.array([[-0.2, -0.15], [0.22, -0.2], [0.1, 0.0], [0.2, 0.2], [-0.2, 0.18]])
    return {
        "plane": Surface(Quadric.plane(np.array([0.1, 0.0, 0.02]), np.array([0.1, -0.2, 1.0]))),
        "bent": BENT,
        "ball": Surface(ball, edge=edge),
        "grid": Surface(grid(rng), sigma_m=2e-5, edge=edge),
    }


@pytest.mark.parametrize("kind", ["plane", "bent", "ball", "grid"])
def test_the_kernels_surface_is_that_of_the_protocol(kind: str, rng: np.random.Generator) -> None:
    surface = surfaces(rng)[kind]
    terrain, room = Terrain.of(surface), touching_room()
    xy = rng.uniform(-0.35, 0.35, (300, 2))
    ground = surface.ground(xy)
    for k, (x, y) in enumerate(xy.tolist()):
        there = fill_ground(terrain, x, y, room) and is_within(terrain.edge, x, y)
        assert there == ground.inside[k]
        if there:
            told = [ground.heights[k], *ground.slopes[k], *ground.bends[k]]
            assert room.here == pytest.approx(told, abs=1e-11)
            assert sigma_at(terrain, x, y) == pytest.approx(ground.sigmas[k], abs=1e-12)
    assert ground.inside.sum() > 10


@pytest.mark.parametrize("kind", ["plane", "bent", "ball", "grid"])
def test_points_touch_it_where_the_protocol_says(kind: str, rng: np.random.Generator) -> None:
    surface = surfaces(rng)[kind]
    terrain, room = Terrain.of(surface), touching_room()
    xy = rng.uniform(-0.15, 0.15, (100, 2))
    points = np.column_stack([xy, surface.ground(xy).heights + rng.uniform(-0.01, 0.02, 100)])
    told = surface.touch(points)
    found = 0
    for k, (x, y, z) in enumerate(points.tolist()):
        distance, there = touch(terrain, x, y, z, room)
        if told.inside[k]:
            assert there
            assert distance == pytest.approx(told.distances[k], abs=1e-9)
            assert room.foot == pytest.approx(told.points[k, :2], abs=1e-8)
            found += 1
    assert found > 50


def moved(rotation: Floats, t: Floats, step: Floats) -> tuple[Floats, Floats]:
    """A pose moved by translation and turn."""
    return np.ascontiguousarray(exp_rotation(step[3:]) @ rotation), t + step[:3]


@pytest.mark.parametrize("kind", ["plane", "bent", "ball", "grid"])
def test_derivatives_hold_the_bends(kind: str, rng: np.random.Generator) -> None:
    surface = surfaces(rng)[kind]
    place = Pose.from_matrix(exp_rotation(np.array([3.0, 0.2, -0.1])), np.array([0.02, 0.01, 1.3]))
    feet = Feet(np.ones(1, np.int64), np.zeros((1, 3)), np.zeros((1, 3)), np.ones((1, 2)))
    underfoot = Underfoot(Terrain.of(surface), feet, np.array(place.rotation), np.array(place.position))
    stance = stance_room()
    stance.point[:], stance.axis[:] = [0.01, -0.02, -0.03], [0.0, 0.0, 1.0]
    for _ in range(10):
        xy = rng.uniform(-0.1, 0.1, (1, 2))
        ground = surface.ground(xy)
        if not ground.inside[0]:
            continue
        turn = place.rotation @ np.linalg.qr(np.column_stack([ground.normals[0], rng.normal(size=(3, 2))]))[0]
        turn = turn[:, [1, 2, 0]] * np.sign(turn[:, 0] @ place.rotation @ ground.normals[0])
        turn *= [1.0, np.linalg.det(turn), 1.0]
        turn = np.ascontiguousarray(exp_rotation(rng.normal(0, 0.003, 3)) @ turn)
        tool = place.map(np.array([*xy[0], ground.heights[0] + 0.002]))
        t = tool - turn @ stance.point
        assert fill_stance(turn, t, stance, underfoot, True)
        told, numeric, h = stance.by_pose.copy(), np.empty((3, 6)), 1e-6
        for k in range(6):
            offs = []
            for side in (1.0, -1.0):
                step = np.zeros(6)
                step[k] = side * h
                assert fill_stance(*moved(turn, t, step), stance, underfoot, False)
                offs.append(stance.off.copy())
            numeric[:, k] = (offs[0] - offs[1]) / (2 * h)
        assert np.abs(told - numeric).max() < 0.02 * max(1.0, np.abs(numeric).max())
