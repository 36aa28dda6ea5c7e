"""Smoothing: nearer the truth, as sure as it says, labelled, never across a gap, and not there unless asked for."""

import numpy as np
import pytest

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import decode_odometry, encode_odometry
from asterism.protocol.geometry import Floats, Pose, angle_between, exp_rotation, log_rotation
from asterism.protocol.rig import load_rig
from asterism.server import Frame, FrameResult, PoseEstimate, Tracks, localize
from asterism.server.chain.report import frame_report, report
from asterism.server.chain.smooth import FILTER, Motion, Motions, estimate, follow, smooth, velocity
from asterism.server.command.locate import line
from asterism.server.pose.solve import Lost
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.simulation.simulate import Look, Scene
from tests.helpers import random_rotation

STEP_NS = 16_666_667
SIGMAS = np.array([5e-6, 5e-6, 5e-5, 1.4e-3, 1.4e-3, 2e-4])  # m and rad, of a robot 1.3 m away
SETTLED = 6


def path(speed: float, time_s: float, start: Floats) -> Pose:
    """A robot that winds its way: about ``speed`` m/s and eight times that in rad/s."""
    turn = speed * np.array([1.5 * np.sin(1.3 * time_s), np.cos(0.9 * time_s), 8.0 * np.sin(0.65 * time_s)])
    away = speed / 1.3 * np.array([np.sin(1.3 * time_s), np.cos(time_s), 0.3 * np.sin(0.8 * time_s)])
    return Pose.from_matrix(exp_rotation(turn) @ start, np.array([0.1, 0.0, 1.3]) + away)


def error_of(found: Pose, true: Pose) -> Floats:
    return np.concatenate([found.position - true.position, log_rotation(found.rotation @ true.rotation.T)])


def measured(rng: np.random.Generator, true: Pose, covariance: Floats) -> Pose:
    error = np.linalg.cholesky(covariance) @ rng.standard_normal(6)
    return Pose.from_matrix(exp_rotation(error[3:]) @ true.rotation, true.position + error[:3])


def film(rng: np.random.Generator, speed: float, frames: int = 240) -> tuple[Floats, Floats, Floats]:
    """Raw errors (n, 6), smoothed errors (n, 6) and NEES (n,) of the smoothed poses."""
    turn, start = np.linalg.qr(rng.standard_normal((6, 6)))[0], random_rotation(rng)
    half = SIGMAS[:, None] * turn * rng.uniform(0.3, 1.5, 6)
    covariance = half @ half.T
    motion: Motion | None = None
    raw, smoothed, nees = [], [], []
    for k in range(frames):
        true = path(speed, k * STEP_NS * 1e-9, start)
        seen = measured(rng, true, covariance)
        motion = follow(motion, 1 + k * STEP_NS, seen, covariance)
        pose, spread = estimate(motion)
        if k >= SETTLED:
            error = error_of(pose, true)
            raw.append(error_of(seen, true))
            smoothed.append(error)
            nees.append(error @ np.linalg.solve(spread, error))
    return np.array(raw), np.array(smoothed), np.array(nees)


@pytest.mark.parametrize(
    ("speed", "most_rotation", "most_position"), [(0.0, 0.45, 0.75), (0.01, 0.6, 0.9), (0.12, 0.8, 1.03)]
)
def test_smoothed_poses_are_nearer_the_truth_and_as_sure_as_they_say(
    rng: np.random.Generator, speed: float, most_rotation: float, most_position: float
) -> None:
    films = [film(rng, speed) for _ in range(5)]
    rms = [np.sqrt(np.mean(np.square(np.concatenate([part[k] for part in films])), axis=0)) for k in (0, 1)]
    ratios = rms[1] / rms[0]
    assert ratios[3:5].max() < most_rotation, ratios
    assert ratios[:3].mean() < most_position, ratios
    # Errors of successive smoothed poses are alike, so 1170 of them are worth some hundred.
    assert 4.2 < np.mean(np.concatenate([part[2] for part in films])) < 7.0


def test_a_gap_is_not_bridged_and_makes_the_filter_less_sure(rng: np.random.Generator) -> None:
    covariance, start = np.diag(SIGMAS**2), random_rotation(rng)
    motion: Motion | None = None
    for k in range(60):
        motion = follow(motion, 1 + k * STEP_NS, measured(rng, path(0.02, 0.0, start), covariance), covariance)
    settled = np.trace(estimate(motion)[1][3:, 3:])
    true = path(0.02, 0.0, start)
    soon = follow(motion, 1 + 60 * STEP_NS, measured(rng, true, covariance), covariance)
    late = follow(motion, 1 + 90 * STEP_NS, measured(rng, true, covariance), covariance)
    assert np.trace(estimate(soon)[1][3:, 3:]) < 1.3 * settled
    assert np.trace(estimate(late)[1][3:, 3:]) > 1.5 * settled
    # After a second out of sight, or when time runs backwards, a pose is what was measured.
    for now_ns in (1 + 130 * STEP_NS, 1 + 20 * STEP_NS):
        seen = measured(rng, true, covariance)
        pose, spread = estimate(follow(motion, now_ns, seen, covariance))
        np.testing.assert_allclose(pose.position, seen.position, atol=1e-15)
        assert angle_between(pose.rotation, seen.rotation) < 1e-12
        np.testing.assert_allclose(spread, covariance, atol=1e-18)


def test_a_jump_and_the_other_tilt_are_not_dragged(rng: np.random.Generator) -> None:
    covariance, start = np.diag(SIGMAS**2), random_rotation(rng)
    here = path(0.0, 0.0, start)
    motion: Motion | None = None
    for k in range(30):
        motion = follow(motion, 1 + k * STEP_NS, measured(rng, here, covariance), covariance)
    for there in (
        Pose.from_matrix(exp_rotation(np.array([0.4, 0.0, 0.0])) @ start, here.position),
        Pose(here.position + np.array([0.2, 0.0, 0.0]), here.orientation),
    ):
        pose, _ = estimate(follow(motion, 1 + 30 * STEP_NS, there, covariance))
        np.testing.assert_allclose(pose.position, there.position, atol=1e-15)
        assert angle_between(pose.rotation, there.rotation) < 1e-12


RIG = load_rig(DEMO_RIG)


@pytest.fixture(scope="module")
def demo_film() -> list[tuple[Frame, FrameResult]]:
    """A few located frames; the first robot is hidden in the fourth."""
    scene, tracks, located = Scene(RIG, 3, Look()), Tracks.none(), []
    for k in range(6):
        truth = scene.truth(k, k / 60)
        if k == 3:
            truth[0] = type(truth[0])(truth[0].robot, truth[0].T_camera_robot, (False,) * 6)
        frame = Frame(scene.render(k, truth), 1 + k * STEP_NS, k)
        result, tracks = localize(frame, RIG, tracks)
        located.append((frame, result))
    return located


def test_only_what_was_asked_to_be_smoothed_is_changed_and_it_is_labelled(
    demo_film: list[tuple[Frame, FrameResult]],
) -> None:
    motions = Motions.none()
    first = RIG.robots[0].id
    for frame, result in demo_film:
        before = [message.payload for message in report(frame, result, RIG, 2)]
        told, after = smooth(result, motions)
        # The memory handed in is unchanged, and so are the frame's own poses.
        assert smooth(result, motions)[0].answers[first].state == told.answers[first].state
        motions = after
        assert [message.payload for message in report(frame, result, RIG, 2)] == before
        assert all("smoothed" not in robot for robot in line(frame, result)["robots"])
        assert b"smoothed" not in before[0]
        messages, entries = list(report(frame, told, RIG, 2)), frame_report(frame, told, RIG, 2).robots
        for robot in line(frame, told)["robots"]:
            assert robot["smoothed"] is True
            assert robot["filter"] == FILTER
        for entry in entries:
            assert entry.smoothed_by == (FILTER if entry.state == pb.TRACKED else "")
        for message in messages[:-1]:
            pose = decode_odometry(message.payload)
            assert pose.smoothed_by == FILTER
            assert pose.velocity is not None
            assert decode_odometry(encode_odometry(pose)).smoothed_by == FILTER
        assert len(messages) == len(before)


def test_a_robot_without_a_pose_gets_none(demo_film: list[tuple[Frame, FrameResult]]) -> None:
    motions = Motions.none()
    first = RIG.robots[0].id
    states = []
    for _, result in demo_film:
        told, motions = smooth(result, motions)
        assert {robot: answer.state for robot, answer in told.answers.items()} == {
            robot: answer.state for robot, answer in result.answers.items()
        }
        states.append(isinstance(told.answers[first], PoseEstimate))
        if isinstance(result.answers[first], Lost):
            assert told.answers[first] is result.answers[first]
    assert states == [True, True, True, False, True, True]


def test_the_same_three_arguments_give_the_same_bytes(demo_film: list[tuple[Frame, FrameResult]]) -> None:
    told = []
    for _ in range(2):
        motions = Motions.none()
        payloads = []
        for frame, result in demo_film:
            smoothed, motions = smooth(result, motions)
            payloads += [message.payload for message in report(frame, smoothed, RIG, 2)]
        told.append(payloads)
    assert told[0] == told[1]


def test_velocities_are_in_the_robots_frame_and_as_sure_as_they_say(rng: np.random.Generator) -> None:
    weighted, speed = [], 0.05
    for _ in range(6):
        half = SIGMAS[:, None] * np.linalg.qr(rng.standard_normal((6, 6)))[0] * rng.uniform(0.3, 1.5, 6)
        covariance, start = half @ half.T, random_rotation(rng)
        motion: Motion | None = None
        for k in range(150):
            time_s = k * STEP_NS * 1e-9
            true = path(speed, time_s, start)
            motion = follow(motion, 1 + k * STEP_NS, measured(rng, true, covariance), covariance)
            if k < 60:
                continue
            told = velocity(motion)
            after, before = path(speed, time_s + 1e-4, start), path(speed, time_s - 1e-4, start)
            linear = true.rotation.T @ (after.position - before.position) / 2e-4
            angular = true.rotation.T @ log_rotation(after.rotation @ before.rotation.T) / 2e-4
            error = np.concatenate([told.linear - linear, told.angular - angular])
            weighted.append(error @ np.linalg.solve(told.covariance, error))
            assert (np.linalg.eigvalsh(told.covariance) > 0.0).all()
    # Accelerations that come in bursts are less likely in the filter's mind than on this path.
    assert 2.0 < np.mean(weighted) < 12.0
