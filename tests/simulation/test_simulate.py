"""The simulator: its light against brute force, its truth against its images, its seed."""

from dataclasses import replace

import numpy as np
import pytest

from asterism.protocol.geometry import Pose
from asterism.protocol.rig import load_rig
from asterism.server.pose.lens import lens_of
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.simulation.simulate import Look, Scene, quadrature, trace_disc
from tests.rigs import make_camera, make_rig

RIG = load_rig(DEMO_RIG)


@pytest.mark.parametrize("tilt_deg", [0.0, 50.0])
def test_a_disc_equals_its_points_counted_one_by_one(rng: np.random.Generator, tilt_deg: float) -> None:
    """A million points on the disc, each projected, blurred by drawing, counted in its pixel.

    The disc is as bright seen from everywhere, so a point counts as much as the image of its surroundings is large.
    """
    camera = make_camera()
    centre, psf, radius = np.array([0.31, -0.22, 1.1]), 0.8, 0.0025
    tilt = np.radians(tilt_deg)
    normal = np.array([np.sin(tilt), 0.0, -np.cos(tilt)])
    light = np.zeros((64, 64))
    x0, y0, width, height = trace_disc(lens_of(camera), centre, normal, radius, psf, quadrature(3.2, psf), light)
    across, n = np.array([np.cos(tilt), 0.0, np.sin(tilt)]), 1_000_000
    r, angle = radius * np.sqrt(rng.random(n)), rng.uniform(0, 2 * np.pi, n)
    points = centre + (r * np.cos(angle))[:, None] * across + (r * np.sin(angle))[:, None] * np.cross(normal, across)
    pixels = np.rint(camera.project(points) + psf * rng.standard_normal((n, 2))).astype(int) - [x0, y0]
    counted = np.zeros((height, width))
    inside = ((pixels >= 0) & (pixels < [width, height])).all(axis=1)
    covers = (centre[2] / points[:, 2]) ** 3
    np.add.at(counted, (pixels[inside, 1], pixels[inside, 0]), covers[inside])
    counted *= light[:height, :width].sum() / covers.sum()
    assert inside.mean() > 0.9999
    # Some 30 000 points a pixel are counted: half a percent of noise.
    difference = light[:height, :width] - counted
    assert np.abs(difference).max() < 0.025
    assert np.sqrt((difference**2).mean()) < 0.005
    # The plateau of a disc much larger than its blur is 1.
    big = np.zeros((255, 255))
    trace_disc(
        lens_of(camera), np.array([0.0, 0.0, 1.1]), np.array([0.0, 0.0, -1.0]), 0.02, psf, quadrature(26.0, psf), big
    )
    assert big.max() == pytest.approx(1.0, abs=0.01)


def test_a_disc_is_equally_bright_all_over() -> None:
    # Its far half covers fewer pixels, not darker ones.
    lens = lens_of(replace(make_camera(), distortion=np.zeros(5)))
    light, tilt = np.zeros((255, 255)), np.radians(55)
    normal = np.array([np.sin(tilt), 0.0, -np.cos(tilt)])
    x0, y0, _, _ = trace_disc(lens, np.array([0.0, 0.0, 0.4]), normal, 0.02, 0.8, quadrature(80.0, 0.8), light)
    middle = np.rint(lens[2:4]).astype(int) - [x0, y0]
    row = light[middle[1], middle[0] - 30 : middle[0] + 31]
    np.testing.assert_allclose(row, row[30], rtol=0.005)


def test_frames_depend_on_seed_and_index_alone() -> None:
    first, second = Scene(RIG, 5, Look(hidden=0.2, glints=3)), Scene(RIG, 5, Look(hidden=0.2, glints=3))
    late = second.render(7, second.truth(7, 0.2))
    for index in (0, 7):
        np.testing.assert_array_equal(
            first.render(index, first.truth(index, 0.2)), second.render(index, second.truth(index, 0.2))
        )
    np.testing.assert_array_equal(first.render(7, first.truth(7, 0.2)), late)
    other = Scene(RIG, 6, Look(hidden=0.2, glints=3))
    assert (other.render(7, other.truth(7, 0.2)) != late).any()


def test_hidden_leds_are_dark_and_lit_ones_bright() -> None:
    scene = Scene(RIG, 1, Look(hidden=0.4))
    truth = scene.truth(3, 1.0)
    image = scene.render(3, truth)
    assert 0 < sum(sum(entry.lit) for entry in truth) < 30
    for robot, entry in zip(RIG.robots, truth, strict=True):
        for lit, (x, y) in zip(entry.lit, RIG.camera.project(entry.T_camera_robot.map(robot.leds)), strict=True):
            patch = image[round(y) - 2 : round(y) + 3, round(x) - 2 : round(x) + 3]
            assert (patch.max() > 100) == lit


def test_robots_stay_in_view_move_smoothly_and_face_the_camera() -> None:
    for rig in (RIG, make_rig(12, seed=3)):
        scene = Scene(rig, 0)
        for k, robot in enumerate(rig.robots):
            positions = []
            for time_s in np.arange(0, 60, 0.5):
                pose = scene.pose(k, time_s)
                pixels = rig.camera.project(pose.map(robot.leds))
                assert (pixels > 3).all()
                assert (pixels < [rig.camera.width - 3, rig.camera.height - 3]).all()
                normal = pose.rotation @ robot.T_robot_plane.rotation[:, 2]
                assert normal @ pose.position < 0
                positions.append(pose.position)
            speed = np.linalg.norm(np.diff(positions, axis=0), axis=1) / 0.5
            assert speed.max() < 0.5


def test_the_surface_is_where_the_world_says() -> None:
    # The demonstration's camera looks straight down from 1.3 m; the robots drive near the floor, LEDs up.
    scene = Scene(RIG, 0)
    assert RIG.T_world_camera is not None
    for k, robot in enumerate(RIG.robots):
        T_world_robot: Pose = RIG.T_world_camera @ scene.pose(k, 3.0)
        assert -0.05 < T_world_robot.position[2] < 0.2
        assert (T_world_robot.rotation @ robot.axis)[2] > 0.8
