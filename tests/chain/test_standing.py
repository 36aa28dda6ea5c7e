"""Robots on the rig's surface: what a frame says with it, what light alone says, and what is said where they differ."""

from dataclasses import replace

import numpy as np
import pytest

from asterism.protocol.geometry import Floats, Pose, exp_rotation, log_rotation
from asterism.protocol.rig import Rig
from asterism.server.chain.frame import Frame
from asterism.server.chain.pipeline import localize
from asterism.server.chain.smooth import Motions, smooth
from asterism.server.pose.solve import PoseEstimate
from asterism.server.pose.track import Tracks
from asterism.server.simulation.simulate import Look
from tests.on_surface import BENT, TOOL, frame_at, places, rig_on, stood


def poses_of(rig: Rig, rng: np.random.Generator, lift_m: float = 0.0) -> dict[str, Pose]:
    """Every robot somewhere on the surface, each off it as well as the rig knows it, and lifted by so much more."""
    poses = {}
    for robot, where in zip(rig.robots, places(rng, len(rig.robots)).tolist(), strict=True):
        upright = stood(BENT, *where, lift_m + rng.normal(0.0, 5e-5))
        poses[robot.id] = leaning(upright, rng.normal(0.0, np.radians(0.05), 2))
    return poses


def leaning(pose: Pose, tilts: Floats) -> Pose:
    """A pose turned about its tool, by tilts (2,) rad about its own x and y."""
    tool = Pose(TOOL, np.array([0.0, 0.0, 0.0, 1.0]))
    lean = Pose.from_matrix(exp_rotation(np.array([*tilts, 0.0])), np.zeros(3))
    return pose @ tool @ lean @ tool.inverse()


def answers(rig: Rig, frame: Frame, tracks: Tracks | None = None) -> dict[str, PoseEstimate]:
    """The poses of all robots of a frame."""
    result, _ = localize(frame, rig, tracks or Tracks.none())
    assert all(isinstance(answer, PoseEstimate) for answer in result.answers.values())
    return {robot: answer for robot, answer in result.answers.items() if isinstance(answer, PoseEstimate)}


def blind(rig: Rig) -> Rig:
    """The rig without its surface."""
    return replace(rig, surface=None, robots=tuple(replace(robot, stands=None) for robot in rig.robots))


def same(a: PoseEstimate, pose: Pose, covariance: Floats) -> bool:
    """Whether a pose and its covariance are those of an answer, to the bit."""
    told = (a.pose.position, pose.position), (a.pose.orientation, pose.orientation), (a.covariance, covariance)
    return all(np.array_equal(one, other) for one, other in told)


def test_the_surface_makes_poses_better_and_light_alone_is_told_beside(rng: np.random.Generator) -> None:
    rig, look = rig_on(distance_m=2.0), Look(brightness=35.0)
    z, alone, squares = [], [], []
    for index in range(6):
        poses = poses_of(rig, rng)
        frame = frame_at(rig, poses, index, look)
        without = answers(blind(rig), frame)
        for robot, answer in answers(rig, frame).items():
            surface, truth, light = answer.surface, poses[robot], without[robot]
            assert surface is not None
            assert surface.without is not None
            assert surface.without_covariance is not None
            assert (surface.standing, answer.state, surface.reason) == ("ON_SURFACE", "TRACKED", "")
            assert same(light, surface.without, surface.without_covariance)
            assert (light.alternative is None) == (surface.without_alternative is None)
            turn = log_rotation(answer.pose.rotation @ truth.rotation.T)
            off = np.concatenate([answer.position - truth.position, turn])
            squares.append(off @ np.linalg.solve(answer.covariance, off))
            z.append(off[2])
            alone.append(light.position[2] - truth.position[2])
    assert np.sqrt(np.mean(np.square(alone))) > 4.0 * np.sqrt(np.mean(np.square(z)))
    assert 4.0 < np.mean(squares) < 8.5  # six, and five sigma of so few


@pytest.mark.parametrize(("lift_m", "standing"), [(1.5e-3, "LIFTED"), (-1.5e-3, "SUNK")])
def test_who_is_off_the_surface_is_solved_without_it(lift_m: float, standing: str, rng: np.random.Generator) -> None:
    rig = rig_on()
    frame = frame_at(rig, poses_of(rig, rng, lift_m))
    without = answers(blind(rig), frame)
    for robot, answer in answers(rig, frame).items():
        surface = answer.surface
        assert surface is not None
        assert surface.standing == standing
        assert surface.without is None
        assert abs(surface.off_m - lift_m) < 5.0 * surface.off_sigma_m < abs(surface.off_m)
        assert "'tool'" in surface.reason
        assert "asterism calibrate surface" in surface.reason
        light = without[robot]
        assert same(answer, light.pose, light.covariance)


def test_a_tilted_robot_is_solved_without_it(rng: np.random.Generator) -> None:
    rig = rig_on()
    poses = {robot: leaning(pose, np.array([0.1, 0.0])) for robot, pose in poses_of(rig, rng).items()}
    for answer in answers(rig, frame_at(rig, poses)).values():
        assert answer.surface is not None
        assert answer.surface.standing == "TILTED"
        assert answer.surface.tilt_off_rad == pytest.approx(0.1, abs=5 * answer.surface.tilt_off_sigma_rad)


def test_beyond_its_edge_there_is_no_surface(rng: np.random.Generator) -> None:
    edge = np.array([[-0.01, -0.01], [0.01, -0.01], [0.0, 0.01]])
    rig = rig_on(replace(BENT, edge=edge))
    found = answers(rig, frame_at(rig, poses_of(rig, rng)))
    told = [answer.surface for answer in found.values()]
    assert all(surface is not None and surface.standing == "BEYOND" and surface.reason for surface in told)


def test_frames_before_tell_of_a_surface_that_is_wrong_by_little(rng: np.random.Generator) -> None:
    rig, look, tracks = rig_on(robots=2, distance_m=2.0), Look(brightness=60.0), Tracks.none()
    poses = poses_of(rig, rng, 2.5e-3)
    seen = []
    for index in range(12):
        result, tracks = localize(frame_at(rig, poses, index, look), rig, tracks)
        for robot, answer in result.answers.items():
            assert isinstance(answer, PoseEstimate)
            assert answer.surface is not None
            seen.append((index, robot, answer.surface.standing))
    assert any(standing == "ON_SURFACE" for index, _, standing in seen if index < 2)
    assert all(standing == "LIFTED" for index, _, standing in seen if index == 11)


def test_a_rolling_shutter_sees_the_same_surface(rng: np.random.Generator) -> None:
    rig = rig_on()
    rig = replace(rig, capture=replace(rig.capture, line_time_us=10.0))
    poses, tracks = poses_of(rig, rng), Tracks.none()
    for index in range(4):
        result, tracks = localize(frame_at(rig, poses, index), rig, tracks)
    for robot, answer in result.answers.items():
        assert isinstance(answer, PoseEstimate)
        assert answer.surface is not None
        assert answer.surface.standing == "ON_SURFACE"
        off = answer.position - poses[robot].position
        assert off @ np.linalg.solve(answer.covariance[:3, :3], off) < 30.0
        assert answer.surface.without_covariance is not None
        assert answer.covariance[2, 2] < 0.5 * answer.surface.without_covariance[2, 2]


def test_smoothing_leaves_the_surface_its_error(rng: np.random.Generator) -> None:
    rig, tracks, motions = rig_on(robots=2), Tracks.none(), Motions.none()
    poses = poses_of(rig, rng)
    for index in range(15):
        result, tracks = localize(frame_at(rig, poses, index), rig, tracks)
        result, motions = smooth(result, motions, rig)
    for robot, answer in result.answers.items():
        assert isinstance(answer, PoseEstimate)
        assert answer.surface is not None
        assert answer.surface.standing == "ON_SURFACE"
        # The surface is known to 0.05 mm, and light to some 0.13: no number of frames makes that 0.03.
        assert answer.covariance[2, 2] > 3e-5**2, robot
