"""Where spots should be by what is believed of cameras, clocks, LEDs and motion, and how they move with each."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from asterism.protocol.camera import Camera
from asterism.protocol.constellation import LEDS
from asterism.protocol.geometry import Floats
from asterism.protocol.rig import Robot
from asterism.server.calibration.cameras.moments import Moments
from asterism.server.calibration.cameras.motion import UNKNOWNS, Motion, exp_rotations
from asterism.server.calibration.lens.values import camera_of, pixels_by_lens, values_of
from asterism.server.pose.place import turning
from asterism.server.pose.spot_shift import optics_of, spots_at

RAY_STEP = 1e-6  # of a numeric derivative
BEHIND = 0.01  # m: nearer than this nothing is predicted


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """``rotations`` (c, 3, 3) and ``places`` (c, 3) T_0_c of every camera; ``clocks`` (c, 2), by how much they are
    ahead of the first's, s, and gain, s/s, about ``at_s``; ``leds`` (r, 6, 3) how far LEDs are from where the rig has
    them, m, in the robot's frame; the ``lenses``; and the robots' ``motion``.
    """

    rotations: Floats
    places: Floats
    clocks: Floats
    at_s: float
    leds: Floats
    lenses: tuple[Camera, ...]
    motion: Motion

    def true_times(self, moments: Moments) -> Floats:
        """The spots' times (g, n) by the first camera's clock."""
        offset, drift = np.moveaxis(self.clocks[moments.cameras], -1, 0)
        return np.asarray(moments.times_s - offset - drift * (moments.times_s - self.at_s), np.float64)

    def moved(self, layout: "Layout", shared: Floats, moves: Floats) -> "Belief":
        """Changed by the numbers (p,) that moments share, as `Layout` orders them, and by those of each (g, 18)."""
        cameras = layout.cameras
        step = np.zeros((cameras, 6))
        step[1:] = shared[layout.of_places].reshape(-1, 6)
        clocks = self.clocks.copy()
        clocks[1:] += shared[layout.of_clocks].reshape(-1, 2)
        lenses = self.lenses
        if layout.lens_widths:
            changes = np.split(shared[layout.of_lenses], np.cumsum(layout.lens_widths)[:-1])
            lenses = tuple(camera_of(lens, values_of(lens) + by) for lens, by in zip(lenses, changes, strict=True))
        return replace(
            self,
            rotations=exp_rotations(step[:, 3:]) @ self.rotations,
            places=self.places + step[:, :3],
            clocks=clocks,
            leds=self.leds + shared[layout.of_leds].reshape(-1, LEDS, 3),
            lenses=lenses,
            motion=self.motion.moved(moves),
        )


@dataclass(frozen=True, slots=True)
class Layout:
    """The order of the numbers that moments share: places of all cameras but the first (shift m, rotation rad, about
    the first camera's axes), their clocks (s, s/s), lenses where they are asked for, LEDs.
    """

    cameras: int
    robots: int
    lens_widths: tuple[int, ...] = ()

    @property
    def of_places(self) -> slice:
        """Six of every camera but the first."""
        return slice(0, 6 * (self.cameras - 1))

    @property
    def of_clocks(self) -> slice:
        """Two of every camera but the first."""
        return slice(6 * (self.cameras - 1), 8 * (self.cameras - 1))

    @property
    def of_lenses(self) -> slice:
        """Each camera's in its turn."""
        return slice(8 * (self.cameras - 1), self.shared)

    @property
    def of_leds(self) -> slice:
        """Eighteen of every robot."""
        return slice(self.shared, self.width)

    @property
    def shared(self) -> int:
        """How many there are but for the LEDs."""
        return 8 * (self.cameras - 1) + sum(self.lens_widths)

    @property
    def width(self) -> int:
        """How many there are."""
        return self.shared + 3 * LEDS * self.robots

    def of_robot(self, robot: int) -> slice:
        """Of one robot's LEDs."""
        first = self.shared + 3 * LEDS * robot
        return slice(first, first + 3 * LEDS)


class Predictor:
    """Predicts the spots of moments; ``robots`` in the order of their numbers."""

    def __init__(self, robots: Sequence[Robot], moments: Moments) -> None:
        self.moments = moments
        self._leds = np.array([robot.leds for robot in robots])
        self._layouts = np.array([robot.leds_plane for robot in robots])
        self._planes = [robot.T_robot_plane for robot in robots]
        self._optics = np.array([optics_of(robot) for robot in robots])
        self._rows = [np.nonzero(moments.cameras == c) for c in range(int(moments.cameras.max()) + 1)]

    def residuals(self, belief: Belief) -> Floats:
        """Spots less where they are predicted (g, n, 2), px; infinite behind the camera."""
        in_camera = self._points(belief)[1]
        rays = in_camera[..., :2] / np.maximum(in_camera[..., 2:], BEHIND) + self._shifts(belief)
        off = self.moments.pixels - self._pixels(belief, rays)
        return np.where(in_camera[..., 2:] > BEHIND, off, np.inf)

    def linearised(self, belief: Belief, layout: Layout) -> tuple[Floats, Floats]:
        """Derivatives (g, n, 2, 18 + q + 18) of the predicted spots by the moment's motion, by what all moments share
        but for the LEDs, in the layout's order, and by the robot's LEDs; and the residuals (g, n, 2).
        """
        moments = self.moments
        arms, in_camera, s, vectors, turns = self._points(belief)
        shifts = self._shifts(belief)
        rays = in_camera[..., :2] / in_camera[..., 2:] + shifts
        by_ray = np.stack(
            [
                (self._pixels(belief, rays + step) - self._pixels(belief, rays - step)) / (2.0 * RAY_STEP)
                for step in RAY_STEP * np.eye(2)
            ],
            axis=-1,
        )
        back = np.swapaxes(belief.rotations, 1, 2)[moments.cameras]
        by_point = by_ray @ _ray_by_point(in_camera) @ back  # in the first camera's frame
        by_motion, rates = belief.motion.derivatives(s, arms, vectors)
        g, n = moments.cameras.shape
        q = layout.shared
        out = np.zeros((g, n, 2, UNKNOWNS + q + 3 * LEDS))
        out[..., :UNKNOWNS] = (by_point @ by_motion) * belief.motion.used()[:, None, None, :]
        from_camera = arms + belief.motion.at(belief.true_times(moments))[1] - belief.places[moments.cameras]
        by_place = -np.concatenate([by_point, by_point @ turning(from_camera)], axis=-1)
        by_time = -(by_point @ rates[..., None])[..., 0]
        by_clock = np.stack([by_time, by_time * (moments.times_s - belief.at_s)[..., None]], axis=-1)
        for c, (rows, spots) in enumerate(self._rows):
            if c > 0:
                first = UNKNOWNS + 6 * (c - 1)
                out[rows, spots, :, first : first + 6] = by_place[rows, spots]
                first = UNKNOWNS + layout.of_clocks.start + 2 * (c - 1)
                out[rows, spots, :, first : first + 2] = by_clock[rows, spots]
            if layout.lens_widths:
                first = UNKNOWNS + layout.of_lenses.start + sum(layout.lens_widths[:c])
                points = np.concatenate([rays[rows, spots], np.ones((len(rows), 1))], axis=-1)
                out[rows, spots, :, first : first + layout.lens_widths[c]] = pixels_by_lens(belief.lenses[c], points)
        by_led = by_point @ turns
        for led in range(LEDS):
            first = UNKNOWNS + q + 3 * led
            out[:, led::LEDS, :, first : first + 3] = by_led[:, led::LEDS]
        return out, moments.pixels - self._pixels(belief, rays)

    def _points(self, belief: Belief) -> tuple[Floats, Floats, Floats, Floats, Floats]:
        """Of every spot the LED from the robot's origin, about the first camera's axes, the LED in its camera's frame,
        its share of the moment, rotation vector and the robot's rotation.
        """
        moments = self.moments
        n = moments.cameras.shape[1]
        s, places, turns, vectors = belief.motion.at(belief.true_times(moments))
        leds = np.tile((self._leds + belief.leds)[moments.robots], (1, n // LEDS, 1))
        arms = (turns @ leds[..., None])[..., 0]
        away = arms + places - belief.places[moments.cameras]
        in_camera = (np.swapaxes(belief.rotations, 1, 2)[moments.cameras] @ away[..., None])[..., 0]
        return arms, in_camera, s, vectors, turns

    def _pixels(self, belief: Belief, rays: Floats) -> Floats:
        out = np.empty(rays.shape)
        for c, rows in enumerate(self._rows):
            points = np.concatenate([rays[rows], np.ones((len(rows[0]), 1))], axis=-1)
            out[rows] = belief.lenses[c].project(points)
        return out

    def _shifts(self, belief: Belief) -> Floats:
        """How far spots are from the images of their LEDs (g, n, 2), rays, where the robot is at its frame's time."""
        moments = self.moments
        g, n = moments.cameras.shape
        times, cameras = belief.true_times(moments)[:, ::LEDS], moments.cameras[:, ::LEDS]
        _, places, turns, _ = belief.motion.at(times)
        planes = np.array([plane.rotation for plane in self._planes])[moments.robots]
        origins = np.array([plane.position for plane in self._planes])[moments.robots]
        places = places + np.einsum("gkij,gj->gki", turns, origins)
        back = np.swapaxes(belief.rotations, 1, 2)[cameras]
        rotations = (back @ turns @ planes[:, None]).reshape(-1, 3, 3)
        ts = (back @ (places - belief.places[cameras])[..., None]).reshape(-1, 3)
        count = n // LEDS
        robots = np.repeat(moments.robots, count)
        pixels = np.empty((g * count, LEDS, 2))
        spots_at(_NO_LENS, self._layouts[robots], self._optics[robots], rotations, ts, pixels)
        points = np.einsum("mij,mlj->mli", rotations, self._layouts[robots]) + ts[:, None]
        shifts = pixels - points[..., :2] / points[..., 2:]
        return np.where(points[..., 2:] > BEHIND, shifts, 0.0).reshape(g, n, 2)


_NO_LENS = np.concatenate([[1.0, 1.0], np.zeros(11)])


def _ray_by_point(points: Floats) -> Floats:
    """Derivatives (..., 2, 3) of x / z, y / z."""
    x, y, z = np.moveaxis(points, -1, 0)
    out = np.zeros((*points.shape[:-1], 2, 3))
    out[..., 0, 0] = out[..., 1, 1] = 1.0 / z
    out[..., 0, 2], out[..., 1, 2] = -x / z**2, -y / z**2
    return out
