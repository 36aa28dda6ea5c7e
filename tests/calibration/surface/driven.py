"""Robots that drive on a surface for some time, without images: spots drawn with the noise of their light, solved as
the chain does; the truth is plain functions that share nothing with what is fitted.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig
from asterism.server.budget.common_causes import led_shapes
from asterism.server.budget.uncertainty import ESTIMATOR_NOISE, Uncertainty
from asterism.server.calibration.leds.labelled import solve_sightings
from asterism.server.calibration.leds.observations import LedCentres, Sighting
from asterism.server.calibration.point.views import spots_of
from asterism.server.calibration.surface.contacts import Contacts
from asterism.server.calibration.surface.located import Located, Sight
from asterism.server.calibration.surface.touching import Standing, contacts_of
from asterism.server.centres.centre_noise import centre_covariances
from asterism.server.pose.fit import LEDS
from asterism.server.simulation.simulate import Look
from tests.on_surface import TOOL, rig_on

Ground = Callable[[Floats], tuple[Floats, Floats]]  # heights (n,) m and slopes (n, 2) at places (n, 2)
HALF = np.array([0.26, 0.19])  # m, where robots drive
SPEED = 0.12  # m/s
TOLD = Uncertainty(led_position_m=0.0)


def level(xy: Floats) -> tuple[Floats, Floats]:
    """A plane that leans."""
    return 0.02 + 0.05 * xy[:, 0] - 0.03 * xy[:, 1], np.tile([0.05, -0.03], (len(xy), 1))


def bowl(xy: Floats) -> tuple[Floats, Floats]:
    """A saddle's and a bowl's bends."""
    x, y = xy.T
    slopes = np.column_stack([-0.03 - 0.8 * x - 0.15 * y, 0.02 - 0.5 * y - 0.15 * x])
    return -0.03 * x + 0.02 * y - 0.4 * x * x - 0.25 * y * y - 0.15 * x * y, slopes


def ball(xy: Floats, radius: float = 0.6) -> tuple[Floats, Floats]:
    """The top of a ball, too round for heights of degree 2."""
    z = np.sqrt(radius**2 - (xy**2).sum(axis=1))
    return z - radius, -xy / z[:, None]


def bumps(xy: Floats) -> tuple[Floats, Floats]:
    """3 mm from hill to valley, 0.2 m from hill to hill, on a bowl."""
    k, (x, y) = 2.0 * np.pi / 0.2, xy.T
    a, b = k * x + 0.4, k * y - 0.7
    z, slopes = bowl(xy)
    waves = 0.0015 * np.column_stack([k * np.cos(a) * np.cos(b), -k * np.sin(a) * np.sin(b)])
    return z + 0.0015 * np.sin(a) * np.cos(b), slopes + waves


@dataclass(frozen=True, slots=True, eq=False)
class Driven:
    """The rig as a person has it, the truth's ground, when, and T_world_robot of every robot (r, n)."""

    rig: Rig
    ground: Ground
    times_s: Floats
    poses: dict[str, list[Pose]]


def ways(robots: int, times_s: Floats, seed: int, half: Floats = HALF) -> Floats:
    """Places and headings (robots, n, 3): straight on, and back where the ground ends, all over it."""
    rng = np.random.default_rng([seed, 21])
    out = np.empty((robots, len(times_s), 3))
    for robot in range(robots):
        angle = rng.uniform(0.0, 2.0 * np.pi)
        start = rng.uniform(-half, half)
        way = start + SPEED * times_s[:, None] * [np.cos(angle), np.sin(angle)]
        folded = np.abs((way + half) % (4.0 * half) - 2.0 * half) - half  # between the walls
        heading = rng.uniform(0, 2 * np.pi) + 0.5 * times_s * rng.uniform(0.6, 1.4)
        out[robot] = np.column_stack([folded, heading])
    return out


def upright(ground: Ground, way: Floats, lift_m: Floats | float = 0.0) -> list[Pose]:
    """T_world_robot of robots whose TOOL is at places and headings (n, 3), lifted along the normal."""
    heights, slopes = ground(way[:, :2])
    normals = np.column_stack([-slopes, np.ones(len(way))])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    ahead = np.column_stack([np.cos(way[:, 2]), np.sin(way[:, 2]), np.zeros(len(way))])
    ahead -= (ahead * normals).sum(axis=1, keepdims=True) * normals
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    turns = np.stack([ahead, np.cross(normals, ahead), normals], axis=-1)
    points = np.column_stack([way[:, :2], heights]) + np.reshape(lift_m, (-1, 1)) * normals
    return [Pose.from_matrix(turn, place) for turn, place in zip(turns, points - turns @ TOOL, strict=True)]


def drive(ground: Ground, seed: int = 0, robots: int = 5, seconds: float = 60.0, rate_hz: float = 20.0) -> Driven:
    """All robots on the ground for so long."""
    rig = replace(rig_on(robots=robots, seed=seed), surface=None)
    rig = replace(rig, robots=tuple(replace(robot, stands=None) for robot in rig.robots))
    times = np.arange(round(seconds * rate_hz)) / rate_hz
    moved = ways(robots, times, seed)
    poses = {robot.id: upright(ground, moved[k]) for k, robot in enumerate(rig.robots)}
    return Driven(rig, ground, times, poses)


def located(driven: Driven, seed: int, led_off_m: float = 0.0) -> Located:
    """What the chain makes of spots drawn with their noise, robots' LEDs off by chance by so much an axis."""
    rng, rig = np.random.default_rng([seed, 22]), driven.rig
    assert rig.T_world_camera is not None
    sights: list[Sight] = []
    turn = np.kron(np.eye(2), rig.T_world_camera.rotation)
    for robot in rig.robots:
        alone = replace(rig, robots=(robot,), T_world_camera=None)
        seen = [rig.T_world_camera.inverse() @ pose for pose in driven.poses[robot.id]]
        rotations, ts = np.array([p.rotation for p in seen]), np.array([p.position for p in seen])
        leds = robot.leds + led_off_m * rng.standard_normal((LEDS, 3))
        spots = spots_of(rig, robot, leds, rotations, ts).reshape(-1, LEDS, 2)
        points = np.einsum("nij,lj->nli", rotations, leds) + ts[:, None]
        normals = np.broadcast_to((rotations @ robot.T_robot_plane.rotation[:, 2])[:, None], points.shape)
        own, rounding = centre_covariances(points, normals, robot.led_radius or 0.0, rig.camera.focal_px, Look())
        told = ESTIMATOR_NOISE[rig.centre] ** 2 * (own + rounding)
        spots = spots + (np.linalg.cholesky(told) @ rng.standard_normal((*spots.shape, 1)))[..., 0]
        blank = [
            Sighting("", k, robot.id, LedCentres(spots[k], told[k]), seen[k], np.eye(6), None) for k in range(len(seen))
        ]
        for time_s, found in zip(driven.times_s, solve_sightings(alone, blank), strict=True):
            if found is not None:
                pose, covariance = found
                sights.append(Sight(robot.id, time_s, rig.T_world_camera @ pose, turn @ covariance @ turn.T, None))
    return Located.of(tuple(robot.id for robot in rig.robots), sights)


def touched(driven: Driven, found: Located, told: Uncertainty = TOLD) -> Contacts:
    """The touches by the tool."""
    standing = {robot.id: Standing("tool", led_shapes(robot, told.leds_of(robot.id))) for robot in driven.rig.robots}
    return contacts_of(driven.rig, found, standing)
