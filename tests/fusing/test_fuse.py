"""Laws of fusing: what is true of any cameras and robots."""

import numpy as np
import pytest

from asterism.protocol.geometry import Floats, Pose, log_rotation
from asterism.server.fusing.fleet import Fleet, View
from asterism.server.fusing.fuse import fuse
from asterism.server.fusing.fused import FusedPose
from asterism.server.fusing.memory import Joint, Pace
from asterism.server.pose.place import moved
from tests.fusing.drawn import Seen, moved_world, sighting
from tests.helpers import assert_poses_close, random_pose
from tests.several import Drive, facing_pair, looking_at, rigs_at

NOW = 1_000_000_000
ROBOTS = ("r00", "r01")
drive = Drive(ROBOTS)


def off(answer: object, truth: Pose) -> tuple[Floats, float]:
    """Error (6,) of a pose, m and rad, and its square weighted by the covariance."""
    assert isinstance(answer, FusedPose)
    turn = log_rotation(answer.pose.rotation @ truth.rotation.T)
    error = np.concatenate([answer.pose.position - truth.position, turn])
    return error, float(error @ np.linalg.solve(answer.covariance, error))


@pytest.fixture
def fleet() -> Fleet:
    return Fleet.of([View(rig) for rig in rigs_at(facing_pair())])


def test_one_camera_alone_passes_through(fleet: Fleet, rng: np.random.Generator) -> None:
    seen = sighting(fleet.views["left"], drive(0.0), NOW, rng)
    fused, _ = fuse([seen], fleet, Joint.none())
    assert fused.cameras == ("left",)
    for robot in ROBOTS:
        answer, told = fused.answers[robot], seen.told[robot]
        assert isinstance(answer, FusedPose)
        assert answer.cameras == ("left",)
        assert answer.pose.position.tolist() == [told.pose.position.x, told.pose.position.y, told.pose.position.z]
        assert answer.covariance.ravel().tolist() == list(told.covariance)


def test_covariances_hold_against_drawn_noise(fleet: Fleet, rng: np.random.Generator) -> None:
    nees = []
    for k in range(100):
        poses = drive(0.3 * k)
        fused, _ = fuse([sighting(view, poses, NOW, rng) for view in fleet.views.values()], fleet, Joint.none())
        nees += [off(fused.answers[robot], poses[robot])[1] for robot in ROBOTS]
    # The mean of 200 chi squareds of six degrees of freedom, 6 with a standard deviation of 0.25.
    assert 5.2 < np.mean(nees) < 6.8


def test_the_order_of_cameras_does_not_matter(fleet: Fleet, rng: np.random.Generator) -> None:
    seen = [sighting(view, drive(0.0), NOW, rng) for view in fleet.views.values()]
    one, other = (fuse(order, fleet, Joint.none())[0] for order in (seen, seen[::-1]))
    for robot in ROBOTS:
        a, b = one.answers[robot], other.answers[robot]
        assert isinstance(a, FusedPose)
        assert isinstance(b, FusedPose)
        assert a.pose.position.tolist() == b.pose.position.tolist()
        assert a.covariance.tolist() == b.covariance.tolist()


def test_moving_the_world_moves_the_poses(fleet: Fleet, rng: np.random.Generator) -> None:
    T = random_pose(rng)
    there = Fleet.of([moved_world(view, T) for view in fleet.views.values()])
    poses, seed = drive(0.0), int(rng.integers(1 << 30))
    answers = []
    for where, world in ((fleet, Pose.identity()), (there, T)):
        again = np.random.default_rng(seed)
        moved = {robot: world @ pose for robot, pose in poses.items()}
        seen = [sighting(view, moved, NOW, again) for view in where.views.values()]
        answers.append(fuse(seen, where, Joint.none())[0].answers)
    both = np.kron(np.eye(2), T.rotation)
    for robot in ROBOTS:
        a, b = answers[0][robot], answers[1][robot]
        assert isinstance(a, FusedPose)
        assert isinstance(b, FusedPose)
        assert_poses_close(T @ a.pose, b.pose, 1e-9, 1e-8)
        np.testing.assert_allclose(both @ a.covariance @ both.T, b.covariance, rtol=1e-4, atol=1e-13)


def test_two_cameras_see_depth_that_neither_sees_alone(fleet: Fleet, rng: np.random.Generator) -> None:
    fused, _ = fuse([sighting(view, drive(0.0), NOW, rng) for view in fleet.views.values()], fleet, Joint.none())
    for robot in ROBOTS:
        answer = fused.answers[robot]
        assert isinstance(answer, FusedPose)
        assert answer.cameras == ("left", "right")
        assert answer.leds == 6
        along = fleet.views["left"].T_world_camera.rotation[:, 2]
        assert along @ answer.covariance[:3, :3] @ along < (0.03e-3) ** 2


def test_a_robot_in_view_of_no_camera_is_lost(fleet: Fleet, rng: np.random.Generator) -> None:
    some = {"r00": drive(0.0)["r00"]}
    fused, _ = fuse([sighting(view, some, NOW, rng) for view in fleet.views.values()], fleet, Joint.none())
    assert fused.answers["r01"].state == "LOST"
    assert fused.answers["r00"].state == "TRACKED"


def test_three_leds_in_one_camera_and_three_in_another_are_a_pose(fleet: Fleet, rng: np.random.Generator) -> None:
    lit = {"left": {"r00": (0, 1, 2)}, "right": {"r00": (3, 4, 5)}}
    poses = drive(0.0)
    seen = [sighting(view, poses, NOW, rng, Seen(lit=lit[name])) for name, view in fleet.views.items()]
    error, nees = off(fuse(seen, fleet, Joint.none())[0].answers["r00"], poses["r00"])
    assert np.linalg.norm(error[:3]) < 2e-4
    assert nees < 30.0


def test_what_is_not_known_of_places_is_in_the_covariance(rng: np.random.Generator) -> None:
    place = np.diag([0.3e-3] * 3 + [np.radians(0.02)] * 3) ** 2
    rigs = rigs_at([looking_at(np.array([x, 0.0, 1.2]), np.zeros(3)) for x in (-0.6, 0.1, 0.7)])
    fleet, nees = Fleet.of([View(rig, place) for rig in rigs]), []
    for k in range(60):
        poses, seen = drive(k), []
        for view in fleet.views.values():
            move = np.sqrt(np.diag(place)) * rng.normal(size=6)
            T = view.T_world_camera
            seen.append(sighting(view, poses, NOW, rng, Seen(moved(T, move))))
        fused, _ = fuse(seen, fleet, Joint.none())
        nees += [off(fused.answers[robot], poses[robot])[1] for robot in ROBOTS]
    assert 5.0 < np.mean(nees) < 7.0


def test_frames_that_are_lost_do_not_make_old_rays_count(fleet: Fleet, rng: np.random.Generator) -> None:
    period, poses = 16_666_667, drive(0.0)
    lost = [0, 1, 2, 10, 22, 23, 33, 41, 52, 53]  # of which frames there are
    pace = Pace(sighting(fleet.views["left"], poses, NOW, rng))
    for k in lost[1:]:
        pace = pace.followed_by(sighting(fleet.views["left"], poses, NOW + k * period, rng))
    newest = NOW + lost[-1] * period
    assert pace.counts_at(newest + period)
    assert not pace.counts_at(newest + 2 * period)
