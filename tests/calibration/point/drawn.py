"""Films of a robot that pivots about its tool, without images: spots drawn with the noise of their light, seen with a
rig that is off as its uncertainties have it.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.protocol.rig import Rig, Robot, load_rig
from asterism.server.budget.budget import Poses, offset_shifts
from asterism.server.budget.common_causes import common_causes, led_shapes
from asterism.server.budget.uncertainty import ESTIMATOR_NOISE, Uncertainty
from asterism.server.calibration.leds.labelled import solve_sightings
from asterism.server.calibration.leds.observations import LedCentres, Sighting
from asterism.server.calibration.lens.lens_error import assumed_lens_error
from asterism.server.calibration.lens.values import camera_of, values_of
from asterism.server.calibration.point.calibration import Known, PointCalibration, calibrate_point
from asterism.server.calibration.point.views import spots_of
from asterism.server.calibration.survey.world import without_world
from asterism.server.centres.centre_noise import centre_covariances
from asterism.server.pose.fit import LEDS
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.simulation.hand_film import PIVOT_SPIN, pivot_pose
from asterism.server.simulation.simulate import Look

ROBOT, POINT = "alpha", "tool"
EXACT = Uncertainty(
    led_position_m=0.0, offset_m=0.0, focal_relative=0.0, principal_point_px=0.0, distortion_relative=0.0
)
ASSUMED = Uncertainty()


class Drawn(NamedTuple):
    """A rig as a person has it, what truly is where, and what was seen of it."""

    rig: Rig
    true: Rig
    sightings: list[Sighting]


def demo() -> Rig:
    """The demonstration's first robot alone, and nothing known of the world."""
    rig = without_world(load_rig(DEMO_RIG))
    return replace(rig, robots=(rig.robot(ROBOT),))


def pivots(rig: Rig, frames: int, seed: int, spin: float = PIVOT_SPIN) -> list[Pose]:
    """T_camera_robot of a robot that pivots about its tool."""
    return [pivot_pose(rig, rig.robots[0], POINT, k, frames, seed, spin) for k in range(frames)]


def true_rig(rig: Rig, uncertainty: Uncertainty, rng: np.random.Generator) -> Rig:
    """What a rig may really be; its points stay where they are."""
    robot, camera = rig.robots[0], rig.camera
    lens = assumed_lens_error(
        camera, uncertainty.focal_relative, uncertainty.principal_point_px, uncertainty.distortion_relative, ""
    ).covariance
    values = values_of(camera) + rng.multivariate_normal(np.zeros(len(lens)), lens, method="svd")
    leds = robot.leds + uncertainty.led_position_m * rng.standard_normal((LEDS, 3))
    return replace(rig, camera=camera_of(camera, values), robots=(replace(robot, leds=leds),))


def drawn(rig: Rig, uncertainty: Uncertainty, poses: list[Pose], rng: np.random.Generator, noise: float = 1.0) -> Drawn:
    """Robot poses seen through a rig that is off by chance; ``noise`` is the share of the light's that spots have."""
    true = true_rig(rig, uncertainty, rng)
    robot = true.robots[0]
    stack = Poses(np.array([pose.rotation for pose in poses]), np.array([pose.position for pose in poses]))
    spots = spots_of(true, robot, robot.leds, stack.rotations, stack.ts).reshape(-1, LEDS, 2)
    points = np.einsum("nij,lj->nli", stack.rotations, robot.leds) + stack.ts[:, None]
    shifts = offset_shifts(robot, stack, uncertainty.offset_m * rng.standard_normal())
    spots += true.camera.project(points + shifts) - true.camera.project(points)
    normals = np.broadcast_to((stack.rotations @ robot.T_robot_plane.rotation[:, 2])[:, None], points.shape)
    own, rounding = centre_covariances(points, normals, robot.led_radius or 0.0, true.camera.focal_px, Look())
    told = ESTIMATOR_NOISE[rig.centre] ** 2 * (own + rounding)
    roots = np.linalg.cholesky(told)
    spots += noise * (roots @ rng.standard_normal((*points.shape[:2], 2, 1)))[..., 0]
    spots += uncertainty.bias_px * noise * rng.standard_normal(spots.shape)
    return Drawn(rig, true, seen_as(rig, spots, told, poses))


def seen_as(rig: Rig, spots: Floats, told: Floats, poses: list[Pose]) -> list[Sighting]:
    """Spots (n, 6, 2) px of the rig's one robot, with their covariances, as frames that were located."""
    name = rig.robots[0].id
    blank = [
        Sighting(f"{k:05d}.png", k, name, LedCentres(centres, spreads), pose, np.eye(6), None)
        for k, (centres, spreads, pose) in enumerate(zip(spots, told, poses, strict=True))
    ]
    located = zip(blank, solve_sightings(rig, blank), strict=True)
    return [replace(one, pose=found[0], covariance=found[1]) for one, found in located if found is not None]


def calibrated(film: Drawn, uncertainty: Uncertainty) -> PointCalibration:
    """The point as the command finds it, with what is told of the rig."""
    rig, robot = film.rig, film.rig.robots[0]
    lens = assumed_lens_error(
        rig.camera, uncertainty.focal_relative, uncertainty.principal_point_px, uncertainty.distortion_relative, ""
    ).covariance

    def causes(rotations: Floats, ts: Floats) -> Floats:
        return common_causes(rig, robot, Poses(rotations, ts), uncertainty, lens)

    known = Known(led_shapes(robot, uncertainty.leds_of(robot.id)), causes, uncertainty.bias_px)
    return calibrate_point(rig, robot.id, film.sightings, known, "film")


def touches(rig: Rig, count: int, resting: int, between: int, rng: np.random.Generator) -> list[Pose]:
    """A robot that touches one mark ``count`` times, from all sides, for so many frames each, and is lifted and moved
    in so many frames between.
    """
    robot, place = rig.robots[0], np.array([0.05, -0.03, 1.25])
    poses = []
    for k in range(count):
        lean = 2.0 * np.pi * k / count
        tilt = exp_rotation(np.radians(25.0) * np.array([np.cos(lean), np.sin(lean), 0.0]))
        for _ in range(resting):
            shake = exp_rotation(0.003 * rng.standard_normal(3))
            poses.append(tip_at(robot, place, shake @ tilt @ np.diag([1.0, -1.0, -1.0])))
        for j in range(between):
            away = exp_rotation(0.3 * rng.standard_normal(3)) @ tilt @ np.diag([1.0, -1.0, -1.0])
            up = 0.01 + 0.02 * np.sin(np.pi * (j + 0.5) / between)
            lifted = place - np.array([*(0.03 * rng.standard_normal(2)), up])
            poses.append(tip_at(robot, lifted, away))
    return poses


def tip_at(robot: Robot, place: Floats, facing: Floats) -> Pose:
    """T_camera_robot of a robot whose tool is at a place (3,) m, its plate turned so (3, 3)."""
    rotation = facing @ robot.T_robot_plane.rotation.T
    return Pose.from_matrix(rotation, place - rotation @ robot.points[POINT])
