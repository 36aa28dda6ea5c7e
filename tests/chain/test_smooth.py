"""Smoothing: nearer the truth, as sure as it says, labelled, never across a gap, and not there unless asked for."""

import numpy as np
import pytest

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import decode_odometry, encode_odometry
from asterism.protocol.geometry import Floats, Pose, angle_between, exp_rotation, log_rotation
from asterism.protocol.messages import Velocity
from asterism.protocol.rig import load_rig
from asterism.server import Frame, FrameResult, PoseEstimate, Tracks, localize
from asterism.server.chain.report import frame_report, report
from asterism.server.chain.smooth import FILTER, Motion, Motions, estimates, follow, smooth
from asterism.server.command.locate import line
from asterism.server.pose.solve import Lost
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.simulation.simulate import Look, Scene
from tests.chain.drives import covariances_of, drawn, drives
from tests.chain.judging_motion import forwards, pose_errors, seen_of, twist_errors, weighted
from tests.helpers import random_rotation

STEP_NS = 16_666_667
SIGMAS = np.array([5e-6, 5e-6, 5e-5, 1.4e-3, 1.4e-3, 2e-4])  # m and rad, of a robot 1.3 m away
NOISE = np.diag(SIGMAS**2)
NONE = np.zeros((6, 6))
ALL = (0, 1, 2, 3, 4, 5)
SETTLED = 30
Told = tuple[Pose, Floats, Velocity]


def followed(
    motion: Motion | None, exposed_ns: int, pose: Pose, stays: Floats = NONE, leds: tuple[int, ...] = ALL
) -> tuple[Motion, Told]:
    """One robot, one frame further."""
    seen = seen_of(pose.position[None], pose.rotation[None], NOISE[None], stays[None], (leds,))
    belief, _ = follow([motion], exposed_ns, seen)
    return Motion(exposed_ns, leds, *(part[0] for part in belief)), estimates(belief, seen.stays)[0]


def measured(rng: np.random.Generator, true: Pose) -> Pose:
    error = np.linalg.cholesky(NOISE) @ rng.standard_normal(6)
    return Pose.from_matrix(exp_rotation(error[3:]) @ true.rotation, true.position + error[:3])


def standing(rng: np.random.Generator, frames: int) -> tuple[Motion | None, Told, Pose]:
    """What is believed of a robot that stands, and where."""
    true = Pose.from_matrix(random_rotation(rng), np.array([0.1, 0.0, 1.3]))
    motion = None
    for k in range(frames):
        motion, told = followed(motion, 1 + k * STEP_NS, measured(rng, true))
    return motion, told, true


def test_poses_and_velocities_of_drives_are_nearer_the_truth_and_as_sure_as_they_say(rng: np.random.Generator) -> None:
    told = drives(rng, 24, 5.0, 60.0)
    covariances = covariances_of(told.positions, told.rotations, 0.02)
    positions, rotations = drawn(rng, told.positions, told.rotations, covariances)
    found = forwards(told, positions, rotations, covariances)
    raw = pose_errors(told, positions, rotations)[SETTLED:]
    off, moves = (errors[SETTLED:] for errors in (found.poses, found.twists))
    ratios = np.sqrt(np.mean(off**2, axis=(0, 1)) / np.mean(raw**2, axis=(0, 1)))
    assert (ratios < [0.9, 0.9, 0.6, 0.6, 0.6, 0.95]).all(), ratios
    # Against differences of poses, which know as much where a robot starts and far less where it goes on.
    turned = twist_errors(told, positions, rotations)[SETTLED - 1 :]
    assert (np.sqrt(np.mean(moves**2, axis=(0, 1)) / np.mean(turned**2, axis=(0, 1))) < 0.7).all()
    # Errors of successive frames are alike, and most of a twist's come with the few starts and stops there are.
    assert 4.8 < np.mean(weighted(off, found.pose_covariances[SETTLED:])) < 6.6
    assert 3.5 < np.mean(weighted(moves, found.twist_covariances[SETTLED:])) < 9.0
    assert (np.linalg.eigvalsh(found.twist_covariances) > 0.0).all()


def test_a_circle_has_no_lag(rng: np.random.Generator) -> None:
    """Velocity and turn stay the same in the robot's own axes, though not in the parent's."""
    speed, turn = np.array([0.2, 0.0, 0.0]), np.array([0.0, 0.0, 1.5])
    motion = None
    for k in range(240):
        angle = turn[2] * k * STEP_NS * 1e-9
        place = speed[0] / turn[2] * np.array([np.sin(angle), 1.0 - np.cos(angle), 0.0])
        true = Pose.from_matrix(exp_rotation(np.array([0.0, 0.0, angle])), place)
        motion, (_, _, velocity) = followed(motion, 1 + k * STEP_NS, true)
    np.testing.assert_allclose(velocity.linear, speed, atol=5e-5)
    np.testing.assert_allclose(velocity.angular, turn, atol=2e-4)


def test_what_stays_is_kept_in_the_covariance(rng: np.random.Generator) -> None:
    """Robots that stand, each with an error that is the same in every frame."""
    n, stays = 60, 4.0 * NOISE
    half, turn = np.linalg.cholesky(stays), np.array([random_rotation(rng) for _ in range(n)])
    same = (half @ rng.standard_normal((6, n))).T
    motions: list[Motion | None] = [None] * n
    for k in range(40):
        errors = same + (np.linalg.cholesky(NOISE) @ rng.standard_normal((6, n))).T
        rotations = np.array([exp_rotation(e[3:]) @ R for e, R in zip(errors, turn, strict=True)])
        seen = seen_of(errors[:, :3], rotations, np.tile(NOISE, (n, 1, 1)), np.tile(stays, (n, 1, 1)), [ALL] * n)
        belief, _ = follow(motions, 1 + k * STEP_NS, seen)
        motions = [Motion(1 + k * STEP_NS, ALL, *(part[i] for part in belief)) for i in range(n)]
    nees = []
    for (pose, covariance, _), true in zip(estimates(belief, seen.stays), turn, strict=True):
        error = np.concatenate([pose.position, log_rotation(pose.rotation @ true.T)])
        nees.append(error @ np.linalg.solve(covariance, error))
        assert np.trace(covariance) < 0.5 * 4.0 * np.trace(stays + NOISE)
    assert 4.5 < np.mean(nees) < 7.5


def test_other_leds_move_the_pose_but_are_no_motion(rng: np.random.Generator) -> None:
    stays = 100.0 * NOISE
    motion, _, true = standing(rng, 60)
    there = Pose.from_matrix(exp_rotation(np.array([0.012, 0.0, 0.0])) @ true.rotation, true.position)
    _, (_, _, kicked) = followed(motion, 1 + 60 * STEP_NS, there, stays)
    _, (pose, _, velocity) = followed(motion, 1 + 60 * STEP_NS, there, stays, ALL[:5])
    assert angle_between(pose.rotation, there.rotation) < 0.3 * 0.012
    assert np.linalg.norm(velocity.angular) < 0.2 * np.linalg.norm(kicked.angular)


def test_a_gap_is_not_bridged_and_makes_the_filter_less_sure(rng: np.random.Generator) -> None:
    motion, (_, covariance, _), true = standing(rng, 60)
    settled = np.trace(covariance[3:, 3:])
    _, (_, soon, _) = followed(motion, 1 + 60 * STEP_NS, measured(rng, true))
    _, (_, late, _) = followed(motion, 1 + 90 * STEP_NS, measured(rng, true))
    assert np.trace(soon[3:, 3:]) < 1.3 * settled
    assert np.trace(late[3:, 3:]) > 1.2 * settled
    # After a second out of sight, or when time runs backwards, a pose is what was measured.
    for now_ns in (1 + 130 * STEP_NS, 1 + 20 * STEP_NS):
        seen = measured(rng, true)
        _, (pose, spread, _) = followed(motion, now_ns, seen)
        np.testing.assert_allclose(pose.position, seen.position, atol=1e-15)
        assert angle_between(pose.rotation, seen.rotation) < 1e-12
        np.testing.assert_allclose(spread, NOISE, atol=1e-18)


def test_a_jump_and_the_other_tilt_are_not_dragged(rng: np.random.Generator) -> None:
    motion, _, here = standing(rng, 30)
    for there in (
        Pose.from_matrix(exp_rotation(np.array([0.4, 0.0, 0.0])) @ here.rotation, here.position),
        Pose(here.position + np.array([0.2, 0.0, 0.0]), here.orientation),
    ):
        _, (pose, _, _) = followed(motion, 1 + 30 * STEP_NS, there)
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
        told, after = smooth(result, motions, RIG)
        # The memory handed in is unchanged, and so are the frame's own poses.
        assert smooth(result, motions, RIG)[0].answers[first].state == told.answers[first].state
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
        told, motions = smooth(result, motions, RIG)
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
            smoothed, motions = smooth(result, motions, RIG)
            payloads += [message.payload for message in report(frame, smoothed, RIG, 2)]
        told.append(payloads)
    assert told[0] == told[1]
