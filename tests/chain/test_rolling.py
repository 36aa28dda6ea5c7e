"""A rolling shutter: moving robots have the poses that a global shutter would have given them."""

from dataclasses import replace

import numpy as np
import pytest

from asterism.protocol.capture import Capture
from asterism.protocol.rig import Rig
from asterism.server import Frame, PoseEstimate, Tracks, localize
from asterism.server.simulation.simulate import Scene
from tests.chain.moving import KINDS, Told, followed, motions
from tests.rigs import make_rig

SETTLED = 3  # frames, after which velocities are known
GLOBAL, ROLLING = Capture(), Capture(line_time_us=20.0)


def sequences(kind: str, capture: Capture, count: int = 3, frames: int = 8, told: bool = True) -> list[Told]:
    found = []
    for seed in range(count):
        rig = replace(make_rig(4, seed), capture=capture)
        found += followed(rig, motions(rig, kind, np.random.default_rng(seed), 0.4, 2.0), frames, seed, told)
    return found


def off(among: list[Told]) -> tuple[float, float]:
    """How far poses are off in the middle, m and rad: one whose motion is not told yet may be far off, and says so."""
    errors = np.array([told.error for told in among])
    away, turned = np.linalg.norm(errors[:, :3], axis=1), np.linalg.norm(errors[:, 3:], axis=1)
    return float(np.median(away)), float(np.median(turned))


@pytest.mark.parametrize("kind", ["straight", "driving"])
def test_a_moving_robot_followed_has_the_pose_of_a_global_shutter(kind: str) -> None:
    found = sequences(kind, ROLLING)
    assert all(isinstance(told.answer, PoseEstimate) for told in found), "one was lost"
    later = [told for told in found if told.index >= SETTLED]
    still = [told for told in sequences(kind, GLOBAL) if told.index >= SETTLED]
    (away, turned), (least_away, least_turned) = off(later), off(still)
    assert away < 1.4 * least_away
    assert turned < 1.6 * least_turned
    assert 3.5 < np.mean([told.nees for told in later]) < 8.0


def test_poses_are_honest_from_the_first_frame_on_and_where_robots_accelerate() -> None:
    found = sequences("swinging", ROLLING)
    assert all(isinstance(told.answer, PoseEstimate) for told in found), "one was lost"
    for index in range(8):
        nees = [told.nees for told in found if told.index == index]
        assert np.mean(nees) < 12.0, f"frame {index}"
    # A robot that is seen first may move at any speed.
    first = [told.answer.covariance for told in found if told.index == 0 and isinstance(told.answer, PoseEstimate)]
    later = [told.answer.covariance for told in found if told.index == 7 and isinstance(told.answer, PoseEstimate)]
    assert np.median([np.trace(c[:3, :3]) for c in first]) > 20 * np.median([np.trace(c[:3, :3]) for c in later])


def test_without_the_line_time_poses_of_moving_robots_are_far_off() -> None:
    untold = [told for told in sequences("straight", ROLLING, count=1, told=False) if told.index >= SETTLED]
    told = [told for told in sequences("straight", ROLLING, count=1) if told.index >= SETTLED]
    assert off(untold)[0] > 5 * off(told)[0]


def test_the_line_time_changes_nothing_for_robots_that_stand_still(rng: np.random.Generator) -> None:
    rig = make_rig(3)
    moving = motions(rig, "straight", rng, 1e-9, 1e-9)
    rolling = followed(replace(rig, capture=ROLLING), moving, 5)
    for told, plain in zip(rolling, followed(rig, moving, 5), strict=True):
        assert isinstance(told.answer, PoseEstimate)
        assert isinstance(plain.answer, PoseEstimate)
        if told.index >= SETTLED:
            sigma = np.sqrt(np.diag(told.answer.covariance)[:3])
            assert (np.abs(told.answer.position - plain.answer.position) < 3 * sigma).all()


def test_the_simulator_shows_each_led_at_its_own_rows_time() -> None:
    rig = replace(make_rig(2), capture=Capture(line_time_us=30.0))
    scene = Scene(rig, 1)
    truth = scene.truth(0, 0.5)
    result, _ = localize(Frame(scene.render(0, truth), 1, 0), replace(rig, capture=GLOBAL), Tracks.none())
    for k, entry in enumerate(truth):
        answer = result.answers[entry.robot]
        assert isinstance(answer, PoseEstimate)
        spots = result.blobs.centres_px[list(answer.spots)]
        for led, spot in zip(answer.leds, spots, strict=True):
            then = scene.pose(k, 0.5 + 30e-6 * (spot[1] - 511.5))
            assert np.abs(rig.camera.project(then.map(rig.robots[k].leds[led])) - spot).max() < 0.05


def test_same_arguments_same_results_and_tracks_stay_as_they_were(rng: np.random.Generator) -> None:
    rig: Rig = replace(make_rig(2), capture=ROLLING)
    scene = Scene(rig, 2)
    images = [scene.render(index, scene.truth(index, index / 60)) for index in range(3)]
    tracks = Tracks.none()
    for index in range(2):
        _, tracks = localize(Frame(images[index], 1 + index * 16_666_667, index), rig, tracks)
    before = [column.copy() for column in tracks.courses]
    twice = [localize(Frame(images[2], 40_000_000, 2), rig, tracks)[0] for _ in range(2)]
    for robot in rig.robots:
        first, second = (result.answers[robot.id] for result in twice)
        assert isinstance(first, PoseEstimate)
        assert isinstance(second, PoseEstimate)
        assert first.position.tobytes() == second.position.tobytes()
        assert first.covariance.tobytes() == second.covariance.tobytes()
    assert all(np.array_equal(a, b) for a, b in zip(before, tracks.courses, strict=True))


def test_a_global_shutter_remembers_no_courses() -> None:
    rig = make_rig(2)
    scene = Scene(rig, 0)
    _, tracks = localize(Frame(scene.render(0, scene.truth(0, 0.0)), 1, 0), rig, Tracks.none())
    assert len(tracks.courses.seen_ns) == 0


def test_every_kind_of_motion_goes_through_the_same_pose_at_mid_sequence(rng: np.random.Generator) -> None:
    starts = [
        {name: motion(0.0) for name, motion in motions(make_rig(2), kind, np.random.default_rng(5), 0.3, 1.0).items()}
        for kind in KINDS
    ]
    for name, pose in starts[0].items():
        assert all(np.allclose(start[name].position, pose.position) for start in starts[1:])
