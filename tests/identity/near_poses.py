"""Robots near a wide lens: cameras, rigs, and poses of which every LED is in view."""

from collections.abc import Iterator

import numpy as np

from asterism.protocol.camera import Camera
from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig, Robot
from asterism.server.identity.plan import Plan, plan_for
from asterism.server.identity.rays import Rays
from asterism.server.pose.lens import project_point, undistort
from tests.rigs import random_layouts

LED_RADIUS = 0.0025  # m, the true one
EDGE_PX = 14.0  # LEDs nearer to the image's edge may be cut
LENSES = {
    "wide": Camera(
        "wide", 960, 600, np.array([[450.0, 0, 482.3], [0, 450.0, 296.9], [0, 0, 1.0]]), "plumb_bob",
        np.array([-0.05, 0.01, 0.0003, -0.0002, 0.0]),
    ),
    "fisheye": Camera(
        "fisheye", 960, 600, np.array([[450.0, 0, 482.3], [0, 450.0, 296.9], [0, 0, 1.0]]), "equidistant",
        np.array([0.01, -0.004, 0.001, 0.0]),
    ),
}  # fmt: skip


def near_rig(
    count: int, lens: str, seed: int = 3, range_m: tuple[float, float] | None = (0.2, 0.6), told: float = 1.0
) -> Rig:
    """Robots 0.11 m wide; the rig says that their LEDs are ``told`` times as large as they are."""
    robots = tuple(
        Robot(f"r{k:02d}", np.column_stack([1.1 * layout, np.zeros(6)]), led_radius=told * LED_RADIUS)
        for k, layout in enumerate(random_layouts(count, seed))
    )
    return Rig(LENSES[lens], robots, range_m=range_m)


def ray_at(plan: Plan, pixel: Floats) -> Floats:
    """The unit direction (3,) of a pixel (2,); nan if the lens sees none there."""
    ray, covariance = np.empty((1, 2)), np.empty((1, 3))
    undistort(plan.lens, pixel[None], np.array([[1.0, 0.0, 1.0]]), ray, covariance)
    direction = np.append(ray[0], 1.0)
    unit: Floats = direction / np.linalg.norm(direction)
    return unit


def pixels_of(plan: Plan, leds: Floats) -> Floats:
    """Pixels (n, 2) of points (n, 3) in the camera's frame."""
    return np.array([project_point(plan.lens, *led) for led in leds])


def near_poses(
    plan: Plan, rng: np.random.Generator, away_m: float, tilt_deg: tuple[float, float], off_axis_deg: float = 0.0
) -> Iterator[tuple[int, Pose, Floats]]:
    """Without end: a robot (its index), T_camera_plane, and its LEDs' pixels (6, 2), all of them in view.

    The middle of its LEDs is ``away_m`` from the camera, at least ``off_axis_deg`` off the axis.
    """
    camera, size = plan.rig.camera, np.array([plan.rig.camera.width, plan.rig.camera.height])
    while True:
        robot, sight = int(rng.integers(len(plan.layouts))), ray_at(plan, rng.uniform(0, 1, 2) * size)
        if not sight[2] < np.cos(np.radians(off_axis_deg)):
            continue
        tilt, across = np.radians(rng.uniform(*tilt_deg)), np.cross(sight, rng.normal(size=3))
        normal = -np.cos(tilt) * sight + np.sin(tilt) * across / np.linalg.norm(across)
        x = np.cross(normal, rng.normal(size=3))
        x /= np.linalg.norm(x)
        turn = np.column_stack([x, np.cross(normal, x), normal])
        pose = Pose.from_matrix(turn, away_m * sight - turn @ plan.layouts[robot].mean(axis=0))
        leds = pose.map(plan.layouts[robot])
        facing = -(leds @ normal) / np.linalg.norm(leds, axis=1)
        if leds[:, 2].min() > 0.02 and facing.min() > 0.05:
            pixels = pixels_of(plan, leds)
            if pixels.min() > EDGE_PX and (pixels < [camera.width - EDGE_PX, camera.height - EDGE_PX]).all():
                yield robot, pose, pixels


def spots_at(
    plan: Plan, rng: np.random.Generator, seen: list[tuple[int, Pose, Floats]], hidden: int, clutter: int
) -> tuple[Rays, dict[int, Floats]]:
    """Spots as the chain would see them, in any order, and for every robot the spot of each LED (-1: hidden)."""
    pixels, heights, radii, owners = [], [], [], []
    for robot, pose, places in seen:
        leds = pose.map(plan.layouts[robot])
        away = np.linalg.norm(leds, axis=1)
        for led in rng.permutation(6)[hidden:].tolist():
            owners.append((robot, led))
            pixels.append(places[led] + 0.02 * rng.standard_normal(2))
            facing = -float(leds[led] @ pose.rotation[:, 2]) / away[led]
            radii.append(LED_RADIUS * plan.focal / away[led] * np.sqrt(facing) * rng.uniform(0.97, 1.03))
            heights.append(170.0 * facing * rng.uniform(0.85, 1.15))
    lamps = np.concatenate([places for _, _, places in seen])  # the hidden ones too: light in their place is theirs
    while clutter:
        place = rng.uniform(0, 1, 2) * [plan.rig.camera.width, plan.rig.camera.height]
        if np.hypot(*(lamps - place).T).min() > 8.0 and np.isfinite(ray_at(plan, place)).all():
            owners.append((-1, -1))
            pixels.append(place)
            radii.append(rng.uniform(1.5, 5.0))
            heights.append(rng.uniform(40.0, 240.0))
            clutter -= 1
    n, order = len(owners), rng.permutation(len(owners))
    where = {robot: np.full(6, -1) for robot, _, _ in seen}
    for row, k in enumerate(order):
        robot, led = owners[k]
        if robot >= 0:
            where[robot][led] = row
    rays, covariances = np.empty((n, 2)), np.empty((n, 3))
    undistort(plan.lens, np.array(pixels)[order], np.tile([4e-4, 0.0, 4e-4], (n, 1)), rays, covariances)
    variances, flat = 0.5 * (covariances[:, 0] + covariances[:, 2]), rays * [plan.focal, -plan.focal]
    return Rays(
        np.arange(n), flat, rays, covariances, variances, np.array(heights)[order], np.array(radii)[order]
    ), where


def plan_of(count: int, lens: str, range_m: tuple[float, float] | None = (0.2, 0.6), told: float = 1.0) -> Plan:
    """The plan of a `near_rig`."""
    return plan_for(near_rig(count, lens, range_m=range_m, told=told))
