"""Robots that nobody knows: poses of three spots, and a search that is bounded and goes on in the next exposure."""

import numpy as np

from asterism.protocol.geometry import exp_rotation
from asterism.server.fusing.cold import searched
from asterism.server.fusing.fleet import Fleet, View
from asterism.server.fusing.joined import Joined
from asterism.server.fusing.three_points import three_points
from tests.fusing.spotted import drawn
from tests.several import Drive, facing_pair, rigs_at


def test_three_directions_tell_the_pose_that_made_them(rng: np.random.Generator) -> None:
    rotations, ts = np.empty((2, 3, 3)), np.empty((2, 3))
    found = 0
    for _ in range(200):
        points = np.column_stack([rng.uniform(-0.05, 0.05, (3, 2)), np.zeros(3)])
        turn = exp_rotation(np.array([np.pi, 0, 0])) @ exp_rotation(rng.uniform(-0.6, 0.6, 3))
        t = np.array([*rng.uniform(-0.4, 0.4, 2), rng.uniform(0.8, 2.0)])
        shown = points @ turn.T + t
        directions = shown / np.linalg.norm(shown, axis=1)[:, None]
        count = three_points(directions, points, rotations, ts)
        for k in range(count):
            # Whatever is told maps the points onto the directions, if only nearly where the two poses all but meet.
            mapped = points @ rotations[k].T + ts[k]
            mapped /= np.linalg.norm(mapped, axis=1)[:, None]
            assert np.abs(mapped - directions).max() < 5e-3
        found += any(np.abs(ts[k] - t).max() < 1e-6 for k in range(count))
    assert found >= 190


def test_what_one_exposure_leaves_others_find(rng: np.random.Generator) -> None:
    rigs = rigs_at(facing_pair(60.0), robots=3)
    fleet = Fleet.of([View(rig) for rig in rigs])
    poses = Drive(tuple(fleet.robots))(0.5)
    robots = {name: (fleet.robots[name], poses[name]) for name in poses}
    lit = {name: [0, 1, 2, 3] for name in poses}
    found: set[str] = set()
    counts = []
    for frame in range(20):
        sightings = [drawn(rig, robots, lit, rng, exposed_ns=16_666_667 * frame) for rig in rigs]
        joined = Joined.of(fleet, sightings, lambda *_: None)
        free = np.ones(len(joined.scene.rays), np.bool_)
        told, doubts = searched(joined, list(fleet.robots.values()), free, most=100)
        assert not doubts
        counts.append(len(told))
        for one in told:
            assert np.linalg.norm(one.pose.position - poses[one.robot].position) < 1e-3
        found |= {one.robot for one in told}
    assert min(counts) < len(poses)
    assert found == set(poses)
