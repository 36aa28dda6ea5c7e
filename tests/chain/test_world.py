"""A camera that is followed by constellations that stand still: where it is, how sure, and what it does to poses."""

from dataclasses import replace

import numpy as np
import pytest

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose, log_rotation
from asterism.protocol.rig import Rig, load_rig, parse_rig
from asterism.server import Frame, FrameResult, PoseEstimate, Tracks, localize
from asterism.server.calibration.leds.observations import observe
from asterism.server.calibration.rewrite import rewrite
from asterism.server.calibration.survey.world import without_world
from asterism.server.chain.report import frame_report
from asterism.server.chain.world import Following, place_before
from asterism.server.pose.place import Place, apart, moved
from asterism.server.service.adviser import wider_rig
from asterism.server.service.carry import carried
from asterism.server.service.drift import Drift
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.simulation.simulate import Scene
from tests.helpers import assert_poses_close
from tests.measure.drawn_frames import Motion, Stage, stage_rig
from tests.measure.follow import MOTIONS, measured

STEP_NS = 16_666_667


def film(motion: Motion, frames: int, fixed: int = 2, robots: int = 1) -> tuple[Stage, list[FrameResult]]:
    """Results at 60 Hz, by the solver, without pixels."""
    rig = replace(stage_rig(robots, fixed, 7), follows_world=True)
    stage = Stage(rig, 3, always="drive", motion=motion, wrong=False)
    return stage, [stage.frame((k + 1) / 60.0) for k in range(frames)]


def off(stage: Stage, result: FrameResult, time_s: float) -> tuple[Floats, Floats]:
    """How far the camera is from where it was taken to be, and the covariance."""
    assert result.place is not None
    return apart(stage.T_world_camera(time_s), result.place.T_world_camera), result.place.covariance


@pytest.mark.parametrize("motion", ["creeps", "shakes 0.005 deg", "shakes 0.1 deg"])
def test_covariances_in_the_world_are_meant_however_the_camera_moves(motion: str) -> None:
    nees, _, camera = measured(MOTIONS[motion], 2, True, 4.0)
    assert 2.5 < nees < 8.0
    assert 1.0 < camera < 8.0


def test_a_kick_is_taken_over_in_the_frame_that_shows_it_and_said() -> None:
    kick = 0.3 * np.pi / 180 * np.array([0.6, 0.8, 0.0])
    stage, results = film(lambda t: (kick * (t > 0.5), np.array([2e-3, 0.0, 0.0]) * (t > 0.5)), 40)
    kicked = [k for k, result in enumerate(results) if result.place is not None and result.place.kick is not None]
    assert kicked == [30]
    for k in (30, 31, 35):
        error, covariance = off(stage, results[k], (k + 1) / 60.0)
        assert error @ np.linalg.solve(covariance, error) < 25.0
    said: list[str] = []
    drift = Drift(stage.told, said.append)
    for result in results:
        drift.add(result)
    drift.look()
    (sentence,) = said
    assert sentence.startswith("the camera was kicked at 01:46:40 UTC: by ")


def test_averaging_gains_where_the_camera_stands() -> None:
    stage, results = film(lambda _: (np.zeros(3), np.zeros(3)), 120)
    assert results[0].place is not None
    one_frame = results[0].place.noise
    errors = [off(stage, result, 1.0)[0] for result in results[30:]]
    assert float(np.mean([error @ np.linalg.solve(one_frame, error) for error in errors])) < 3.0  # of a frame alone: 6


def test_out_of_sight_the_place_holds_and_its_covariance_grows() -> None:
    stage, results = film(lambda _: (np.zeros(3), np.zeros(3)), 30)
    place = results[-1].place
    assert place is not None
    tracks = Following.of(Tracks.none(3), place)
    soon, late = (place_before(tracks, stage.told, place.at_ns + round(s * 1e9)) for s in (1.0, 3600.0))
    assert_poses_close(late.T_world_camera, place.T_world_camera)
    assert late.seen_ns == place.seen_ns
    grown = np.sqrt(np.diag(late.covariance - place.covariance))
    np.testing.assert_allclose(grown, [60e-5] * 3 + [np.radians(0.06)] * 3, rtol=1e-6)
    assert np.trace(soon.covariance) < np.trace(late.covariance)


SCENE_RIG = load_rig(DEMO_RIG)


def demo_rig() -> Rig:
    """The demo, two of whose robots are fixed where they are at time 0; it has its camera 4 mm and 0.3 degrees off."""
    scene, true = Scene(SCENE_RIG, 3), SCENE_RIG.T_world_camera
    assert true is not None
    fixed = {entry.robot: true @ entry.T_camera_robot for entry in scene.truth(0, 0.0)[:2]}
    robots = tuple(replace(robot, T_world_fixed=fixed.get(robot.id)) for robot in SCENE_RIG.robots)
    off_by = np.array([2e-3, -1e-3, 3e-3, 4e-3, -2e-3, 3e-3])
    return replace(SCENE_RIG, robots=robots, T_world_camera=moved(true, off_by), follows_world=True)


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    """Two robots stand, the others drive."""
    scene, out = Scene(SCENE_RIG, 3), []
    for index in range(12):
        truth = [*scene.truth(index, 0.0)[:2], *scene.truth(index, index / 60.0)[2:]]
        out.append(Frame(scene.render(index, truth), 10**18 + index * STEP_NS, index))
    return out


def located(rig: Rig, frames: list[Frame], tracks: Tracks) -> tuple[list[FrameResult], Tracks]:
    results = []
    for frame in frames:
        result, tracks = localize(frame, rig, tracks)
        results.append(result)
    return results, tracks


def test_by_pixels_the_camera_and_robots_in_the_world_are_where_they_are(frames: list[Frame]) -> None:
    true, scene = SCENE_RIG.T_world_camera, Scene(SCENE_RIG, 3)
    assert true is not None
    results, _ = located(demo_rig(), frames, Tracks.none())
    for result in (results[0], results[-1]):
        assert result.place is not None
        error = apart(true, result.place.T_world_camera)
        assert error @ np.linalg.solve(result.place.covariance, error) < 25.0
        assert np.linalg.norm(error[:3]) < 1e-3
        for entry in scene.truth(result.index, result.index / 60.0)[2:]:
            answer = result.answers[entry.robot]
            if isinstance(answer, PoseEstimate):
                pose = true @ entry.T_camera_robot
                turned = log_rotation(answer.pose.rotation @ pose.rotation.T)
                away = np.concatenate([answer.position - pose.position, turned])
                assert away @ np.linalg.solve(answer.covariance, away) < 30.0


def test_the_same_arguments_give_the_same_results(frames: list[Frame]) -> None:
    rig = demo_rig()
    _, tracks = located(rig, frames[:3], Tracks.none())
    a, after_a = localize(frames[3], rig, tracks)
    b, after_b = localize(frames[3], rig, tracks)
    assert isinstance(after_a, Following)
    assert isinstance(after_b, Following)
    assert np.array_equal(after_a.place.covariance, after_b.place.covariance)
    assert frame_report(frames[3], a, rig, 0) == frame_report(frames[3], b, rig, 0)


def test_who_begins_with_what_a_report_tells_goes_on_alike(frames: list[Frame]) -> None:
    rig = demo_rig()
    results, _ = located(rig, frames, Tracks.none())
    told = frame_report(frames[5], results[5], rig, 0).camera
    pose = Pose(
        np.array([told.pose.position.x, told.pose.position.y, told.pose.position.z]),
        np.array([getattr(told.pose.orientation, axis) for axis in "xyzw"]),
    )
    covariance, noise = (np.array(values).reshape(6, 6) for values in (told.covariance, told.noise))
    place = Place(pose, covariance, noise, frames[5].exposed_ns, told.seen_ns)
    tracks = Following.of(Tracks.knowing(results[5].learned), place)
    again, _ = located(rig, frames[6:], tracks)
    assert again[-1].place is not None
    assert results[-1].place is not None
    assert_poses_close(again[-1].place.T_world_camera, results[-1].place.T_world_camera, 1e-5, 1e-5)


def test_without_follow_nothing_is_told_of_the_camera(frames: list[Frame]) -> None:
    rig = replace(demo_rig(), follows_world=False)
    result, tracks = localize(frames[0], rig, Tracks.none())
    assert result.place is None
    assert type(tracks) is Tracks
    assert not frame_report(frames[0], result, rig, 0).HasField("camera")


def test_what_looks_without_the_world_does_not_follow_it(frames: list[Frame]) -> None:
    rig = demo_rig()
    for other in (wider_rig(rig, False), without_world(rig)):
        result, _ = localize(frames[0], other, Tracks.none())
        assert result.place is None
    assert rig.T_world_camera is not None
    ((_, sightings),) = observe(frames[:1], rig)
    for sighting in sightings[:2]:
        fixed = rig.robot(sighting.robot).T_world_fixed
        true = SCENE_RIG.T_world_camera
        if fixed is not None and true is not None:
            assert_poses_close(sighting.pose, true.inverse() @ fixed, 1e-3, 2e-2)


def test_with_a_rolling_shutter_the_camera_is_followed_likewise(frames: list[Frame]) -> None:
    rig = demo_rig()
    rig = replace(rig, capture=replace(rig.capture, line_time_us=1.0))
    results, tracks = located(rig, frames[:4], Tracks.none())
    assert isinstance(tracks, Following)
    true = SCENE_RIG.T_world_camera
    assert true is not None
    error = apart(true, tracks.place.T_world_camera)
    assert error @ np.linalg.solve(tracks.place.covariance, error) < 25.0
    assert len(tracks.courses.seen_ns) == len(rig.robots)
    assert results[-1].place is tracks.place


def test_a_rig_read_again_keeps_the_place_where_nothing_moved(frames: list[Frame]) -> None:
    rig = demo_rig()
    _, tracks = located(rig, frames[:3], Tracks.none())
    kept = carried(tracks, rig, replace(rig, robots=rig.robots[:4]))
    assert isinstance(kept, Following)
    assert isinstance(tracks, Following)
    assert kept.place is tracks.place
    assert rig.T_world_camera is not None
    elsewhere = replace(rig, T_world_camera=moved(rig.T_world_camera, np.full(6, 1e-3)))
    for other in (elsewhere, replace(rig, robots=rig.robots[1:]), replace(rig, follows_world=False)):
        assert not isinstance(carried(tracks, rig, other), Following)


def test_follow_without_anything_fixed_is_refused() -> None:
    text = rewrite(SCENE_RIG.rig_text, {("world", "follow"): "yes"}, "rig.yaml").replace("follow: yes", "follow: true")
    with pytest.raises(InputError, match=r"world\.follow: true, but no robot of the rig is `fixed`, expected one"):
        parse_rig(text, SCENE_RIG.camera_text, "here")
