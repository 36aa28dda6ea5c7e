"""Rigs that are off: robots whose LEDs lie beside where the rig has them, cold and followed, and what is learned."""

from dataclasses import replace

import numpy as np

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig
from asterism.server.identity.identify import identify
from asterism.server.identity.plan import Plan, plan_for
from asterism.server.pose.track import KNOWN, NEWEST, Tracks
from tests.identity.test_identification import apart, check, cold, spots_of, with_sizes
from tests.rigs import make_camera, make_rig, random_layouts

APART_M = 0.014  # separations as `asterism design` makes them for a handful of plates


def wide_apart(count: int) -> Rig:
    """A rig of constellations that stay well apart."""
    rig = make_rig(count, camera=make_camera())
    layouts = random_layouts(count, 21, APART_M)
    robots = [
        replace(robot, leds=np.column_stack([xy, np.zeros(6)])) for robot, xy in zip(rig.robots, layouts, strict=True)
    ]
    return replace(rig, robots=tuple(robots))


def measured(rig: Rig, rng: np.random.Generator, off_m: float, robots: int = 99) -> Rig:
    """The rig as a ruler tells it: LED positions of its first so many robots off by a normal error an axis."""
    told = [
        replace(robot, leds=robot.leds + off_m * rng.normal(size=(6, 3)) * [1, 1, 0]) if k < robots else robot
        for k, robot in enumerate(rig.robots)
    ]
    return replace(rig, robots=tuple(told))


RIG = wide_apart(6)


def test_robots_measured_with_a_ruler_are_found_and_none_is_mistaken(rng: np.random.Generator) -> None:
    for off_m, share in ((0.3e-3, 0.99), (0.5e-3, 0.97), (1.0e-3, 0.85)):
        right = seen = 0
        for _ in range(15):
            told = measured(RIG, rng, off_m)
            poses = dict(enumerate(apart(rng, 6, (1.15, 1.45))))
            spots, where = spots_of(plan_for(RIG), poses, rng)
            found, wrong = check(cold(with_sizes(spots, plan_for(RIG), poses, where), told), where)
            assert wrong == 0
            right, seen = right + found, seen + 6
        assert right >= share * seen, off_m


def test_one_bad_plate_is_found_beside_good_ones(rng: np.random.Generator) -> None:
    found = 0
    for _ in range(15):
        told = measured(RIG, rng, 0.5e-3, robots=1)
        poses = dict(enumerate(apart(rng, 6, (1.15, 1.45))))
        spots, where = spots_of(plan_for(RIG), poses, rng)
        matches = cold(with_sizes(spots, plan_for(RIG), poses, where), told)
        assert check(matches, where)[1] == 0
        assert {1, 2, 3, 4, 5} <= set(matches.found.robots.tolist())
        found += 0 in matches.found.robots
    assert found >= 13


def test_strangers_and_clutter_are_nobody_at_a_rulers_tolerance_either(rng: np.random.Generator) -> None:
    strangers = make_rig(6, seed=77)
    for trial in range(20):
        if trial % 2:
            spots, _ = spots_of(plan_for(strangers), dict(enumerate(apart(rng, 6))), rng)
        else:
            spots, _ = spots_of(plan_for(RIG), {}, rng, clutter=60)
        assert cold(spots, RIG).found.robots.tolist() == []


def tracks_at(plan: Plan, poses: dict[int, Pose]) -> Tracks:
    """As if the robots had been seen there."""
    tracks = Tracks.none(len(plan.layouts))
    for robot, pose in poses.items():
        tracks.seen_ns[robot] = 1_000_000_000
        tracks.rotations[robot], tracks.ts[robot] = pose.rotation, pose.position
        tracks.numbers[robot] = [0.0005, 0.005, 0.1, 0.5, 170.0, 0.0, 0.0]
    return tracks


def followed(tracks: Tracks, rig: Rig, poses: dict[int, Pose], rng: np.random.Generator) -> Floats:
    """How many LEDs every robot keeps when it is followed."""
    spots, where = spots_of(plan_for(RIG), poses, rng)
    matches = identify(spots, plan_for(rig), tracks, 1_016_666_667)
    assert check(matches, where)[1] == 0
    counts = np.zeros(len(rig.robots))
    warm = matches.found.first(matches.warm)
    counts[warm.robots] = (warm.assignment >= 0).sum(axis=1)
    return counts


def test_a_followed_robot_may_be_off_by_what_was_learned_and_the_others_may_not(rng: np.random.Generator) -> None:
    told = measured(RIG, rng, 0.8e-3)
    poses = dict(enumerate(apart(rng, 6, (1.15, 1.45))))
    strict = followed(tracks_at(plan_for(told), poses), told, poses, rng)
    assert (strict < 6).all()
    for column in (KNOWN, NEWEST):
        tracks = tracks_at(plan_for(told), poses)
        tracks.misfits[:3, column] = 0.8e-3
        counts = followed(tracks, told, poses, rng)
        assert (counts[:3] == 6).all()
        assert (counts[3:] == strict[3:]).all()
