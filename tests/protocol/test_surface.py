"""Surfaces: heights against bisection, slopes against differences, the nearest point against a search."""

import numpy as np
import pytest

from asterism.protocol.geometry import Pose, exp_rotation
from asterism.protocol.heights_file import heights_text, parse_heights
from asterism.protocol.surface import Heights, Quadric, Surface
from tests.on_surface import BENT, height, places, stood

SPHERE = Surface(Quadric(np.array([-1.0, 0, 0, 0, 1, 1, 1, 0, 0, 0.0]), np.array([0.02, -0.01, -1.0])))
TURNED = Surface(BENT.shape, Pose.from_matrix(exp_rotation(np.array([0.3, -0.5, 0.2])), np.array([0.1, 0.2, -0.3])))


def gridded(step: float = 0.01) -> Surface:
    nodes = np.arange(-0.3, 0.3 + step / 2, step)
    x, y = np.meshgrid(nodes, nodes, indexing="ij")
    z = BENT.shape.ground(np.column_stack([x.ravel(), y.ravel()]))[0].reshape(x.shape)
    return Surface(Heights(np.array([-0.3, -0.3]), np.array([step, step]), z, np.full(x.shape, 2e-5)))


@pytest.mark.parametrize("surface", [BENT, SPHERE], ids=["bent", "sphere"])
def test_heights_are_where_the_sum_is_zero_and_slopes_are_their_differences(
    surface: Surface, rng: np.random.Generator
) -> None:
    xy = rng.uniform(-0.25, 0.25, (20, 2))
    ground = surface.ground(xy)
    assert ground.inside.all()
    assert ground.heights == pytest.approx([height(surface, *place) for place in xy], abs=1e-12)
    h = 1e-5
    for axis in range(2):
        step = h * np.eye(2)[axis]
        up, down = surface.ground(xy + step), surface.ground(xy - step)
        assert ground.slopes[:, axis] == pytest.approx((up.heights - down.heights) / (2 * h), abs=1e-8)
        assert ground.bends[:, axis : axis + 2] == pytest.approx((up.slopes - down.slopes) / (2 * h), abs=1e-6)


def test_a_grid_of_a_bent_surface_is_that_surface(rng: np.random.Generator) -> None:
    xy = rng.uniform(-0.29, 0.29, (50, 2))
    grid, true = gridded().ground(xy), BENT.ground(xy)
    assert grid.inside.all()
    assert grid.heights == pytest.approx(true.heights, abs=1e-12)
    assert grid.slopes == pytest.approx(true.slopes, abs=1e-10)
    assert grid.sigmas == pytest.approx(2e-5)
    assert not gridded().ground(np.array([[0.301, 0.0], [0.0, -0.31]])).inside.any()


def test_a_hole_in_a_grid_is_no_surface() -> None:
    shape = gridded().shape
    assert isinstance(shape, Heights)
    values = shape.values.copy()
    values[30, 30] = np.nan
    holed = Surface(Heights(shape.origin, shape.step, values, shape.sigmas))
    assert holed.ground(np.array([[0.003, 0.003], [0.013, 0.003], [-0.013, 0.0]])).inside.tolist() == [
        False,
        True,
        True,
    ]


@pytest.mark.parametrize("surface", [BENT, SPHERE, TURNED, gridded()], ids=["bent", "sphere", "turned", "grid"])
def test_a_point_lifted_along_the_normal_touches_where_it_was(surface: Surface, rng: np.random.Generator) -> None:
    feet = rng.uniform(-0.2, 0.2, (30, 2))
    ground = surface.ground(feet)
    lifts = rng.uniform(-0.02, 0.05, 30)
    on = np.column_stack([feet, ground.heights])
    touch = surface.touch(surface.T_world_surface.map(on + lifts[:, None] * ground.normals))
    assert touch.inside.all()
    assert touch.distances == pytest.approx(lifts, abs=1e-9)
    assert touch.points == pytest.approx(surface.T_world_surface.map(on), abs=1e-7)
    assert touch.normals == pytest.approx(ground.normals @ surface.T_world_surface.rotation.T, abs=1e-6)


def test_an_edge_ends_the_surface() -> None:
    triangle = Surface(BENT.shape, edge=np.array([[0.0, 0.0], [0.2, 0.0], [0.0, 0.2]]))
    inside = triangle.ground(np.array([[0.05, 0.05], [0.15, 0.15], [-0.01, 0.1]])).inside
    assert inside.tolist() == [True, False, False]


def test_the_stage_stands_robots_on_it(rng: np.random.Generator) -> None:
    from tests.on_surface import TOOL

    for surface in (BENT, TURNED):
        for x, y, heading in places(rng, 3):
            pose = stood(surface, x, y, heading, lift_m=0.002)
            touch = surface.touch(pose.map(TOOL)[None])
            assert touch.distances == pytest.approx([0.002], abs=1e-8)
            assert pose.rotation[:, 2] == pytest.approx(touch.normals[0], abs=1e-6)


def test_a_table_of_heights_is_read_as_it_was_written() -> None:
    shape = gridded(0.02).shape
    assert isinstance(shape, Heights)
    read = parse_heights(heights_text(shape), "mould.csv")
    assert read.values == pytest.approx(shape.values, abs=1e-9)
    assert read.sigmas == pytest.approx(shape.sigmas)
    assert (read.origin, read.step) == (pytest.approx(shape.origin), pytest.approx(shape.step))
