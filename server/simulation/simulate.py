"""A simulated camera above a simulated surface: the rig's robots drive on it, and every pose is known.

Every LED is a disc, where the rig's `led.offset` says that it is seen, whose points are traced through the full camera
model; each point's light is spread by a Gaussian point spread over the areas of the pixels (differences of error
functions, exact), dimmed by the cosine of the viewing angle, then gets shot noise, read noise, clipping and rounding.
Nothing here is shared with the estimators.
Frames depend on the scene and their index alone, so any frame can be rendered on its own.
"""

import math
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.constellation import LEDS
from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig
from asterism.server.compiled import compiled
from asterism.server.pose.lens import lens_of, project_point
from asterism.server.simulation.drive import Drive
from asterism.server.simulation.ground import RigSurface
from asterism.server.simulation.table import as_driven, drives, table_of
from asterism.server.simulation.view import reach_of
from asterism.server.simulation.work import Lanes, Work

DEFAULT_LED_RADIUS = 0.0025  # m, where the rig does not say
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
    """The rig's robots on a curved surface before its camera, the rig's own where it has one; `table` says where.

    Raises InputError where the rig's surface has no room for them.
    """

    def __init__(self, rig: Rig, seed: int = 0, look: Look | None = None, work: Work | None = None) -> None:
        self.rig = rig
        self.seed = seed
        self.look = look or Look()
        self.lens = lens_of(rig.camera)
        self.reach = reach_of(rig.camera)
        self.line_s = 1e-6 * rig.capture.line_time_us
        self.table = table_of(rig)
        # On the common table it must not matter in which order a rig has its robots; its cameras have noise of their
        # own for the same seed.
        common = self.table.common
        driving = [k for k, robot in enumerate(rig.robots) if drives(rig, robot)]
        order = sorted(driving, key=lambda k: rig.robots[k].id) if common else driving
        self._own = (zlib.crc32(rig.camera.name.encode()),) if common else ()
        ground = None if rig.surface is None else RigSurface(rig.surface, self.table.middle)
        self._drive = Drive([as_driven(rig, rig.robots[k]) for k in order], seed, self.table.half, ground, work)
        self._driver = {k: number for number, k in enumerate(order)}
        self.led_brightness = np.ones((len(rig.robots), LEDS))
        self.led_brightness[order] = self._drive.led_brightness
        radius = max(robot.led_radius or DEFAULT_LED_RADIUS for robot in rig.robots)
        self._quadrature = quadrature(
            1.2 * radius * float(rig.camera.matrix[0, 0]) / self.table.distance, self.look.psf_px
        )

    @property
    def lanes(self) -> Lanes | None:
        """The lanes that its robots go over their parts in, if they do."""
        return self._drive.lanes

    def pose(self, index: int, time_s: float) -> Pose:
        """T_camera_robot of a robot at a time."""
        fixed, T_world_camera = self.rig.robots[index].T_world_fixed, self.rig.T_world_camera
        if fixed is not None and T_world_camera is not None:
            return T_world_camera.inverse() @ fixed
        return self.table.T_camera_table @ self._drive.pose(self._driver[index], time_s)

    def truth(self, index: int, time_s: float) -> list[Truth]:
        """Every robot in frame ``index``, taken at ``time_s``."""
        lit = self._rng(2, index).random((len(self.rig.robots), LEDS)) >= self.look.hidden
        return [self._truth(k, time_s, tuple(lit[k].tolist())) for k in range(len(lit))]

    def _truth(self, k: int, time_s: float, lit: tuple[bool, ...]) -> Truth:
        def after(later_s: float) -> Pose:
            return self.pose(k, time_s + later_s)

        return Truth(self.rig.robots[k].id, after(0.0), lit, after if self.line_s > 0.0 else None)

    def render(self, index: int, truth: list[Truth]) -> NDArray[np.uint8]:
        """The image (h, w) uint8 of frame ``index`` with the robots where ``truth`` says."""
        look, camera = self.look, self.rig.camera
        rng = self._rng(3, index)
        image = self._background(rng)
        light = np.zeros((64, 64))
        for k, entry in enumerate(truth):
            robot = self.rig.robots[k]
            radius = robot.led_radius or DEFAULT_LED_RADIUS
            for number in range(LEDS):
                led, axis, normal, facing = self._led(k, entry, number)
                if not entry.lit[number] or facing <= 0.0:
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

    def visible(self, k: int, entry: Truth) -> tuple[bool, ...]:
        """Which LEDs of robot ``k`` the image shows: those that are lit, shine to the camera and are in its view."""
        seen = []
        for number in range(LEDS):
            led, _, _, facing = self._led(k, entry, number)
            shown = entry.lit[number] and facing > 0.0
            if shown:
                x, y = project_point(self.lens, *led.tolist())
                shown = -0.5 <= x < self.rig.camera.width - 0.5 and -0.5 <= y < self.rig.camera.height - 0.5
            seen.append(shown)
        return tuple(seen)

    def _led(self, k: int, entry: Truth, number: int) -> tuple[Floats, Floats, Floats, float]:
        """Where an LED is, where it shines, and its plane's normal, (3,) each, in the camera's frame; and the cosine of
        the angle that it is seen from, 0 of one that the camera cannot see.
        """
        robot = self.rig.robots[k]
        pose = self._seen(entry, robot.leds[number])
        led, turn = pose.map(robot.leds[number]), pose.rotation
        axis, normal = turn @ robot.axis, turn @ robot.T_robot_plane.rotation[:, 2]
        facing = -float(axis @ led) / float(np.linalg.norm(led))
        in_reach = led[2] > 0.0 and math.hypot(led[0], led[1]) < 1.1 * self.reach * led[2]
        return led, axis, normal, facing if in_reach else 0.0

    def _rng(self, *what: int) -> np.random.Generator:
        return np.random.default_rng([self.seed, *what, *self._own])

    def _seen(self, entry: Truth, led: Floats) -> Pose:
        """T_camera_robot at the time at which one of the robot's LEDs (3,) is seen: that of its own row."""
        pose = entry.T_camera_robot
        if entry.after is None:
            return pose
        for _ in range(4):  # the row depends on the time: each round leaves a hundredth
            row = project_point(self.lens, *pose.map(led).tolist())[1]
            pose = entry.after((row - 0.5 * (self.rig.camera.height - 1)) * self.line_s)
        return pose

    @cached_property
    def _bank(self) -> NDArray[np.uint8]:
        camera = self.rig.camera
        rng = self._rng(4)
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
