"""What is remembered goes on with another rig: of robots that are the same, and of them alone."""

from dataclasses import replace

import numpy as np
import pytest

from asterism.protocol.rig import Rig
from asterism.server.chain.frame import Frame
from asterism.server.chain.pipeline import localize
from asterism.server.chain.smooth import Motions, smooth
from asterism.server.pose.solve import PoseEstimate
from asterism.server.pose.track import Tracks
from asterism.server.service.carry import carried, carried_motions
from asterism.server.sources.simulated import Simulated
from tests.rigs import make_rig

RIG = make_rig(4, seed=3)
BEFORE = 3  # frames


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    return list(Simulated(RIG, seed=5, count=BEFORE + 1).frames())


@pytest.fixture(scope="module")
def remembered(frames: list[Frame]) -> tuple[Tracks, Motions]:
    tracks, motions = Tracks.none(), Motions.none()
    for frame in frames[:BEFORE]:
        result, tracks = localize(frame, RIG, tracks)
        _, motions = smooth(result, motions, RIG)
    assert (tracks.seen_ns[1:] > 0).all() or (tracks.seen_ns > 0).sum() >= 3
    return tracks, motions


def shuffled(*places: int) -> Rig:
    return replace(RIG, robots=tuple(RIG.robots[place] for place in places))


def test_robots_keep_their_poses_bit_for_bit_when_others_come_and_go(
    frames: list[Frame], remembered: tuple[Tracks, Motions]
) -> None:
    """One that was followed is followed: its pose in the next frame is the one it would have had."""
    tracks, _ = remembered
    after = shuffled(2, 0, 1)
    kept = carried(tracks, RIG, after)
    plain, _ = localize(frames[BEFORE], RIG, tracks)
    changed, _ = localize(frames[BEFORE], after, kept)
    compared = 0
    for robot in after.robots:
        a, b = plain.answers[robot.id], changed.answers[robot.id]
        if isinstance(a, PoseEstimate):
            assert isinstance(b, PoseEstimate)
            np.testing.assert_array_equal(a.position, b.position)
            np.testing.assert_array_equal(a.covariance, b.covariance)
            compared += 1
    assert compared >= 2
    for place, before in enumerate((2, 0, 1)):
        assert kept.seen_ns[place] == tracks.seen_ns[before]
        np.testing.assert_array_equal(kept.misfits[place], tracks.misfits[before])


def test_a_robot_that_changed_is_looked_for_anew_and_named_points_are_no_change(
    remembered: tuple[Tracks, Motions],
) -> None:
    tracks, motions = remembered
    first, second, *rest = RIG.robots
    leds = first.leds.copy()
    leds[0, 0] += 1e-4
    tool = {"tool": np.array([0.0, 0.0, 0.1])}
    after = replace(RIG, robots=(replace(first, leds=leds), replace(second, points=tool), *rest))
    kept = carried(tracks, RIG, after)
    assert kept.seen_ns.tolist() == [0, *tracks.seen_ns[1:].tolist()]
    assert set(carried_motions(motions, RIG, after).robots) == set(motions.robots) - {first.id}


@pytest.mark.parametrize("what", ["matrix", "distortion"])
def test_with_another_calibration_all_are_looked_for_anew(remembered: tuple[Tracks, Motions], what: str) -> None:
    tracks, motions = remembered
    camera = replace(RIG.camera, **{what: getattr(RIG.camera, what) * 1.001})
    after = replace(RIG, camera=camera)
    assert not carried(tracks, RIG, after).seen_ns.any()
    assert not carried_motions(motions, RIG, after).robots


def test_a_camera_that_stands_elsewhere_changes_the_parent_frame_alone(remembered: tuple[Tracks, Motions]) -> None:
    """Tracks are about the camera, what smoothing remembers is about the world."""
    from asterism.protocol.geometry import Pose

    tracks, motions = remembered
    after = replace(RIG, T_world_camera=Pose.identity())
    np.testing.assert_array_equal(carried(tracks, RIG, after).seen_ns, tracks.seen_ns)
    assert not carried_motions(motions, RIG, after).robots
    assert set(carried_motions(motions, RIG, RIG).robots) == set(motions.robots)


def test_courses_of_a_rolling_shutter_go_with_their_robots(frames: list[Frame]) -> None:
    rig = replace(RIG, capture=replace(RIG.capture, line_time_us=10.0))
    tracks = Tracks.none()
    for frame in frames[:BEFORE]:
        _, tracks = localize(frame, rig, tracks)
    after = replace(rig, robots=rig.robots[1:])
    kept = carried(tracks, rig, after)
    np.testing.assert_array_equal(kept.courses.seen_ns, tracks.courses.seen_ns[1:])
    np.testing.assert_array_equal(kept.courses.rates, tracks.courses.rates[1:])
    plain = replace(after, capture=RIG.capture)
    assert len(carried(tracks, rig, plain).courses.seen_ns) == 0
