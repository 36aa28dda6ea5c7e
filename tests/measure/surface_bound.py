"""The least error that light and a surface allow together: Cramer-Rao, by numeric derivatives, beside the product.

Nothing here is shared with the solver: spots by differences of rendered images (tests/centres/bounds.py), how far a
point is from the surface and where the normal points by the quadric's own sum.
"""

from collections.abc import Callable

import numpy as np

from asterism.protocol.geometry import Floats, Pose, exp_rotation, log_rotation
from asterism.protocol.rig import Robot
from asterism.protocol.surface import Quadric, Surface
from asterism.server.simulation.simulate import Look, Scene
from tests.centres.bounds import centre_bound, pose_bound
from tests.measure.surface_cases import SIGMA_M, TILT_DEG, Case, Sighting
from tests.on_surface import TOOL

LEVELS = 0.04  # of brightness: spots within it share their bound
_CACHE: dict[tuple[object, ...], Floats] = {}


def bounds_of(case: Case, sighting: Sighting, robot: int) -> tuple[Floats, Floats]:
    """Covariances (6, 6) of the best possible pose in the world, by light alone and with the surface."""
    entry = sighting.rig.robots[robot]
    pose = sighting.truth[entry.id]
    light = light_bound(sighting, robot, case)
    by_surface = jacobian(lambda step: off_surface(case.surface, moved(pose, step)))
    sigmas = np.array([SIGMA_M, np.radians(TILT_DEG), np.radians(TILT_DEG)])
    weighted = by_surface / sigmas[:, None]
    return light, np.linalg.inv(np.linalg.inv(light) + weighted.T @ weighted)


def light_bound(sighting: Sighting, robot: int, case: Case) -> Floats:
    """Covariance (6, 6) of the best possible pose by light alone; LEDs that are off are noise of known size."""
    rig, entry = sighting.rig, sighting.rig.robots[robot]
    assert rig.T_world_camera is not None
    T_camera_world, pose = rig.T_world_camera.inverse(), sighting.truth[entry.id]
    lit = np.array(sighting.lit[entry.id])
    in_camera = T_camera_world @ pose
    covariances = np.array([
        spot_bound(sighting.scene, robot, in_camera, led, case.look) for led in np.flatnonzero(lit)
    ])  # fmt: skip

    def project(step: Floats) -> Floats:
        pixels: Floats = rig.camera.project((T_camera_world @ moved(pose, step)).map(entry.leds[lit]))
        return pixels

    if case.leds_off_m:
        covariances = covariances + case.leds_off_m**2 * _by_led(sighting, entry, in_camera)[lit]
    return pose_bound(project, np.zeros(6), covariances)


def spot_bound(scene: Scene, robot: int, in_camera: Pose, led: int, look: Look) -> Floats:
    """Covariance (2, 2) px^2 of the best possible centre of an LED's image, which is an ellipse to first order."""
    entry, f = scene.rig.robots[robot], scene.rig.camera.matrix[0, 0]
    at, normal = in_camera.map(entry.leds[led]), in_camera.rotation[:, 2]
    facing = abs(float(normal @ at)) / float(np.linalg.norm(at))
    u = (normal - at * normal[2] / at[2])[:2]  # the short axis lies along the normal's image
    a = (entry.led_radius or 0.0) * f / at[2]
    level = look.brightness * float(scene.led_brightness[robot, led]) * facing
    angle = round(np.degrees(np.arctan2(u[0], -u[1])) / 15) % 12
    key = (round(a * 20), round(a * facing * 20), angle, round(np.log(level) / LEVELS), look)
    if key not in _CACHE:
        wide = round(a * 20) / 20
        narrow = min(round(a * facing * 20) / 20, wide - 0.02)
        _CACHE[key] = centre_bound(
            wide, narrow, np.radians(15 * angle), np.exp(LEVELS * round(np.log(level) / LEVELS)), look.psf_px,
            read=look.read_noise, background=look.background,
        )  # fmt: skip
    return _CACHE[key]


def off_surface(surface: Surface, pose: Pose) -> Floats:
    """How far a robot's tool is from the surface along the normal, m, and its axis against the normal, rad (3,)."""
    in_frame = surface.T_world_surface.inverse() @ pose
    tool, axis = in_frame.map(TOOL), in_frame.rotation[:, 2]
    slope = _slope(surface, tool)
    normal = slope / np.linalg.norm(slope)
    across = np.cross(normal, [1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    return np.array([_sum(surface, tool) / np.linalg.norm(slope), axis @ across, axis @ np.cross(normal, across)])


def _sum(surface: Surface, point: Floats) -> float:
    shape = surface.shape
    assert isinstance(shape, Quadric)
    x, y, z = point - shape.about
    return float(shape.terms @ [1, x, y, z, x * x, y * y, z * z, x * y, x * z, y * z])


def _slope(surface: Surface, point: Floats) -> Floats:
    steps = 1e-5 * np.eye(3)
    return np.array([(_sum(surface, point + h) - _sum(surface, point - h)) / 2e-5 for h in steps])


def _by_led(sighting: Sighting, robot: Robot, in_camera: Pose) -> Floats:
    """What one sigma^2 of every LED's place makes of its spot (6, 2, 2), px^2 / m^2."""
    camera, h = sighting.rig.camera, 1e-6
    columns = [
        (camera.project(in_camera.map(robot.leds + step)) - camera.project(in_camera.map(robot.leds - step))) / (2 * h)
        for step in h * np.eye(3)
    ]
    by_led = np.stack(columns, axis=-1)
    squares: Floats = by_led @ np.swapaxes(by_led, 1, 2)
    return squares


def moved(pose: Pose, step: Floats) -> Pose:
    """A pose moved by (6,): its position, m, and turned about the world's axes, rad."""
    return Pose.from_matrix(exp_rotation(step[3:]) @ pose.rotation, pose.position + step[:3])


def error_of(found: Pose, true: Pose) -> Floats:
    """(6,) m and rad about the world's axes."""
    return np.concatenate([found.position - true.position, log_rotation(found.rotation @ true.rotation.T)])


def jacobian(values: Callable[[Floats], Floats]) -> Floats:
    """Derivatives (k, 6) of values (k,) by a small motion (6,)."""
    steps = 1e-6 * np.eye(6)
    return np.stack([(values(step) - values(-step)) / 2e-6 for step in steps], axis=-1)
