"""Several simulated cameras of one world: the same robots, each seen as its own place has it."""

from dataclasses import replace

import numpy as np
import pytest

from asterism.protocol.geometry import Pose
from asterism.protocol.rig import Rig
from asterism.server.simulation.simulate import Look, Scene
from asterism.server.simulation.view import reach_of
from tests.helpers import assert_poses_close
from tests.rigs import make_camera, make_rig
from tests.several import facing_pair, looking_at, rigs_at

LEFT, RIGHT = rigs_at(facing_pair(), robots=5)


def in_world(rig: Rig, scene: Scene, time_s: float) -> dict[str, Pose]:
    assert rig.T_world_camera is not None
    return {entry.robot: rig.T_world_camera @ entry.T_camera_robot for entry in scene.truth(0, time_s)}


@pytest.mark.parametrize("time_s", [0.0, 7.25, 1_800_000_000.125])
def test_two_cameras_show_the_same_robots_at_the_same_places(time_s: float) -> None:
    """Whatever order their rigs have them in, whatever their lens; other seeds, other drives."""
    turned = replace(RIGHT, robots=RIGHT.robots[::-1], camera=make_camera(640, 480, 500.0, "right"))
    here, there = in_world(LEFT, Scene(LEFT, 3), time_s), in_world(turned, Scene(turned, 3), time_s)
    assert here.keys() == there.keys()
    for robot, pose in here.items():
        assert_poses_close(pose, there[robot], 1e-12, 1e-12)
    other = in_world(LEFT, Scene(LEFT, 4), time_s)
    assert all(np.linalg.norm(other[robot].position - here[robot].position) > 1e-3 for robot in here)


def test_what_is_lit_is_where_the_truth_projects_to_and_what_is_not_is_dark() -> None:
    for rig in (LEFT, RIGHT):
        scene = Scene(rig, 1, Look(hidden=0.3))
        truth = scene.truth(4, 2.0)
        image, seen = scene.render(4, truth), 0
        for k, entry in enumerate(truth):
            pixels = rig.camera.project(entry.T_camera_robot.map(rig.robots[k].leds))
            for shown, (x, y) in zip(scene.visible(k, entry), pixels, strict=True):
                patch = image[max(round(y) - 1, 0) : round(y) + 2, max(round(x) - 1, 0) : round(x) + 2]
                if 3 < x < 1276 and 3 < y < 1020:
                    assert (patch.max() > 60) == shown
                    seen += shown
        assert 10 < seen < 30


def test_a_frame_depends_on_seed_number_and_time_and_cameras_have_noise_of_their_own() -> None:
    first, again = Scene(LEFT, 5, Look(hidden=0.2)), Scene(LEFT, 5, Look(hidden=0.2))
    frame = first.render(7, first.truth(7, 0.2))
    np.testing.assert_array_equal(frame, again.render(7, again.truth(7, 0.2)))
    twin = replace(LEFT, camera=replace(LEFT.camera, name="twin"))
    beside = Scene(twin, 5, Look(hidden=0.2))
    assert [entry.lit for entry in beside.truth(7, 0.2)] != [entry.lit for entry in first.truth(7, 0.2)]
    # The same robots in the same place before a camera with other noise.
    dark = np.ones(frame.shape, bool)
    other = beside.render(7, first.truth(7, 0.2))
    for k, entry in enumerate(first.truth(7, 0.2)):
        for x, y in LEFT.camera.project(entry.T_camera_robot.map(LEFT.robots[k].leds)):
            dark[max(round(y) - 12, 0) : round(y) + 13, max(round(x) - 12, 0) : round(x) + 13] = False
    noise, others = frame[dark].astype(float), other[dark].astype(float)
    assert noise.std() == pytest.approx(others.std(), rel=0.01)
    assert abs(np.corrcoef(noise, others)[0, 1]) < 0.005


def test_a_robot_beyond_the_view_is_not_in_the_image() -> None:
    """A camera at the table's end, near the floor, sees some of five robots, and none that it does not see."""
    rig = replace(LEFT, T_world_camera=looking_at(np.array([0.4, -0.2, 0.5]), np.array([0.3, -0.2, 0.0])))
    scene = Scene(rig, 0)
    assert scene.table.common
    truth = scene.truth(0, 0.0)
    visible = [sum(scene.visible(k, entry)) for k, entry in enumerate(truth)]
    assert 0 in visible
    assert 6 in visible
    away = [
        entry if seen == 0 else replace(entry, lit=(False,) * 6) for entry, seen in zip(truth, visible, strict=True)
    ]
    nobody = [replace(entry, lit=(False,) * 6) for entry in truth]
    np.testing.assert_array_equal(scene.render(0, away), scene.render(0, nobody))


def test_an_led_that_faces_away_is_dark() -> None:
    """A camera below the robots' plates, as far as LEDs shine."""
    scene = Scene(LEFT, 0)
    entry = scene.truth(0, 0.0)[0]
    over = Pose(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    turned = replace(entry, T_camera_robot=entry.T_camera_robot @ over)
    assert scene.visible(0, entry) == (True,) * 6
    assert scene.visible(0, turned) == (False,) * 6


def test_a_lens_that_turns_back_shows_nobody_from_far_outside() -> None:
    """k1 = -0.11 alone brings a direction of tangent 3 back to the middle of the image."""
    camera = replace(make_camera(), distortion=np.array([-0.11, 0.0, 0.0, 0.0, 0.0]))
    assert camera.project(np.array([3.0, 0.2, 1.0]))[0] < 1280
    assert 0.55 < reach_of(camera) < 0.65
    scene = Scene(replace(LEFT, camera=camera), 0)
    entry = scene.truth(0, 0.0)[0]
    beside = Pose(np.array([3.0, 0.2, 1.0]), entry.T_camera_robot.orientation)
    assert scene.visible(0, replace(entry, T_camera_robot=beside)) == (False,) * 6


def test_a_fixed_constellation_stands_where_the_rig_has_it() -> None:
    place = Pose(np.array([0.1, -0.2, 0.05]), np.array([0.0, 0.0, 0.6, 0.8]))
    base = replace(LEFT.robots[2], T_world_fixed=place)
    rig = replace(LEFT, robots=(*LEFT.robots[:2], base, *LEFT.robots[3:]))
    without = replace(RIGHT, robots=(*RIGHT.robots[:2], *RIGHT.robots[3:]))
    here, there = in_world(rig, Scene(rig, 3), 9.0), in_world(without, Scene(without, 3), 9.0)
    assert_poses_close(here.pop(base.id), place, 1e-12, 1e-12)
    for robot, pose in there.items():  # who drives does not notice
        assert_poses_close(pose, here[robot], 1e-12, 1e-12)


def test_many_robots_have_a_larger_table_each_a_part_of_its_own() -> None:
    rig = make_rig(60, T_world_camera=looking_at(np.array([0.0, 0.0, 4.0]), np.array([0.01, 0.0, 0.0])))
    scene = Scene(rig, 0)
    for time_s in (0.0, 3.0, 500.0):
        places = np.array([pose.position for pose in in_world(rig, scene, time_s).values()])
        apart = np.linalg.norm(places[:, None] - places[None], axis=-1) + np.eye(60)
        assert apart.min() > 0.1


def test_a_camera_that_would_see_nobody_has_a_table_of_its_own() -> None:
    away = replace(LEFT, T_world_camera=looking_at(np.array([5.0, 3.0, 1.3]), np.array([5.1, 3.0, 0.0])))
    level = replace(LEFT, T_world_camera=looking_at(np.array([0.0, 0.0, 0.3]), np.array([2.0, 0.0, 0.3])))
    for rig in (away, level, replace(LEFT, T_world_camera=None)):
        scene = Scene(rig, 0)
        assert not scene.table.common
        assert all(sum(scene.visible(k, entry)) == 6 for k, entry in enumerate(scene.truth(0, 1.0)))
