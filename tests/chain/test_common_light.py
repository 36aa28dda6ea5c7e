"""Light to one side of all LEDs of a robot moves their centres together: the covariance of its pose knows."""

import numpy as np
import pytest

from asterism.protocol.geometry import Floats, Pose, log_rotation
from asterism.protocol.rig import Rig, load_rig
from asterism.server import PoseEstimate
from asterism.server.chain import pipeline
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.centres.rendering import Canvas
from tests.chain.frames import alone, draw, estimates, poses_apart

RIG = load_rig(DEMO_RIG)
FRAMES = 3
PEAK, OFF, SIGMA = 0.04, 0.8, 1.0  # of an LED's light; in its radii


def spill(canvas: Canvas, rig: Rig, poses: dict[str, Pose]) -> None:
    """Add what every LED throws on its plate: a dim glow on the side that the plate's normal points away from."""
    y, x = np.mgrid[: canvas.light.shape[0], : canvas.light.shape[1]]
    for name, pose in poses.items():
        robot = rig.robot(name)
        for led in pose.map(robot.leds):
            ends = rig.camera.project(np.array([led, led - 0.01 * pose.rotation @ robot.axis]))
            side = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
            radius = rig.camera.matrix[0, 0] * (robot.led_radius or 0.0025) / led[2]
            u, v = x - ends[0, 0] - OFF * radius * side[0], y - ends[0, 1] - OFF * radius * side[1]
            canvas.light += PEAK * 180.0 * np.exp(-0.5 * (u * u + v * v) / (SIGMA * radius) ** 2)


def told(rng: np.random.Generator, glows: bool) -> tuple[Floats, Floats]:
    """NEES (n,) of robots, and the determinants (n,) of their covariances."""
    nees, sizes = [], []
    for _ in range(FRAMES):
        poses = poses_apart(RIG, rng)
        canvas = draw(RIG, poses)
        if glows:
            spill(canvas, RIG, poses)
        for name, answer in estimates(alone(canvas.expose(rng), RIG)).items():
            nees.append(
                weighted(answer, poses[name] if RIG.T_world_camera is None else RIG.T_world_camera @ poses[name])
            )
            sizes.append(np.linalg.det(1e6 * answer.covariance))
    return np.array(nees), np.array(sizes)


def weighted(answer: PoseEstimate, true: Pose) -> float:
    """The squared error weighted by the covariance."""
    turned = log_rotation(answer.pose.rotation @ true.rotation.T)
    error = np.concatenate([answer.position - true.position, turned])
    return float(error @ np.linalg.solve(answer.covariance, error))


def test_a_glow_that_all_leds_have_to_one_side_is_owned_up_to(rng: np.random.Generator) -> None:
    nees, _ = told(rng, glows=True)
    assert len(nees) == FRAMES * len(RIG.robots)
    # Without the term it is 16; the other tilt, which an alternative tells, would spoil a mean.
    assert 1.0 < np.median(nees) < 12.0


def test_without_such_light_covariances_are_no_wider(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    with_term = told(np.random.default_rng(5), glows=False)[1]
    monkeypatch.setattr(pipeline, "add_common_shifts", lambda *_: None)
    without = told(np.random.default_rng(5), glows=False)[1]
    # Of a pose's six sigmas together, on average; and of most robots not at all.
    assert np.mean(np.log(with_term / without)) / 12 < np.log(1.1)
    assert np.median(with_term / without) == 1.0
