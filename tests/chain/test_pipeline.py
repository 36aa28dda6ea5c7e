"""The whole chain: laws, known truth, honest covariance, states."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Pose, angle_between, log_rotation
from asterism.protocol.messages import Fate
from asterism.protocol.rig import Rig, load_rig
from asterism.server import Frame, FrameResult, Lost, PoseEstimate, Tracks, localize
from asterism.server.chain.answers import SURE
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.simulation.simulate import Look, Scene, Truth
from tests.rigs import make_camera, make_rig

RIG = load_rig(DEMO_RIG)


def once(image: NDArray[np.uint8], rig: Rig = RIG) -> FrameResult:
    return localize(Frame(image, 1, 0), rig, Tracks.none())[0]


def in_parent(rig: Rig, truth: Truth) -> Pose:
    return truth.T_camera_robot if rig.T_world_camera is None else rig.T_world_camera @ truth.T_camera_robot


def errors(rig: Rig, truth: list[Truth], result: FrameResult) -> list[tuple[str, float, float, float]]:
    """Robot, distance m, angle rad and covariance-weighted squared error of every located robot."""
    found = []
    for entry in truth:
        answer = result.answers[entry.robot]
        if isinstance(answer, PoseEstimate):
            T = in_parent(rig, entry)
            off = answer.position - T.position
            turn = log_rotation(answer.pose.rotation @ T.rotation.T)
            both = np.concatenate([off, turn])
            found.append(
                (
                    entry.robot,
                    float(np.linalg.norm(off)),
                    float(np.linalg.norm(turn)),
                    float(both @ np.linalg.solve(answer.covariance, both)),
                )
            )
    return found


def test_poses_are_right_and_their_covariance_is_meant() -> None:
    scene, tracks, squares = Scene(RIG, 2), Tracks.none(), []
    for index in range(80):
        truth = scene.truth(index, index / 20)
        result, tracks = localize(Frame(scene.render(index, truth), 1 + index * 50_000_000, index), RIG, tracks)
        found = errors(RIG, truth, result)
        assert len(found) == 5
        for robot, away, turned, square in found:
            assert away < 0.0015, robot
            assert turned < np.radians(1.0), robot
            squares.append(square)
    assert 4.5 < np.mean(squares) < 7.8


def test_the_same_arguments_give_the_same_results_and_are_left_alone() -> None:
    scene = Scene(RIG, 3)
    image = scene.render(0, scene.truth(0, 0.0))
    _, tracks = localize(Frame(image, 1, 0), RIG, Tracks.none())
    before, kept = image.copy(), tracks.copy_for(5)
    following = scene.render(1, scene.truth(1, 1 / 60))
    first, after = localize(Frame(following, 16_666_668, 1), RIG, tracks)
    second, again = localize(Frame(following, 16_666_668, 1), RIG, tracks)
    np.testing.assert_array_equal(image, before)
    for name in ("seen_ns", "rotations", "ts", "velocities", "turns", "other_rotations", "numbers"):
        np.testing.assert_array_equal(getattr(tracks, name), getattr(kept, name))
        np.testing.assert_array_equal(getattr(after, name), getattr(again, name))
    for robot, answer in first.answers.items():
        other = second.answers[robot]
        assert isinstance(answer, PoseEstimate)
        assert isinstance(other, PoseEstimate)
        assert (answer.position.tobytes(), answer.covariance.tobytes()) == (
            other.position.tobytes(),
            other.covariance.tobytes(),
        )


def test_one_or_two_hidden_leds() -> None:
    scene, tracks = Scene(RIG, 6, Look(hidden=0.08, glints=6)), Tracks.none()
    five_or_six = found = 0
    for index in range(60):
        truth = scene.truth(index, index / 60)
        result, tracks = localize(Frame(scene.render(index, truth), 1 + index * 16_666_667, index), RIG, tracks)
        for robot, away, turned, _ in errors(RIG, truth, result):
            assert away < 0.02, (index, robot)
            answer = result.answers[robot]
            assert isinstance(answer, PoseEstimate)
            assert turned < np.radians(5) or answer.alternative is not None, (index, robot)
        for entry in truth:
            if sum(entry.lit) >= 5:
                five_or_six += 1
                found += isinstance(result.answers[entry.robot], PoseEstimate)
    assert found >= 0.98 * five_or_six


def test_a_robot_without_light_is_lost_at_once_and_back_at_once() -> None:
    scene, tracks = Scene(RIG, 7), Tracks.none()
    states = []
    for index in range(12):
        truth = scene.truth(index, index / 60)
        if 4 <= index < 8:
            truth[2] = Truth(truth[2].robot, truth[2].T_camera_robot, (False,) * 6)
        result, tracks = localize(Frame(scene.render(index, truth), 1 + index * 16_666_667, index), RIG, tracks)
        states.append(result.answers[truth[2].robot].state)
        assert all(
            isinstance(answer, PoseEstimate) for robot, answer in result.answers.items() if robot != truth[2].robot
        )
    assert states == ["TRACKED"] * 4 + ["LOST"] * 4 + ["TRACKED"] * 4


def test_an_empty_frame_says_why_everybody_is_lost() -> None:
    result = once(np.full((1024, 1280), 10, np.uint8))
    assert set(result.answers.values()) == {Lost("none of its LEDs is visible")}
    assert len(result.blobs) == 0


def test_both_tilts_are_told_where_the_spots_leave_it_open() -> None:
    # Far away, a slightly tilted plate: both poses explain the spots, and one of them is right.
    rig = make_rig(3, seed=2, camera=make_camera(focal_px=1000.0), range_m=(2.2, 3.0))
    scene = Scene(rig, 1, Look(read_noise=4.0))
    told = 0
    for index in range(10):
        truth = scene.truth(index, float(index))
        result = once(scene.render(index, truth), rig)
        for entry in truth:
            answer = result.answers[entry.robot]
            assert isinstance(answer, PoseEstimate)
            right = angle_between(answer.pose.rotation, entry.T_camera_robot.rotation)
            if answer.alternative is None:
                assert right < np.radians(6)
            else:
                told += 1
                assert answer.state == "TILT_AMBIGUOUS"
                assert 1.0 <= answer.alternative.odds < SURE
                other = angle_between(answer.alternative.pose.rotation, entry.T_camera_robot.rotation)
                assert min(right, other) < np.radians(8)
    assert told > 0


def test_every_spot_has_its_fate() -> None:
    scene = Scene(RIG, 8, Look(glints=10))
    truth = scene.truth(0, 0.0)
    result = once(scene.render(0, truth))
    blobs = result.blobs
    claimed = blobs.fates == Fate.LED
    assert claimed.sum() == 30
    assert (blobs.robots[claimed] >= 0).all()
    assert (blobs.robots[~claimed] == -1).all()
    for index, robot in enumerate(RIG.robots):
        answer = result.answers[robot.id]
        assert isinstance(answer, PoseEstimate)
        assert blobs.leds[list(answer.spots)].tolist() == list(answer.leds)
        assert (blobs.robots[list(answer.spots)] == index).all()
        pixels = RIG.camera.project(truth[index].T_camera_robot.map(robot.leds))
        np.testing.assert_allclose(blobs.centres_px[list(answer.spots)], pixels[list(answer.leds)], atol=0.15)
        assert answer.rms_px == pytest.approx(np.sqrt((answer.residuals_px**2).sum(axis=1).mean()))


def test_masked_robots_are_not_seen() -> None:
    scene = Scene(RIG, 9)
    truth = scene.truth(0, 0.0)
    x, y = RIG.camera.project(truth[0].T_camera_robot.position[None])[0]
    mask = (max(int(x) - 90, 0), max(int(y) - 90, 0), int(x) + 90, int(y) + 90)
    result = once(scene.render(0, truth), replace(RIG, masks=(mask,)))
    assert isinstance(result.answers[truth[0].robot], Lost)
    assert isinstance(result.answers[truth[1].robot], PoseEstimate)


def test_the_grey_square_estimator_serves_the_whole_chain() -> None:
    scene = Scene(RIG, 10)
    truth = scene.truth(0, 0.0)
    found = errors(RIG, truth, once(scene.render(0, truth), replace(RIG, centre="grey-square")))
    assert len(found) == 5
    assert all(away < 0.003 for _, away, _, _ in found)


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (np.zeros((480, 640), np.uint8), "frame 0: the image is 640x480, expected 1280x1024"),
        (
            np.zeros((1024, 1280, 3), np.uint8),
            r"the image is uint8 of shape \(1024, 1280, 3\), expected uint8 of shape",
        ),
        (np.zeros((1024, 1280), np.float32), "the image is float32 of shape"),
    ],
)
def test_wrong_images_are_refused(image: NDArray[np.uint8], words: str) -> None:
    with pytest.raises(InputError, match=words):
        once(image)
