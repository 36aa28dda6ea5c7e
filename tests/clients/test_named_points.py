"""Named points and predicted poses: where they are, and that their covariances mean it."""

from dataclasses import replace

import numpy as np
import pytest

from asterism.clients import PoseClient
from asterism.clients.named_points import carried
from asterism.clients.prediction import predict
from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose, exp_rotation, log_rotation
from asterism.protocol.messages import RobotPose, Velocity
from tests.clients.serving import COVARIANCE, Server, until
from tests.helpers import random_rotation
from tests.protocol.make_golden import ROBOT_POSE, SMOOTHED_POSE


def spread_of(rng: np.random.Generator, sigmas: Floats) -> Floats:
    half = sigmas[:, None] * np.linalg.qr(rng.standard_normal((6, 6)))[0]
    return half @ half.T


def off(rng: np.random.Generator, true: Pose, covariance: Floats) -> Pose:
    error = np.linalg.cholesky(covariance) @ rng.standard_normal(6)
    return Pose.from_matrix(exp_rotation(error[3:]) @ true.rotation, true.position + error[:3])


def test_a_points_covariance_means_its_errors(rng: np.random.Generator) -> None:
    weighted = []
    for _ in range(2000):
        true = Pose.from_matrix(random_rotation(rng), rng.uniform(-1.0, 1.0, 3))
        covariance = spread_of(rng, np.array([1e-5, 1e-5, 1e-4, 2e-3, 2e-3, 3e-4]))
        lever = rng.uniform(-0.1, 0.1, 3)
        point = carried("tool", lever, off(rng, true, covariance), covariance)
        error = point.position - true.map(lever)
        weighted.append(error @ np.linalg.solve(point.covariance, error))
    assert np.mean(weighted) == pytest.approx(3.0, abs=0.25)


def moving(rng: np.random.Generator, white: tuple[float, float], ahead_s: float) -> tuple[RobotPose, Pose]:
    """A pose with velocity that is off as it says, and the true pose later, after white acceleration."""
    true = Pose.from_matrix(random_rotation(rng), rng.uniform(-1.0, 1.0, 3))
    covariance = spread_of(rng, np.array([1e-5, 1e-5, 5e-5, 1e-3, 1e-3, 3e-4]))
    velocity, rate = rng.uniform(-0.1, 0.1, 3), rng.uniform(-0.5, 0.5, 3)
    unsure = spread_of(rng, np.array([1e-3, 1e-3, 2e-3, 2e-2, 2e-2, 2e-2]))
    error = np.linalg.cholesky(unsure) @ rng.standard_normal(6)
    sigmas = np.sqrt(np.repeat(white, 3) * ahead_s**3 / 3.0) * rng.standard_normal(6)
    later = Pose.from_matrix(
        exp_rotation(rate * ahead_s + sigmas[3:]) @ true.rotation, true.position + velocity * ahead_s + sigmas[:3]
    )
    seen = off(rng, true, covariance)
    turn = seen.rotation.T
    both = np.kron(np.eye(2), turn)
    told = Velocity(turn @ (velocity + error[:3]), turn @ (rate + error[3:]), both @ unsure @ both.T, white)
    return replace(ROBOT_POSE, pose=seen, covariance=covariance, velocity=told), later


@pytest.mark.parametrize("ahead_s", [0.0, 0.02, 0.1])
def test_a_predicted_pose_is_where_the_robot_went_as_surely_as_it_says(
    rng: np.random.Generator, ahead_s: float
) -> None:
    weighted = []
    for _ in range(500):
        seen, later = moving(rng, (1e-3, 1e-1), ahead_s)
        found = predict(seen, ahead_s)
        error = np.r_[found.position - later.position, log_rotation(found.pose.rotation @ later.rotation.T)]
        weighted.append(error @ np.linalg.solve(found.covariance, error))
    # What acceleration may come is told four times larger, and pose and velocity are taken to be off together.
    assert 1.2 < np.mean(weighted) < 7.0


def test_covariance_grows_with_time() -> None:
    sizes = [np.linalg.eigvalsh(predict(SMOOTHED_POSE, ahead_s).covariance).min() for ahead_s in (0.0, 0.1, 1.0)]
    assert sizes == sorted(sizes)
    np.testing.assert_allclose(predict(SMOOTHED_POSE, 0.0).covariance, SMOOTHED_POSE.covariance)


def test_what_cannot_be_predicted_is_said() -> None:
    with pytest.raises(InputError, match=r"alpha: the pose has no velocity, expected one that the server smooths"):
        predict(ROBOT_POSE, 0.1)
    for ahead_s in (-1.0, float("inf"), float("nan")):
        with pytest.raises(InputError, match="ahead, expected 0 or more"):
            predict(SMOOTHED_POSE, ahead_s)


def test_a_client_tells_where_the_tool_is_and_where_the_robot_is_by_now(endpoint: str, server: Server) -> None:
    velocity = Velocity(np.array([1.0, 0.0, 0.0]), np.zeros(3), COVARIANCE, (0.0, 0.0))
    with PoseClient(endpoint) as robots:
        feed = robots["alpha"]
        until(lambda: server.tell(velocity=velocity) or feed.latest(10.0))
        pose = feed.latest(10.0)
        assert pose is not None
        np.testing.assert_allclose(pose.point("tool").position, pose.pose.map(np.array([0.0, 0.0, -0.03])))
        assert np.linalg.eigvalsh(pose.point("tool").covariance).min() > 0.0
        with pytest.raises(InputError, match=r"robot 'alpha' carries no point 'lamp'; points of its rig: tool"):
            pose.point("lamp")
        before_s = pose.age_s
        now = pose.predicted()
        assert before_s <= now.ahead_s <= pose.age_s
        np.testing.assert_allclose(now.position - pose.position, pose.pose.rotation[:, 0] * now.ahead_s, atol=1e-12)
        assert pose.predicted(ahead_s=0.5).ahead_s > 0.5


def test_a_robot_on_a_circle_is_predicted_on_it() -> None:
    radius, rate, ahead_s = 0.2, 2.0, 0.4
    velocity = Velocity(np.array([radius * rate, 0.0, 0.0]), np.array([0.0, 0.0, rate]), COVARIANCE, (0.0, 0.0))
    start = Pose.identity()
    found = predict(replace(SMOOTHED_POSE, pose=start, velocity=velocity), ahead_s)
    angle = rate * ahead_s
    np.testing.assert_allclose(found.position, radius * np.array([np.sin(angle), 1.0 - np.cos(angle), 0.0]), atol=1e-12)
    np.testing.assert_allclose(found.pose.rotation, exp_rotation(np.array([0.0, 0.0, angle])), atol=1e-12)
