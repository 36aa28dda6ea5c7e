"""Who is who: cold search against brute force, scores and margins, warm matching."""

import itertools
import math

import numpy as np
import pytest

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig
from asterism.server.identity.identify import Matches, identify
from asterism.server.identity.plan import Plan, plan_for
from asterism.server.identity.rays import Rays
from asterism.server.pose.track import Tracks
from tests.helpers import facing_pose
from tests.rigs import make_rig

SIGMA_PX = 0.02


def spots_of(
    plan: Plan,
    poses: dict[int, Pose],
    rng: np.random.Generator,
    hidden: dict[int, list[int]] | None = None,
    clutter: int = 0,
    brightness: dict[int, float] | None = None,
) -> tuple[Rays, dict[int, Floats]]:
    """Spots as the chain would see them, shuffled, and for every robot the spot of each LED (-1: hidden)."""
    rays, heights, owner = [], [], []
    for robot, pose in poses.items():
        mapped = pose.map(plan.layouts[robot])
        for led in range(6):
            if led in (hidden or {}).get(robot, []):
                continue
            rays.append(mapped[led, :2] / mapped[led, 2] + SIGMA_PX / plan.focal * rng.standard_normal(2))
            heights.append((brightness or {}).get(robot, 170.0) * rng.uniform(0.85, 1.15))
            owner.append((robot, led))
    placed = np.array(rays).reshape(-1, 2)
    added = 0
    while added < clutter:
        ray = rng.uniform([-0.42, -0.34], [0.42, 0.34])
        if len(placed) == 0 or np.hypot(*(placed - ray).T).min() * plan.focal > 8.0:
            placed = np.vstack([placed, ray])
            heights.append(rng.uniform(60, 240))
            owner.append((-1, -1))
            added += 1
    order = rng.permutation(len(owner))
    placed, height = placed[order], np.array(heights)[order]
    where = {robot: np.full(6, -1) for robot in poses}
    for row, k in enumerate(order):
        if owner[k][0] >= 0:
            where[owner[k][0]][owner[k][1]] = row
    n = len(order)
    variance = np.full(n, (SIGMA_PX / plan.focal) ** 2)
    covariances = np.column_stack([variance, np.zeros(n), variance])
    flat = placed * np.array([plan.focal, -plan.focal])
    return Rays(np.arange(n), flat, placed, covariances, variance, height, np.full(n, 2.5)), where


def apart(
    rng: np.random.Generator, count: int, depth_m: tuple[float, float] = (1.0, 1.8), tilt: float = 45.0
) -> list[Pose]:
    """Poses whose plates do not overlap in the image."""
    poses: list[Pose] = []
    while len(poses) < count:
        pose = facing_pose(rng, depth_m, (0.0, tilt))
        centre = pose.position[:2] / pose.position[2]
        if all(
            np.hypot(*(centre - other.position[:2] / other.position[2]))
            > 0.062 * (1 / pose.position[2] + 1 / other.position[2])
            for other in poses
        ):
            poses.append(pose)
    return poses


def check(matches: Matches, where: dict[int, Floats]) -> tuple[int, int]:
    """How many robots were found with every LED right, and how many wrong in any way."""
    right = wrong = 0
    for k, robot in enumerate(matches.found.robots.tolist()):
        told = matches.found.assignment[k]
        truth = where.get(robot)
        good = truth is not None and all(a in (-1, b) for a, b in zip(told, truth, strict=True))
        right, wrong = right + good, wrong + (not good)
    return right, wrong


def cold(seen: Rays, rig: Rig) -> Matches:
    return identify(seen, plan_for(rig), Tracks.none(len(rig.robots)), 0)


def test_cold_search_equals_brute_force_on_one_robot(rng: np.random.Generator) -> None:
    """The slow and obvious way: every ordered choice of six spots, the best affine fit."""
    rig = make_rig(1, seed=4)
    plan = plan_for(rig)
    for _ in range(5):
        pose = facing_pose(rng, (1.2, 1.6), (0, 25))
        seen, _ = spots_of(plan, {0: pose}, rng, clutter=2)
        basis = np.column_stack([plan.layouts[0][:, :2], np.ones(6)])
        left_over = np.eye(6) - basis @ np.linalg.pinv(basis)
        best, best_order = np.inf, ()
        for order in itertools.permutations(range(len(seen.rows)), 6):
            points = seen.flat[list(order)]
            residual = float(((left_over @ points) ** 2).sum())
            if residual < best and np.linalg.det((np.linalg.pinv(basis) @ points)[:2]) > 0:
                best, best_order = residual, order
        matches = cold(seen, rig)
        assert matches.found.robots.tolist() == [0]
        assert matches.found.assignment[0].tolist() == list(best_order)


@pytest.mark.parametrize(("clutter", "hide"), [(0, 0.0), (30, 0.0), (30, 0.3)])
def test_ten_robots_are_found_and_none_is_mistaken(rng: np.random.Generator, clutter: int, hide: float) -> None:
    rig = make_rig(10, seed=1)
    plan = plan_for(rig)
    sightings = right = 0
    for _ in range(25):
        poses = dict(enumerate(apart(rng, 10)))
        hidden = {robot: [int(rng.integers(6))] for robot in poses if rng.random() < hide}
        seen, where = spots_of(plan, poses, rng, hidden, clutter)
        found, wrong = check(cold(seen, rig), where)
        assert wrong == 0
        sightings, right = sightings + 10, right + found
    assert right >= 0.99 * sightings


def test_robots_without_a_range_in_the_rig_are_found(rng: np.random.Generator) -> None:
    rig = make_rig(5, seed=2, range_m=None)
    for _ in range(10):
        seen, where = spots_of(plan_for(rig), dict(enumerate(apart(rng, 5))), rng, clutter=10)
        assert check(cold(seen, rig), where) == (5, 0)


def with_sizes(seen: Rays, plan: Plan, poses: dict[int, Pose], where: dict[int, Floats]) -> Rays:
    """The same spots as large as LEDs of 2.5 mm are at their distances."""
    radii = seen.radii.copy()
    for robot, pose in poses.items():
        facing = -pose.rotation[:, 2] @ pose.position / np.linalg.norm(pose.position)
        rows = where[robot][where[robot] >= 0]
        radii[rows] = 0.0025 * plan.focal / pose.position[2] * math.sqrt(facing)
    return seen._replace(radii=radii)


@pytest.mark.parametrize("everybody", [False, True])
def test_four_leds_are_enough_where_nothing_else_explains_them(rng: np.random.Generator, everybody: bool) -> None:
    """Cold, in a rig of eight: two LEDs hidden of a third of the robots, or of all."""
    rig = make_rig(8, seed=11)
    plan = plan_for(rig)
    lacking = found = 0
    for _ in range(25):
        poses = dict(enumerate(apart(rng, 8)))
        hidden = {robot: rng.choice(6, 2, replace=False).tolist() for robot in poses if everybody or rng.random() < 0.3}
        seen, where = spots_of(plan, poses, rng, hidden, clutter=0 if everybody else 10)
        matches = cold(with_sizes(seen, plan, poses, where), rig)
        assert check(matches, where)[1] == 0
        lacking += len(hidden)
        found += len(hidden.keys() & set(matches.found.robots.tolist()))
    assert found >= 0.6 * lacking


def test_four_leds_of_a_stranger_with_six_are_nobody(rng: np.random.Generator) -> None:
    rig, strangers = make_rig(8, seed=12), make_rig(8, seed=98)
    plan = plan_for(strangers)
    for lit in (6, 5):
        for _ in range(20):
            poses = dict(enumerate(apart(rng, 8)))
            hidden = {robot: rng.choice(6, 6 - lit, replace=False).tolist() for robot in poses}
            seen, where = spots_of(plan, poses, rng, hidden)
            assert cold(with_sizes(seen, plan, poses, where), rig).found.robots.tolist() == []


def test_four_leds_among_others_like_them_are_a_doubt_or_nobody(rng: np.random.Generator) -> None:
    """A fifth and a sixth light within the constellation: it may be a stranger's."""
    rig = make_rig(8, seed=13)
    plan = plan_for(rig)
    for _ in range(10):
        pose = facing_pose(rng, (1.0, 1.4), (0.0, 40.0))
        seen, where = spots_of(plan, {0: pose}, rng, {0: [1, 4]})
        seen = with_sizes(seen, plan, {0: pose}, where)
        middle = seen.rays.mean(axis=0) + 0.01 * rng.standard_normal((2, 2))
        more = Rays(
            np.arange(6),
            np.vstack([seen.flat, middle * [plan.focal, -plan.focal]]),
            np.vstack([seen.rays, middle]),
            *(np.concatenate([a, a[:2]]) for a in (seen.covariances, seen.variances, seen.heights, seen.radii)),
        )
        assert cold(more, rig).found.robots.tolist() == []


def test_clutter_alone_is_nobody(rng: np.random.Generator) -> None:
    rig = make_rig(8, seed=3)
    for _ in range(40):
        seen, _ = spots_of(plan_for(rig), {}, rng, clutter=40)
        assert cold(seen, rig).found.robots.tolist() == []


def test_strangers_are_nobody(rng: np.random.Generator) -> None:
    rig, strangers = make_rig(5, seed=5), make_rig(5, seed=99)
    for _ in range(20):
        seen, _ = spots_of(plan_for(strangers), dict(enumerate(apart(rng, 5))), rng)
        assert cold(seen, rig).found.robots.tolist() == []


def test_a_dimmer_mirror_image_of_a_robot_is_not_the_robot(rng: np.random.Generator) -> None:
    rig = make_rig(2, seed=6)
    plan = plan_for(rig)
    for _ in range(20):
        real, mirrored = apart(rng, 2)
        seen, where = spots_of(plan, {0: real}, rng)
        ghost, _ = spots_of(plan, {0: mirrored}, rng, brightness={0: 55.0})
        both = Rays(
            np.arange(12),
            *(
                np.concatenate([getattr(seen, name), getattr(ghost, name)])
                for name in ("flat", "rays", "covariances", "variances", "heights", "radii")
            ),
        )
        assert check(cold(both, rig), where) == (1, 0)


def test_a_robot_seen_twice_equally_bright_is_ambiguous(rng: np.random.Generator) -> None:
    rig = make_rig(2, seed=6)
    plan = plan_for(rig)
    here, there = apart(rng, 2)
    seen, _ = spots_of(plan, {0: here}, rng)
    again, _ = spots_of(plan, {0: there}, rng)
    both = Rays(
        np.arange(12),
        *(
            np.concatenate([getattr(seen, name), getattr(again, name)])
            for name in ("flat", "rays", "covariances", "variances", "heights", "radii")
        ),
    )
    matches = cold(both, rig)
    assert matches.found.robots.tolist() == []
    assert matches.doubts == {0: "it is seen in two places"}


def test_followed_robots_keep_their_leds_with_two_hidden(rng: np.random.Generator) -> None:
    rig = make_rig(8, seed=7)
    plan = plan_for(rig)
    poses = dict(enumerate(apart(rng, 8)))
    tracks = Tracks.none(8)
    for robot, pose in poses.items():
        tracks.seen_ns[robot] = 1_000_000_000
        tracks.rotations[robot], tracks.ts[robot] = pose.rotation, pose.position
        tracks.numbers[robot] = [0.0005, 0.005, 0.1, 0.5, 170.0, 0.0, 0.0]
    moved = {
        robot: Pose(pose.position + 0.002 * rng.standard_normal(3), pose.orientation) for robot, pose in poses.items()
    }
    hidden = {robot: rng.choice(6, 2, replace=False).tolist() for robot in poses}
    seen, where = spots_of(plan, moved, rng, hidden, clutter=20)
    matches = identify(seen, plan, tracks, 1_016_666_667)
    assert check(matches, where) == (8, 0)
    assert matches.warm == 8
    assert ((matches.found.assignment >= 0).sum(axis=1) == 4).all()


def test_a_wrong_prediction_falls_back_to_the_cold_search_of_the_same_frame(rng: np.random.Generator) -> None:
    rig = make_rig(3, seed=8)
    plan = plan_for(rig)
    poses = dict(enumerate(apart(rng, 3)))
    tracks = Tracks.none(3)
    for robot in range(3):
        pose = poses[(robot + 1) % 3]  # everybody is where somebody else was
        tracks.seen_ns[robot] = 1_000_000_000
        tracks.rotations[robot], tracks.ts[robot] = pose.rotation, pose.position
        tracks.numbers[robot] = [0.0005, 0.005, 0.1, 0.5, 170.0, 0.0, 0.0]
    seen, where = spots_of(plan, poses, rng)
    assert check(identify(seen, plan, tracks, 1_016_666_667), where) == (3, 0)
