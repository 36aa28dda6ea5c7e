"""A simulated camera above a simulated surface: the rig's robots drive on it, and every pose is known.

Every LED is a disc, where the rig's `led.offset` says that it is seen, whose points are traced through the full camera
model; each point's light is spread by a Gaussian point spread over the areas of the pixels (differences of error
functions, exact), dimmed by the cosine of the viewing angle, then gets shot noise, read noise, clipping and rounding.
Nothing here is shared with the estimators.
Frames depend on the scene and their index alone, so any frame can be rendered on its own.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig
from asterism.server.compiled import compiled
from asterism.server.pose.lens import lens_of, project_point

DEFAULT_LED_RADIUS = 0.0025  # m, where the rig does not say
CLEARANCE = 0.03  # m, of the LEDs above the surface
SPEED = 0.12  # m/s, of the robots
PATCH_SIGMAS = 5.0  # reach of a point's light
NOISE_BANK = 4  # frames of background noise that are drawn from


@dataclass(frozen=True, slots=True)
class Look:
    """What the simulated camera sees beside the robots, and how well."""

    psf_px: float = 0.8  # sigma of the point spread
    brightness: float = 170.0  # grey levels of an LED seen head-on, above the background
    background: float = 9.0  # grey levels
    read_noise: float = 1.2  # grey levels
    gain: float = 0.03  # grey levels of shot noise variance per grey level of light
    hidden: float = 0.0  # probability that an LED is hidden in a frame
    glints: int = 0  # bright spots and streaks that are no LEDs, a frame


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """Where a robot is in a frame: T_camera_robot, and which of its LEDs are lit; for a rolling shutter also where it
    is so many seconds ``after`` mid-frame.
    """

    robot: str
    T_camera_robot: Pose
    lit: tuple[bool, ...]
    after: Callable[[float], Pose] | None = None


class Scene:
    """The rig's robots on a curved surface in front of its camera."""

    def __init__(self, rig: Rig, seed: int = 0, look: Look | None = None) -> None:
        self.rig = rig
        self.seed = seed
        self.look = look or Look()
        self.lens = lens_of(rig.camera)
        self.line_s = 1e-6 * rig.capture.line_time_us
        self.T_camera_table, distance = _table(rig)
        rng = np.random.default_rng([seed, 1])
        n = len(rig.robots)
        camera = rig.camera
        largest = max(robot.extent for robot in rig.robots)
        # The part of the surface that is in view, shrunk so that whole robots stay in it.
        half_x = max(0.46 * camera.width / camera.matrix[0, 0] * distance - 0.6 * largest, 0.05)
        half_y = max(0.46 * camera.height / camera.matrix[1, 1] * distance - 0.6 * largest, 0.05)
        columns = max(1, min(n, round(math.sqrt(n * half_x / half_y))))
        rows = math.ceil(n / columns)
        cell_x, cell_y = 2 * half_x / columns, 2 * half_y / rows
        index = np.arange(n)
        self.centres = np.column_stack(
            [
                -half_x + (index % columns + 0.5) * cell_x,
                -half_y + (index // columns + 0.5) * cell_y,
            ]
        )
        room = max(0.5 * min(cell_x, cell_y) - 0.62 * largest, 0.0)
        self.swing = np.column_stack([np.full(n, room), room * rng.uniform(0.5, 1.0, n)])
        self.phase = rng.uniform(0, 2 * math.pi, (n, 3))
        self.pulse = SPEED / max(room, 0.02) * rng.uniform(0.6, 1.0, n)  # rad/s
        self.led_brightness = rng.uniform(0.88, 1.12, (n, 6))
        self.half_width = half_x
        radius = max(robot.led_radius or DEFAULT_LED_RADIUS for robot in rig.robots)
        self._quadrature = quadrature(1.2 * radius * float(camera.matrix[0, 0]) / distance, self.look.psf_px)
        self._bank = self._noise_bank()

    def surface(self, x: float, y: float) -> tuple[float, float, float]:
        """Height of the surface at (x, y) of the table, m, and its slopes: a free-form workpiece."""
        size = max(self.half_width, 0.1)
        rise = 0.16 * size
        k = 2.1 / size
        height = rise * math.cos(k * x) * math.cos(0.8 * k * y)
        slope_x = -rise * k * math.sin(k * x) * math.cos(0.8 * k * y)
        slope_y = -rise * 0.8 * k * math.cos(k * x) * math.sin(0.8 * k * y)
        return height, slope_x, slope_y

    def pose(self, index: int, time_s: float) -> Pose:
        """T_camera_robot of a robot at a time."""
        robot = self.rig.robots[index]
        a = self.phase[index, 0] + self.pulse[index] * time_s
        b = self.phase[index, 1] + 2.0 * self.pulse[index] * time_s
        x = float(self.centres[index, 0] + self.swing[index, 0] * math.sin(a))
        y = float(self.centres[index, 1] + 0.5 * self.swing[index, 1] * math.sin(b))
        height, slope_x, slope_y = self.surface(x, y)
        normal = np.array([-slope_x, -slope_y, 1.0]) / math.sqrt(1 + slope_x**2 + slope_y**2)
        heading = self.phase[index, 2] + 0.6 * math.sin(a) + 0.25 * self.pulse[index] * time_s
        forward = np.array([math.cos(heading), math.sin(heading), 0.0])
        forward -= (forward @ normal) * normal
        forward /= np.linalg.norm(forward)
        turn = np.column_stack([forward, np.cross(normal, forward), normal])
        T_table_plane = Pose.from_matrix(turn, np.array([x, y, height]) + CLEARANCE * normal)
        return self.T_camera_table @ T_table_plane @ robot.T_robot_plane.inverse()

    def truth(self, index: int, time_s: float) -> list[Truth]:
        """Every robot in frame ``index``, taken at ``time_s``."""
        rng = np.random.default_rng([self.seed, 2, index])
        lit = rng.random((len(self.rig.robots), 6)) >= self.look.hidden
        return [self._truth(k, time_s, tuple(lit[k].tolist())) for k in range(len(lit))]

    def _truth(self, k: int, time_s: float, lit: tuple[bool, ...]) -> Truth:
        def after(later_s: float) -> Pose:
            return self.pose(k, time_s + later_s)

        return Truth(self.rig.robots[k].id, after(0.0), lit, after if self.line_s > 0.0 else None)

    def render(self, index: int, truth: list[Truth]) -> NDArray[np.uint8]:
        """The image (h, w) uint8 of frame ``index`` with the robots where ``truth`` says."""
        look, camera = self.look, self.rig.camera
        rng = np.random.default_rng([self.seed, 3, index])
        image = self._background(rng)
        light = np.zeros((64, 64))
        for k, entry in enumerate(truth):
            robot = self.rig.robots[k]
            radius = robot.led_radius or DEFAULT_LED_RADIUS
            for number in range(len(robot.leds)):
                pose = self._seen(entry, robot.leds[number])
                led, turn = pose.map(robot.leds[number]), pose.rotation
                axis, normal = turn @ robot.axis, turn @ robot.T_robot_plane.rotation[:, 2]
                facing = -float(axis @ led) / float(np.linalg.norm(led))
                if not entry.lit[number] or facing <= 0.0 or led[2] <= 0.0:
                    continue
                seen = led
                if robot.led_offset is not None:
                    angle = np.array(np.arccos(min(facing, 1.0)))
                    seen = led + float(robot.led_offset.shift(angle, float(np.linalg.norm(led)))) * axis
                level = look.brightness * float(self.led_brightness[k, number]) * facing
                x0, y0, size_x, size_y = trace_disc(
                    self.lens, seen, normal, radius, look.psf_px, self._quadrature, light
                )
                patch = level * light[:size_y, :size_x]
                _expose(image, patch, x0, y0, look, rng)
        for _ in range(look.glints):
            patch, x0, y0 = _glint(rng, camera.width, camera.height, look.psf_px)
            _expose(image, patch, x0, y0, look, rng)
        return image

    def _seen(self, entry: Truth, led: Floats) -> Pose:
        """T_camera_robot at the time at which one of the robot's LEDs (3,) is seen: that of its own row."""
        pose = entry.T_camera_robot
        if entry.after is None:
            return pose
        for _ in range(4):  # the row depends on the time: each round leaves a hundredth
            row = project_point(self.lens, *pose.map(led).tolist())[1]
            pose = entry.after((row - 0.5 * (self.rig.camera.height - 1)) * self.line_s)
        return pose

    def _noise_bank(self) -> NDArray[np.uint8]:
        camera = self.rig.camera
        rng = np.random.default_rng([self.seed, 4])
        shape = (NOISE_BANK, camera.height, camera.width)
        noisy = rng.standard_normal(shape, dtype=np.float32) * self.look.read_noise + self.look.background
        bank: NDArray[np.uint8] = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
        return bank

    def _background(self, rng: np.random.Generator) -> NDArray[np.uint8]:
        """Background with read noise: drawing 1.3 million normal numbers a frame would take longer than the frame."""
        bank = self._bank[rng.integers(NOISE_BANK)]
        shift = int(rng.integers(bank.size))
        rolled: NDArray[np.uint8] = np.concatenate([bank.ravel()[shift:], bank.ravel()[:shift]]).reshape(bank.shape)
        return rolled


def _table(rig: Rig) -> tuple[Pose, float]:
    """T_camera_table and the camera's distance from it: the world's floor if the camera looks at it, or a table before
    the camera.
    """
    near, far = rig.range_m or (1.0, 1.5)
    middle = 0.5 * (near + far)
    if rig.T_world_camera is not None:
        view = rig.T_world_camera.rotation[:, 2]
        eye = rig.T_world_camera.position
        if view[2] < -0.3 and eye[2] > 0.05:
            distance = float(eye[2] / -view[2])
            T_world_table = Pose(eye + distance * view, np.array([0.0, 0.0, 0.0, 1.0]))
            return rig.T_world_camera.inverse() @ T_world_table, distance
    return Pose(np.array([0.0, 0.0, middle]), np.array([1.0, 0.0, 0.0, 0.0])), middle


def _expose(image: NDArray[np.uint8], patch: Floats, x0: int, y0: int, look: Look, rng: np.random.Generator) -> None:
    """Add light (expected grey levels) to the image at (x0, y0), with its shot noise, and round."""
    height, width = image.shape
    left, top = max(x0, 0), max(y0, 0)
    right, bottom = min(x0 + patch.shape[1], width), min(y0 + patch.shape[0], height)
    if left >= right or top >= bottom:
        return
    light = patch[top - y0 : bottom - y0, left - x0 : right - x0]
    under = image[top:bottom, left:right]
    # The background below is rounded already, which adds its variance of 1/12 where light falls on it.
    total = under + light + np.sqrt(look.gain * light) * rng.standard_normal(light.shape)
    image[top:bottom, left:right] = np.clip(np.rint(total), 0, 255).astype(np.uint8)


def _glint(rng: np.random.Generator, width: int, height: int, psf_px: float) -> tuple[Floats, int, int]:
    """A round spot or a streak somewhere in the image: expected grey levels, and the corner of the patch."""
    length = float(rng.choice([0.0, rng.uniform(3, 16)]))
    angle, radius = rng.uniform(0, math.pi), rng.uniform(0.4, 2.5)
    half = math.ceil(0.5 * length + radius + 4 * psf_px) + 1
    x, y = rng.uniform(0, width), rng.uniform(0, height)
    x0, y0 = int(x) - half, int(y) - half
    v, u = np.mgrid[0 : 2 * half + 1, 0 : 2 * half + 1]
    u, v = u + x0 - x, v + y0 - y
    along = np.clip(u * math.cos(angle) + v * math.sin(angle), -0.5 * length, 0.5 * length)
    away = np.hypot(u - along * math.cos(angle), v - along * math.sin(angle))
    soft = 0.5 * (1.0 - np.vectorize(math.erf)((away - radius) / (1.4142 * psf_px)))
    return rng.uniform(60, 240) * soft, x0, y0


class Quadrature(NamedTuple):
    """Where a disc is sampled: Gauss-Legendre ``nodes`` and ``weights`` (k,) on 0..1 over the squared radius, and so
    many even ``spokes``.
    """

    nodes: Floats
    weights: Floats
    spokes: int


@compiled
def trace_disc(lens, centre, normal, radius, psf, quadrature, light):
    """Image of a uniform disc, plateau 1, summed into ``light`` (h, w) from its corner on.

    ``centre`` (3,) and ``normal`` (3,) in the camera's frame, ``radius`` m, ``psf`` px, a `Quadrature` of it. Each
    point's light is the product of two differences of error functions, the exact integral of the Gaussian over the
    pixels. Returns x, y of the corner in the image and the patch's width and height.
    """
    # Two directions in the disc's plane.
    ax, ay, az = (0.0, -normal[2], normal[1]) if abs(normal[0]) < 0.7 else (-normal[1], normal[0], 0.0)
    length = math.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = ax / length, ay / length, az / length
    bx = normal[1] * az - normal[2] * ay
    by = normal[2] * ax - normal[0] * az
    bz = normal[0] * ay - normal[1] * ax
    cx, cy = project_point(lens, centre[0], centre[1], centre[2])
    # The disc's largest extent in the image, generously: its radius at the nearest depth it may have.
    reach = radius * max(lens[0], lens[1]) / max(centre[2] - radius, 0.1 * centre[2]) * 1.3 + PATCH_SIGMAS * psf + 1
    half = min(math.ceil(reach), (min(light.shape[0], light.shape[1]) - 1) // 2)
    x0, y0 = math.floor(cx + 0.5) - half, math.floor(cy + 0.5) - half
    size = 2 * half + 1
    light[:size, :size] = 0.0
    across, down = np.empty(size), np.empty(size)
    scale = 1.0 / (psf * math.sqrt(2.0))
    # The disc's area in the image, px^2: pixels count light in units of the plateau.
    h = 1e-6
    px, py = project_point(lens, centre[0] + h * ax, centre[1] + h * ay, centre[2] + h * az)
    qx, qy = project_point(lens, centre[0] + h * bx, centre[1] + h * by, centre[2] + h * bz)
    area = abs((px - cx) * (qy - cy) - (py - cy) * (qx - cx)) / (h * h) * math.pi * radius * radius
    nodes, weights, spokes = quadrature
    for ring in range(nodes.shape[0]):
        r = radius * math.sqrt(nodes[ring])
        share = area * weights[ring] / spokes
        for k in range(spokes):
            angle = 2.0 * math.pi * (k + 0.5 * (ring % 2)) / spokes
            u, v = r * math.cos(angle), r * math.sin(angle)
            depth = centre[2] + u * az + v * bz
            x, y = project_point(lens, centre[0] + u * ax + v * bx, centre[1] + u * ay + v * by, depth)
            # Radiance is the same all over the disc, so is the light on the image it covers: nearer parts cover more.
            covers = share * (centre[2] / depth) ** 3
            last = math.erf((x0 - 0.5 - x) * scale)
            for i in range(size):
                this = math.erf((x0 + i + 0.5 - x) * scale)
                across[i] = 0.5 * (this - last)
                last = this
            last = math.erf((y0 - 0.5 - y) * scale)
            for i in range(size):
                this = math.erf((y0 + i + 0.5 - y) * scale)
                down[i] = 0.5 * (this - last)
                last = this
            for i in range(size):
                for j in range(size):
                    light[i, j] += covers * down[i] * across[j]
    return x0, y0, size, size


def quadrature(radius_px: float, psf_px: float) -> Quadrature:
    """Nodes and weights over the squared radius and the number of spokes that integrate a disc to 0.02 %."""
    blurs = radius_px / psf_px
    nodes, weights = np.polynomial.legendre.leggauss(max(4, math.ceil(0.7 * blurs) + 2))
    return Quadrature(0.5 * (nodes + 1.0), 0.5 * weights, max(12, math.ceil(4.0 * blurs)))
