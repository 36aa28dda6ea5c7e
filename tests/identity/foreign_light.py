"""Light that is not a robot's, added to rendered frames: clutter, streaks, mirror images."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from asterism.protocol.geometry import Floats
from asterism.protocol.rig import Rig
from asterism.server.simulation.simulate import Look, Scene, Truth, quadrature, trace_disc

LOOK = Look()
NODES = quadrature(4.0, LOOK.psf_px)


def leds_of(rig: Rig, entry: Truth) -> Floats:
    leds: Floats = entry.T_camera_robot.map(rig.robot(entry.robot).leds)
    return leds


class Light:
    """Light that is added to a rendered frame: expected grey levels, then shot noise."""

    def __init__(self, scene: Scene, rng: np.random.Generator) -> None:
        self.scene, self.rng, self.camera = scene, rng, scene.rig.camera
        self.levels: Floats = np.zeros((self.camera.height, self.camera.width))
        self._patch = np.zeros((64, 64))

    def add(self, patch: Floats, x0: int, y0: int) -> None:
        h, w = self.levels.shape
        x1, y1, left, top = min(x0 + patch.shape[1], w), min(y0 + patch.shape[0], h), max(x0, 0), max(y0, 0)
        if left < x1 and top < y1:
            self.levels[top:y1, left:x1] += patch[top - y0 : y1 - y0, left - x0 : x1 - x0]

    def disc(self, centre: Floats, normal: Floats, radius: float, level: float) -> None:
        """What an LED looks like there: ``centre`` and ``normal`` in the camera's frame, m."""
        x0, y0, w, h = trace_disc(self.scene.lens, centre, normal, radius, LOOK.psf_px, NODES, self._patch)
        self.add(level * self._patch[:h, :w], x0, y0)

    def ray(self) -> Floats:
        """Somewhere in view, z = 1."""
        camera, u = self.camera, self.rng.uniform(-0.48, 0.48, 2)
        return np.array([u[0] * camera.width / camera.matrix[0, 0], u[1] * camera.height / camera.matrix[1, 1], 1.0])

    def clutter(self, count: int, truth: list[Truth]) -> None:
        """Half of them as large and bright as LEDs, a quarter streaks, a quarter (if there are robots) mirror images:
        dim discs beside LEDs.
        """
        rng = self.rng
        for kind in rng.choice(3, count, p=[0.5, 0.25, 0.25]):
            tilted = np.array([0.0, 0.0, -1.0]) + 0.5 * rng.normal(size=3) * [1, 1, 0]
            tilted /= np.linalg.norm(tilted)
            if kind == 1:
                self._streak()
            elif kind == 2 and truth:
                robot, led = int(rng.integers(len(truth))), int(rng.integers(6))
                at, angle = leds_of(self.scene.rig, truth[robot])[led], rng.uniform(0, 2 * np.pi)
                off = rng.uniform(8, 25) * at[2] / self.camera.matrix[0, 0]
                away = off * np.array([np.cos(angle), np.sin(angle), 0.0])
                self.disc(at + away, tilted, 0.0025, LOOK.brightness * rng.uniform(0.2, 0.55))
            else:
                at = self.ray() * rng.uniform(*(self.scene.rig.range_m or (1.0, 1.5)))
                self.disc(at, tilted, 0.0025 * rng.uniform(0.8, 1.3), LOOK.brightness * rng.uniform(0.5, 1.2))

    def _streak(self) -> None:
        length, angle, radius = self.rng.uniform(3, 16), self.rng.uniform(0, np.pi), self.rng.uniform(0.4, 2.5)
        x, y = self.rng.uniform(0, self.camera.width), self.rng.uniform(0, self.camera.height)
        half = int(0.5 * length + radius + 4 * LOOK.psf_px) + 2
        v, u = np.mgrid[-half : half + 1, -half : half + 1] - np.array([y % 1, x % 1])[:, None, None]
        along = np.clip(u * np.cos(angle) + v * np.sin(angle), -0.5 * length, 0.5 * length)
        away = np.hypot(u - along * np.cos(angle), v - along * np.sin(angle))
        soft = 0.5 * (1.0 - erf((away - radius) / (np.sqrt(2.0) * LOOK.psf_px)))
        self.add(self.rng.uniform(60, 240) * soft, int(x) - half, int(y) - half)

    def on(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The image with this light."""
        lit = np.nonzero(self.levels)
        level = self.levels[lit]
        out = image.copy()
        noise = np.sqrt(LOOK.gain * level) * self.rng.standard_normal(len(level))
        out[lit] = np.clip(np.rint(image[lit] + level + noise), 0, 255).astype(np.uint8)
        return out
