"""The error budget of a pose: what every source of error alone, and all together, do to it.

First order: a source with standard deviation 1 moves the six spots by the columns of its factor (12, k), px; weighted
least squares makes of that the pose change (J' W J)^-1 J' W factor. Random and systematic sources are independent, so
their covariances add up. Where a plate is seen nearly in front (tilt below LEAST_TILT) the rotations about x and y
depend on the spots to second order, and this says too much.

Source: propagation of covariance through the normal equations (e.g. Hartley, Zisserman: "Multiple View Geometry",
section 5.2).
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.constellation import LEDS
from asterism.protocol.geometry import Floats
from asterism.protocol.led_offset import knot_weights
from asterism.protocol.rig import Rig, Robot
from asterism.server.budget.standing import SURFACE_SOURCES, stand_sigmas, stands_by_pose, surface_sigmas
from asterism.server.budget.uncertainty import ESTIMATOR_NOISE, LedError, Uncertainty
from asterism.server.centres.centre_noise import centre_covariances
from asterism.server.pose.lens import lens_of, undistort
from asterism.server.pose.matched import LEAST_SIGMA_PX
from asterism.server.simulation.simulate import DEFAULT_LED_RADIUS, Look

SOURCES = (
    "centre noise",
    "quantisation",
    "centre bias",
    "LED positions",
    "LED angular offset",
    "focal length",
    "principal point",
    "distortion",
)
COMPONENTS = ("x", "y", "z", "rx", "ry", "rz")  # m and rad, of the robot's origin and about the camera's axes
LEAST_TILT = 15.0  # degrees: from here on first order holds for the rotations about x and y
TILTS = (15.0, 30.0, 45.0, 60.0)
AZIMUTHS = 6
GOLDEN = 2.399963  # rad, the golden angle: turns of the robot that repeat no direction
STEP = 1e-5  # relative, of numeric derivatives


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """n poses T_camera_robot: ``rotations`` (n, 3, 3), ``ts`` (n, 3) m."""

    rotations: Floats
    ts: Floats

    def __len__(self) -> int:
        return len(self.ts)


@dataclass(frozen=True, slots=True, eq=False)
class Light:
    """What spots look like: ``look``, and how much larger the variance of centres is than at the bound, which is
    ``measured`` where frames told it.
    """

    look: Look
    factor: float
    measured: bool = False

    @staticmethod
    def assumed(centre: str) -> "Light":
        """The simulator's light, and what an estimator of centres makes of it."""
        return Light(Look(), ESTIMATOR_NOISE[centre] ** 2)


def sources_of(rig: Rig) -> tuple[str, ...]:
    """SOURCES, and of a rig whose robots stand on a surface those of that."""
    stands = rig.surface is not None and any(robot.stands is not None for robot in rig.robots)
    return (*SOURCES, *SURFACE_SOURCES) if stands else SOURCES


def image_by_pose(rig: Rig, robot: Robot, poses: Poses) -> tuple[Floats, Floats]:
    """Derivatives of the six spots, px, by the LEDs' places in the camera's frame (n, 6, 2, 3), px/m, and by the pose
    (n, 12, 6): translation, then rotation about the camera's axes.
    """
    arms = np.einsum("nij,lj->nli", poses.rotations, robot.leds)
    points = arms + poses.ts[:, None]
    steps = STEP * points[..., 2, None] * np.eye(3)[:, None, None]  # (3, n, 6, 3)
    by_point = (rig.camera.project(points + steps) - rig.camera.project(points - steps)) / (
        2.0 * STEP * points[..., 2, None]
    )
    by_point = np.moveaxis(by_point, 0, -1)
    a, b, c = arms[..., 0], arms[..., 1], arms[..., 2]
    zero = np.zeros_like(a)
    # d(w x arm)/dw = -[arm]x
    turn = np.stack([zero, c, -b, -c, zero, a, b, -a, zero], axis=-1).reshape(*a.shape, 3, 3)
    return by_point, np.concatenate([by_point, by_point @ turn], axis=-1).reshape(len(poses), 2 * LEDS, 6)


def image_factors(
    rig: Rig, robot: Robot, poses: Poses, uncertainty: Uncertainty, light: Light, by_point: Floats
) -> dict[str, Floats]:
    """For every source its factor (n, 12, k): how the spots move, px, for one standard deviation of each of its k
    independent causes.
    """
    camera, n = rig.camera, len(poses)
    points = np.einsum("nij,lj->nli", poses.rotations, robot.leds) + poses.ts[:, None]
    pixels = camera.project(points)
    noise, rounding = _centre_noise(rig, robot, poses, points, uncertainty, light)
    by_led = by_point @ poses.rotations[:, None]  # px per m in the robot's frame
    positions = np.zeros((n, LEDS, 2, LEDS, 3))
    for led in range(LEDS):
        positions[:, led, :, led] = by_led[:, led]
    leds = uncertainty.leds_of(robot.id)
    steps = [replace(camera, distortion=camera.distortion * (1.0 + sign * STEP)).project(points) for sign in (1, -1)]
    bent = (steps[0] - steps[1]) / (2.0 * STEP)
    point = np.broadcast_to(np.eye(2), (n, LEDS, 2, 2)).reshape(n, 2 * LEDS, 2)
    bias = [np.broadcast_to(uncertainty.bias_px * np.eye(2 * LEDS), (n, 2 * LEDS, 2 * LEDS))]
    if robot.led_radius is None:  # the solver then takes LEDs for points
        bias.append(_eccentricity(robot, poses, points, by_point).reshape(n, 2 * LEDS, 1))
    return {
        "centre noise": _blocks(noise),
        "quantisation": _blocks(rounding),
        "centre bias": np.concatenate(bias, axis=-1),
        "LED positions": _led_causes(positions, by_led @ (robot.leds - robot.leds.mean(axis=0))[:, :, None], leds),
        "LED angular offset": _offset_causes(robot, poses, points, uncertainty, by_point),
        "focal length": uncertainty.focal_relative * (pixels - camera.matrix[:2, 2]).reshape(n, 2 * LEDS, 1),
        "principal point": uncertainty.principal_point_px * point,
        "distortion": uncertainty.distortion_relative * bent.reshape(n, 2 * LEDS, 1),
    }


def _led_causes(positions: Floats, larger: Floats, leds: LedError) -> Floats:
    """Factor of the LEDs' places: each alone, and where the size of all is not sure, all together; px per m
    (n, 6, 2, 6, 3), and px of a constellation twice as large (n, 6, 2, 1).
    """
    each = leds.position_m * positions.reshape(len(positions), 2 * LEDS, 3 * LEDS)
    if leds.size_relative == 0.0:
        return each
    return np.concatenate([each, leds.size_relative * larger.reshape(len(positions), 2 * LEDS, 1)], axis=-1)


def _offset_causes(robot: Robot, poses: Poses, points: Floats, uncertainty: Uncertainty, by_point: Floats) -> Floats:
    """Factor of the LEDs' own light (n, 12, k): what its led.yaml leaves open, or what is given or assumed."""
    offset = robot.led_offset
    if offset is None or not len(offset.doubts) or "offset_m" in uncertainty.given:
        shifts = offset_shifts(robot, poses, uncertainty.offset_m)[..., None]
    else:
        axes = np.broadcast_to((poses.rotations @ robot.axis)[:, None], points.shape)
        facing = -np.einsum("nli,nli->nl", points, axes) / np.linalg.norm(points, axis=-1)
        angles = np.arccos(np.clip(facing, -1.0, 1.0))
        doubts = knot_weights(angles, offset.up_to_rad, len(offset.values)) @ offset.doubts.T
        shifts = axes[..., None] * doubts[:, :, None]
    factor: Floats = np.einsum("nlij,nljk->nlik", by_point, shifts).reshape(len(poses), 2 * LEDS, -1)
    return factor


def offset_shifts(robot: Robot, poses: Poses, offset_m: float) -> Floats:
    """Where LEDs seem to be beside where they are (n, 6, 3), m in the camera's frame: along the plate, away from the
    line of sight, by ``offset_m`` at 45 degrees and the cube of the sine elsewhere (findings/algorithms.md, E: what is
    left when the part that shifts all LEDs along the plate's normal is in their positions).
    """
    points = np.einsum("nij,lj->nli", poses.rotations, robot.leds) + poses.ts[:, None]
    sight = -points / np.linalg.norm(points, axis=-1, keepdims=True)
    axis = np.broadcast_to((poses.rotations @ robot.axis)[:, None], sight.shape)
    aside = axis - np.einsum("nli,nli->nl", axis, sight)[..., None] * sight
    sine2 = np.einsum("nli,nli->nl", aside, aside)[..., None]
    shifts: Floats = -offset_m * aside * sine2 * 2.0**1.5
    return shifts


def pose_by_image(by_pose: Floats, covariances: Floats, seen: Floats, beyond: Floats) -> Floats:
    """(n, 6, 12): the pose's change for a change of the spots, by weighted least squares as the solver does it.

    ``covariances`` (n, 6, 2, 2) px^2 are what the solver is told of the spots, ``seen`` (n, 6) 1 or 0, ``beyond`` (n,)
    px^2 the variance that it finds in the residuals beyond that and adds to every spot.
    """
    across = _weighted(by_pose, covariances, seen, beyond).transpose(0, 2, 1)
    return np.linalg.solve(across @ by_pose, across).astype(np.float64, copy=False)


def _weighted(by_pose: Floats, covariances: Floats, seen: Floats, beyond: Floats) -> Floats:
    """W J (n, 12, 6)."""
    n = len(by_pose)
    least = (LEAST_SIGMA_PX**2 + beyond)[:, None, None, None]
    weights = np.linalg.inv(covariances + least * np.eye(2)) * seen[:, :, None, None]
    weighted: Floats = np.einsum("nlij,nlik->nljk", weights, by_pose.reshape(n, LEDS, 2, 6)).reshape(n, 2 * LEDS, 6)
    return weighted


def covariances_of(
    rig: Rig, robot: Robot, poses: Poses, uncertainty: Uncertainty, light: Light, seen: Floats | None = None
) -> Floats:
    """Covariance (n, sources, 6, 6) of a robot's poses from every source alone, in the order of `sources_of`, m and
    rad.

    ``seen`` (n, 6): 1 where an LED is seen, 0 where not; all where it is left out. Their sum is the whole budget.
    """
    seen = np.ones((len(poses), LEDS)) if seen is None else seen
    by_point, by_pose = image_by_pose(rig, robot, poses)
    factors = image_factors(rig, robot, poses, uncertainty, light, by_point)
    own = factors["centre noise"] @ factors["centre noise"].transpose(0, 2, 1)
    own = own + factors["quantisation"] @ factors["quantisation"].transpose(0, 2, 1)
    own = own.reshape(-1, LEDS, 2, LEDS, 2)[:, range(LEDS), :, range(LEDS), :].transpose(1, 0, 2, 3)
    to_pose = pose_by_image(by_pose, own, seen, np.zeros(len(poses)))
    # What does not look like a motion of the robot stays in the residuals, for the solver to see.
    left = (np.eye(2 * LEDS) - by_pose @ to_pose) * np.repeat(seen, 2, axis=1)[:, :, None]
    squares = sum(
        np.square(left @ (factors[name] * np.repeat(seen, 2, axis=1)[:, :, None])).sum(axis=(1, 2))
        for name in SOURCES[2:]
    )
    across = _weighted(by_pose, own, seen, squares / np.maximum(2.0 * seen.sum(axis=1) - 6.0, 2.0)).transpose(0, 2, 1)
    normal, on_surface = across @ by_pose, []
    if rig.surface is not None and robot.stands is not None:
        by_stand, sigmas = stands_by_pose(robot, poses.rotations), (surface_sigmas(rig), stand_sigmas(robot))
        pulled = by_stand.transpose(0, 2, 1) / (sigmas[0] ** 2 + sigmas[1] ** 2)
        normal = normal + pulled @ by_stand
        told = np.isfinite(sigmas[1])
        on_surface = [np.linalg.solve(normal, pulled * np.where(told, each, 0.0)) for each in sigmas]
    moved_by = np.linalg.solve(normal, across)
    moved = [moved_by @ factors[name] for name in SOURCES] + on_surface
    moved += [np.zeros((len(poses), 6, 1))] * (len(sources_of(rig)) - len(moved))  # of a robot that stands on nothing
    return np.stack([change @ change.transpose(0, 2, 1) for change in moved], axis=1)


def _centre_noise(
    rig: Rig, robot: Robot, poses: Poses, points: Floats, uncertainty: Uncertainty, light: Light
) -> tuple[Floats, Floats]:
    """Covariances (n, 6, 2, 2) px^2 of the spots from noise, and what rounding to grey levels adds."""
    if uncertainty.centre_px is not None:
        whole = np.broadcast_to(uncertainty.centre_px**2 * np.eye(2), (*points.shape[:2], 2, 2))
        return whole, np.zeros_like(whole)
    normals = np.broadcast_to((poses.rotations @ robot.T_robot_plane.rotation[:, 2])[:, None], points.shape)
    radius = robot.led_radius or DEFAULT_LED_RADIUS
    noise, rounding = centre_covariances(points, normals, radius, rig.camera.focal_px, light.look)
    return light.factor * noise, light.factor * rounding


def _eccentricity(robot: Robot, poses: Poses, points: Floats, by_point: Floats) -> Floats:
    """How far the centre of a disc's image is from the image of its centre (n, 6, 2), px, to first order: `spot_shift`
    has the source.
    """
    normals = (poses.rotations @ robot.T_robot_plane.rotation[:, 2])[:, None]
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    nx, ny, nz = normals[..., 0], normals[..., 1], normals[..., 2]
    sine2 = 1.0 - nz * nz
    per_area = DEFAULT_LED_RADIUS**2 / (z * z - DEFAULT_LED_RADIUS**2 * sine2)
    shift = np.stack([per_area * (nx * nz * z + x * sine2), per_area * (ny * nz * z + y * sine2)], axis=-1)
    moved: Floats = np.einsum("nlij,nlj->nli", by_point[..., :2], shift)
    return moved


def _blocks(covariances: Floats) -> Floats:
    """Square root (n, 12, 12) of the block-diagonal covariance of six spots (n, 6, 2, 2)."""
    values, vectors = np.linalg.eigh(covariances)
    roots = vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]
    whole = np.zeros((len(covariances), LEDS, 2, LEDS, 2))
    for led in range(LEDS):
        whole[:, led, :, led] = roots[:, led]
    return whole.reshape(-1, 2 * LEDS, 2 * LEDS)


def poses_at(
    rig: Rig, robot: Robot, distance: float, places: Floats, tilts: tuple[float, ...]
) -> tuple[Poses, NDArray[np.intp]]:
    """Poses of a robot whose LEDs' middle is at a ``distance`` along the optical axis, m, and seen at ``places`` (p, 2)
    px: for each of them, each tilt (degrees) against the line of sight and AZIMUTHS directions of it.

    Returns the poses and the place each is at (n,); places that no ray of the lens reaches are left out.
    """
    rays, spare = np.empty((len(places), 2)), np.empty((len(places), 3))
    undistort(lens_of(rig.camera), np.ascontiguousarray(places), np.zeros((len(places), 3)), rays, spare)
    reached = np.flatnonzero(np.isfinite(rays[:, 0]))
    azimuths = 2.0 * np.pi * (np.arange(AZIMUTHS) + 0.5) / AZIMUTHS
    at, tilt, azimuth = (grid.ravel() for grid in np.meshgrid(reached, np.radians(tilts), azimuths, indexing="ij"))
    centres = distance * np.column_stack([rays[at], np.ones(len(at))])
    sight = centres / np.linalg.norm(centres, axis=1, keepdims=True)
    right = np.cross([0.0, 1.0, 0.0], sight)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    leaning = np.cos(azimuth)[:, None] * right + np.sin(azimuth)[:, None] * np.cross(sight, right)
    up = np.sin(tilt)[:, None] * leaning - np.cos(tilt)[:, None] * sight
    first = np.cross(np.cross(sight, leaning), up)
    turn = GOLDEN * np.arange(len(at))[:, None]
    x = np.cos(turn) * first + np.sin(turn) * np.cross(up, first)
    rotations = np.stack([x, np.cross(up, x), up], axis=-1) @ robot.T_robot_plane.rotation.T
    return Poses(rotations, centres - rotations @ robot.leds.mean(axis=0)), at.astype(np.intp)
