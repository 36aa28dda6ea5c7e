"""Rigs and spots with every source of error switched on by its own amount, and the chain's own solver on them."""

from dataclasses import dataclass, field, replace

import numpy as np

from asterism.protocol.camera import Camera
from asterism.protocol.geometry import Floats, Pose, log_rotation
from asterism.protocol.rig import Rig, Robot
from asterism.server.budget.budget import Poses
from asterism.server.budget.uncertainty import Uncertainty
from asterism.server.pose.lens import lens_of, undistort
from asterism.server.pose.matched import Constellations, Matched, Measured
from asterism.server.pose.planar import NO_SOLUTION
from asterism.server.pose.solve import Solutions, solve_robots
from asterism.server.pose.spot_shift import optics_of


@dataclass(frozen=True)
class Errors:
    """One draw of everything that a rig does not know."""

    leds: Floats = field(default_factory=lambda: np.zeros((6, 3)))  # m
    offset_m: float = 0.0  # apparent shift at 45 degrees
    focal: float = 0.0  # relative
    centre: Floats = field(default_factory=lambda: np.zeros(2))  # principal point, px
    distortion: float = 0.0  # relative

    @staticmethod
    def drawn(uncertainty: Uncertainty, rng: np.random.Generator) -> "Errors":
        """All of them at random."""
        return Errors(
            uncertainty.led_position_m * rng.standard_normal((6, 3)),
            uncertainty.offset_m * rng.standard_normal(),
            uncertainty.focal_relative * rng.standard_normal(),
            uncertainty.principal_point_px * rng.standard_normal(2),
            uncertainty.distortion_relative * rng.standard_normal(),
        )

    def camera(self, nominal: Camera) -> Camera:
        """The camera as it really is."""
        matrix = nominal.matrix * np.array([[1 + self.focal, 1, 1], [1, 1 + self.focal, 1], [1, 1, 1]])
        matrix[:2, 2] += self.centre
        return replace(nominal, matrix=matrix, distortion=nominal.distortion * (1 + self.distortion))

    def seen_leds(self, robot: Robot, pose: Pose) -> Floats:
        """Where the LEDs seem to be (6, 3) m in the robot's frame, at T_camera_robot: their real place, and the shift
        of their light, which a walk along the plate gives here and vectors of the line of sight in the product.
        """
        leds = robot.leds + self.leds
        eye = pose.inverse().position
        shifted = []
        for led in leds:
            sight = (eye - led) / np.linalg.norm(eye - led)
            sine = np.sin(np.arccos(np.clip(sight @ robot.axis, -1, 1)))
            aside = robot.axis - (robot.axis @ sight) * sight
            long = self.offset_m * (sine / np.sin(np.pi / 4)) ** 3
            shifted.append(led - long * aside / max(np.linalg.norm(aside), 1e-12))
        return np.array(shifted)


def spots(rig: Rig, robot: Robot, pose: Pose, errors: Errors) -> Floats:
    """Centres (6, 2) px of a robot's LEDs' images, discs as large as the rig says."""
    points = pose.map(errors.seen_leds(robot, pose))
    normal, radius2 = pose.rotation @ robot.T_robot_plane.rotation[:, 2], (robot.led_radius or 0.0) ** 2
    x, y, z = points.T
    per = z * z - radius2 * (1 - normal[2] ** 2)
    rays = np.column_stack([x * z + radius2 * normal[0] * normal[2], y * z + radius2 * normal[1] * normal[2]])
    return errors.camera(rig.camera).project(np.column_stack([rays / per[:, None], np.ones(6)]))


def solved(rig: Rig, robot: Robot, poses: Poses, centres: Floats, covariances: Floats) -> tuple[Floats, Floats]:
    """What the chain's solver makes of spots (n, 6, 2) px with covariances (n, 6, 2, 2) px^2: errors (n, 6), m and rad
    about the camera's axes, of the minimum next to the truth, nan where there is none; and its covariances (n, 6, 6)
    of the plane's origin.
    """
    n, lens = len(poses), lens_of(rig.camera)
    pixels = np.ascontiguousarray(centres.reshape(-1, 2))
    spread = covariances.reshape(-1, 2, 2)
    flat = np.column_stack([spread[:, 0, 0], spread[:, 0, 1], spread[:, 1, 1]])
    rays, ray_covariances = np.empty((6 * n, 2)), np.empty((6 * n, 3))
    undistort(lens, pixels, flat, rays, ray_covariances)
    T_robot_plane = robot.T_robot_plane
    true = [Pose.from_matrix(turn, t) for turn, t in zip(poses.rotations, poses.ts, strict=True)]
    starts = [pose @ T_robot_plane for pose in true]
    constellations = Constellations(robot.leds_plane[None].copy(), optics_of(robot)[None])
    rotations, ts = np.array([pose.rotation for pose in starts]), np.array([pose.position for pose in starts])
    matched = Matched(np.zeros(n, np.int64), np.arange(6 * n).reshape(n, 6), rotations, ts)
    told = Solutions.room(n)
    solve_robots(lens, constellations, matched, Measured(rays, ray_covariances, pixels), told)
    errors, chosen = np.full((n, 6), np.nan), np.zeros((n, 6, 6))
    for k in range(n):
        best = np.inf
        for which in range(2):
            if told.costs[k, which] >= NO_SOLUTION:
                continue
            found = Pose.from_matrix(told.rotations[k, which], told.ts[k, which]) @ T_robot_plane.inverse()
            turned = log_rotation(found.rotation @ true[k].rotation.T)
            if np.linalg.norm(turned) < best:
                best = float(np.linalg.norm(turned))
                errors[k] = np.concatenate([found.position - true[k].position, turned])
                chosen[k] = told.covariances[k, which]
    return errors, chosen
