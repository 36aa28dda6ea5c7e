"""Robots that move while the shutter is open: their motion from their streaks, and where their light's mean lies."""

import numpy as np
import pytest

from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.server import PoseEstimate
from asterism.server.pose.streaks import POWER, Arms, Motion, light_off, motion_of
from tests.chain.frames import alone, draw, poses_apart
from tests.helpers import facing_pose
from tests.rigs import make_rig

FOCAL = 1400.0
SHARES = (np.arange(101) + 0.5) / 101 - 0.5


def moved(pose: Pose, motion: Floats, share: float) -> Pose:
    return Pose.from_matrix(exp_rotation(share * motion[3:]) @ pose.rotation, pose.position + share * motion[:3])


def arms_of(pose: Pose, leds: Floats, moments: Floats) -> Arms:
    points = pose.map(leds)
    return Arms(points, points - pose.position, moments, np.ascontiguousarray(pose.rotation[:, 2]))


def tracks_of(pose: Pose, leds: Floats, motion: Floats) -> tuple[Floats, Floats]:
    """Rays (shares, 6, 2) of LEDs during the exposure, and their light (shares, 6): as the cosine's power."""
    rays, light = [], []
    for share in SHARES:
        there = moved(pose, motion, share)
        points = there.map(leds)
        away = np.linalg.norm(points, axis=1)
        rays.append(points[:, :2] / points[:, 2:])
        light.append((np.abs(points @ there.rotation[:, 2]) / away) ** POWER / away**2)
    return np.array(rays), np.array(light)


def motion_drawn(rng: np.random.Generator) -> Floats:
    return np.concatenate([rng.normal(size=3) * [3e-3, 3e-3, 1e-3], 0.06 * rng.normal(size=3)])


def test_streaks_tell_how_a_robot_moved_and_turned(rng: np.random.Generator) -> None:
    leds = make_rig(1, seed=3).robots[0].leds_plane
    squared = []
    for _ in range(20):
        pose, motion = facing_pose(rng, (0.8, 1.4), (20.0, 50.0)), motion_drawn(rng)
        rays, _ = tracks_of(pose, leds, motion)
        off = FOCAL * (rays - rays.mean(axis=0))
        drawn = np.einsum("ski,skj->kij", off, off) / len(SHARES)
        moments = np.stack([drawn[:, 0, 0] + 2.0, drawn[:, 0, 1], drawn[:, 1, 1] + 2.0], axis=1)
        moments += 0.1 * rng.standard_normal(moments.shape)
        found = Motion(np.empty(6), np.empty((6, 6)))
        assert motion_of(arms_of(pose, leds, moments), FOCAL, found)
        error = np.sign(found.numbers[:2] @ motion[:2]) * found.numbers - motion
        squared.append(error @ np.linalg.solve(found.covariance, error))
    assert np.median(squared) < 12.0


def test_the_mean_of_a_streaks_light_is_where_it_says(rng: np.random.Generator) -> None:
    leds = make_rig(1, seed=3).robots[0].leds_plane
    for _ in range(10):
        pose, motion = facing_pose(rng, (0.8, 1.4), (0.0, 50.0)), motion_drawn(rng)
        rays, light = tracks_of(pose, leds, motion)
        points = pose.map(leds)
        true = (rays * light[:, :, None]).sum(axis=0) / light.sum(axis=0)[:, None] - points[:, :2] / points[:, 2:]
        off = np.empty((6, 2))
        light_off(arms_of(pose, leds, np.zeros((6, 3))), Motion(motion, np.zeros((6, 6))), off)
        np.testing.assert_allclose(FOCAL * off, FOCAL * true, atol=0.004)
        assert np.abs(FOCAL * true).max() < 1.0


@pytest.mark.parametrize("turn", [0.0, 0.12])
def test_poses_of_streaks_are_meant(rng: np.random.Generator, turn: float) -> None:
    rig = make_rig(4, seed=1)
    squared = []
    for _ in range(2):
        poses = poses_apart(rig, rng, depth_m=(1.0, 1.4), tilt_deg=(15.0, 40.0))
        motions = {
            name: np.concatenate([[4e-3, -2e-3, 0.0], turn * pose.rotation[:, 2]]) for name, pose in poses.items()
        }
        canvas = draw(rig, poses)
        shares = (np.arange(7) + 0.5) / 7 - 0.5
        canvas.light = np.mean(
            [draw(rig, {name: moved(pose, motions[name], s) for name, pose in poses.items()}).light for s in shares],
            axis=0,
        )
        for name, answer in alone(canvas.expose(rng), rig).answers.items():
            assert isinstance(answer, PoseEstimate)
            error = answer.position - poses[name].position
            squared.append(error @ np.linalg.solve(answer.covariance[:3, :3], error))
    assert np.mean(squared) < 6.0
