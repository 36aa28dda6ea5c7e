"""Sightings without pictures: spots where LEDs truly are, with drawn noise, and what the cameras say of them."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import set_report_pose
from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.server.fusing.fleet import View
from asterism.server.fusing.sighting import Sighting
from asterism.server.pose.lens import undistort
from tests.helpers import conic_centres

SIGMA_PX = 0.02


@dataclass(frozen=True)
class Seen:
    """How a camera sees: where it truly stands, by how much LEDs are truly elsewhere, (6, 3) m by the robots' ids, the
    noise of its spots, and which LEDs it sees.
    """

    T_world_camera: Pose | None = None
    led_errors: Mapping[str, Floats] = field(default_factory=dict)
    sigma_px: float = SIGMA_PX
    lit: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    misfit_m: float = 0.0


def sighting(
    view: View, poses: Mapping[str, Pose], exposed_ns: int, rng: np.random.Generator, seen: Seen | None = None
) -> Sighting:
    """What a camera shows of robots at T_world_robot; it knows whose its spots are, and its own poses are near."""
    seen = seen or Seen()
    rig, rays, owners = view.rig, [np.zeros((0, 2))], []
    T_camera_world = (seen.T_world_camera or view.T_world_camera).inverse()
    told = {robot.id: pb.RobotReport(id=robot.id, state=pb.State.Value("LOST")) for robot in rig.robots}
    for k, robot in enumerate(rig.robots):
        leds = list(seen.lit.get(robot.id, range(6))) if robot.id in poses else []
        if not leds:
            continue
        T = T_camera_world @ poses[robot.id]
        points = robot.leds + seen.led_errors.get(robot.id, 0.0)
        T_camera_plane = T @ robot.T_robot_plane
        places = robot.T_robot_plane.inverse().map(points)
        shown = T_camera_plane.map(places)
        shift = conic_centres(T_camera_plane, robot.leds_plane * [1, 1, 0], robot.led_radius or 0.0)
        middle = T_camera_plane.map(robot.leds_plane)
        rays.append((shown[:, :2] / shown[:, 2:] + shift - middle[:, :2] / middle[:, 2:])[leds])
        owners += [(k, led) for led in leds]
        _tell(told[robot.id], poses[robot.id], len(leds), rng)
    ideal = np.concatenate(rays)
    pixels = rig.camera.project(np.column_stack([ideal, np.ones(len(ideal))]))
    pixels = pixels + seen.sigma_px * rng.normal(size=pixels.shape)
    covariances = np.tile([seen.sigma_px**2, 0.0, seen.sigma_px**2], (len(pixels), 1))
    found, spreads = np.empty_like(pixels), np.empty_like(covariances)
    undistort(view.lens, pixels, covariances, found, spreads)
    whose = np.array(owners, np.int64).reshape(-1, 2)
    return Sighting(
        view=view,
        exposed_ns=exposed_ns,
        session=1,
        sequence=0,
        T_world_camera=view.T_world_camera,
        place_covariance=view.place_covariance,
        centres_px=pixels,
        covariances_px2=covariances,
        rays=found,
        ray_covariances=spreads,
        robots=whose[:, 0].copy(),
        leds=whose[:, 1].copy(),
        told=told,
        misfits_m=dict.fromkeys(told, seen.misfit_m),
    )


def _tell(report: "pb.RobotReport", pose: Pose, leds: int, rng: np.random.Generator) -> None:
    turn = exp_rotation(0.01 * rng.normal(size=3))
    set_report_pose(report.pose, Pose.from_matrix(turn @ pose.rotation, pose.position + 1e-3 * rng.normal(size=3)))
    report.state = pb.State.Value("TRACKED")
    report.covariance.extend(np.diag([1e-6] * 3 + [1e-4] * 3).ravel().tolist())
    report.leds, report.rms_px = leds, 0.02


def moved_world(view: View, T: Pose) -> View:
    """The same camera in a world whose origin is elsewhere: T maps points of the old world into the new one."""
    both = np.kron(np.eye(2), T.rotation)
    place = T @ view.T_world_camera
    return View(replace(view.rig, T_world_camera=place), both @ view.place_covariance @ both.T)
