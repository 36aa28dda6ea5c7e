"""Poses from labelled centres: the chain's own solving, without images, for a rig that a calibration tries out."""

from collections.abc import Sequence

import numpy as np

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig
from asterism.server.calibration.leds.observations import Sighting
from asterism.server.pose.covariance import move_origin
from asterism.server.pose.fit import LEDS
from asterism.server.pose.led_doubt import own_scatter
from asterism.server.pose.lens import lens_of, undistort
from asterism.server.pose.matched import Constellations, Matched, Measured
from asterism.server.pose.planar import NO_SOLUTION
from asterism.server.pose.solve import Solutions, solve_robots
from asterism.server.pose.spot_shift import optics_of


def solve_sightings(rig: Rig, sightings: Sequence[Sighting]) -> list[tuple[Pose, Floats] | None]:
    """T_camera_robot and its covariance (6, 6), camera's axes, of every sighting's centres, by ``rig``.

    Each is started from the pose it has; of the two tilts the likelier is taken. None where there is no pose.
    """
    n = len(sightings)
    robots = [rig.robot(s.robot) for s in sightings]
    layouts = np.array([robot.leds_plane for robot in robots])
    optics = np.array([optics_of(robot) for robot in robots])
    lens = lens_of(rig.camera)
    centres = np.array([s.centres.centres_px for s in sightings]).reshape(-1, 2)
    spreads = np.array([s.centres.covariances_px2 for s in sightings]).reshape(-1, 2, 2)
    there = np.isfinite(centres[:, 0])
    assignment = np.where(there, np.arange(LEDS * n), -1).reshape(n, LEDS)
    pixels = np.where(there[:, None], centres, rig.camera.matrix[:2, 2])
    flat = np.where(there[:, None], np.column_stack([spreads[:, 0, 0], spreads[:, 0, 1], spreads[:, 1, 1]]), 1.0)
    for k, (robot, sighting) in enumerate(zip(robots, sightings, strict=True)):
        change = own_scatter(robot.led_offset, sighting.centres.strange_px)
        flat[LEDS * k : LEDS * (k + 1), ::2] += np.where(there[LEDS * k : LEDS * (k + 1)], change, 0.0)[:, None]
    rays, covariances = np.empty((LEDS * n, 2)), np.empty((LEDS * n, 3))
    undistort(lens, pixels, flat, rays, covariances)
    starts = [s.pose @ robot.T_robot_plane for s, robot in zip(sightings, robots, strict=True)]
    rotations, ts = np.array([pose.rotation for pose in starts]), np.array([pose.position for pose in starts])
    matched, found = Matched(np.arange(n), assignment, rotations, ts), Solutions.room(n)
    solve_robots(lens, Constellations(layouts, optics), matched, Measured(rays, covariances, pixels), found)
    solved: list[tuple[Pose, Floats] | None] = []
    for k, robot in enumerate(robots):
        best = int(np.argmin(found.costs[k]))
        if found.costs[k, best] >= NO_SOLUTION:
            solved.append(None)
            continue
        pose = Pose.from_matrix(found.rotations[k, best], found.ts[k, best]) @ robot.T_robot_plane.inverse()
        covariance = found.covariances[k, best].copy()
        move_origin(covariance, pose.position - found.ts[k, best])
        solved.append((pose, covariance))
    return solved
