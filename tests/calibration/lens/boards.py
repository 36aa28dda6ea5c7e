"""Calibration boards seen through a known lens, by slow and obvious supersampling.

Every sample of a pixel is traced back to the board: the lens is undone by fixed-point iteration on the model's formula
as written here, the ray is met with the board's plane, and a function says what is printed there. Nothing is shared
with the product.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from asterism.protocol.geometry import Floats, Pose, exp_rotation

FINER = 3  # samples a pixel along each axis
Print = Callable[[Floats, Floats], Floats]  # grey levels at board coordinates x, y, m; nan beside the board


@dataclass(frozen=True)
class Lens:
    """fx, fy, cx, cy px; coefficients k1 k2 p1 p2 k3 of Brown's model, or k1 to k4 of an equidistant fisheye."""

    size: tuple[int, int] = (640, 480)
    focal: tuple[float, float] = (610.0, 612.0)
    middle: tuple[float, float] = (325.0, 236.0)
    coefficients: tuple[float, ...] = (-0.21, 0.06, 0.0008, -0.0005, 0.01)

    @property
    def parameters(self) -> Floats:
        """In the order of the product's parameter vector."""
        return np.array([*self.focal, *self.middle, *self.coefficients])

    def project(self, points: Floats) -> Floats:
        """Pixels (..., 2) of points (..., 3)."""
        x, y = points[..., 0] / points[..., 2], points[..., 1] / points[..., 2]
        return self.bend(x, y) * self.focal + self.middle

    def bend(self, x: Floats, y: Floats) -> Floats:
        """Distorted coordinates of ideal ones."""
        r = np.hypot(x, y)
        if len(self.coefficients) == 4:
            k1, k2, k3, k4 = self.coefficients
            theta = np.arctan(r)
            bent = theta * (1 + k1 * theta**2 + k2 * theta**4 + k3 * theta**6 + k4 * theta**8)
            scale = np.divide(bent, r, out=np.ones_like(r), where=r > 1e-12)
            return np.stack([x * scale, y * scale], axis=-1)
        k1, k2, p1, p2, k3 = self.coefficients
        scale = 1 + k1 * r**2 + k2 * r**4 + k3 * r**6
        return np.stack(
            [
                x * scale + 2 * p1 * x * y + p2 * (r**2 + 2 * x * x),
                y * scale + p1 * (r**2 + 2 * y * y) + 2 * p2 * x * y,
            ],
            axis=-1,
        )

    def rays(self, pixels: Floats) -> Floats:
        """(x / z, y / z) of pixels (..., 2)."""
        bent = (pixels - np.array(self.middle)) / np.array(self.focal)
        if len(self.coefficients) == 4:
            k1, k2, k3, k4 = self.coefficients
            r = np.linalg.norm(bent, axis=-1)
            theta = r.copy()
            for _ in range(60):
                theta = r / (1 + k1 * theta**2 + k2 * theta**4 + k3 * theta**6 + k4 * theta**8)
            return bent * (np.tan(np.minimum(theta, 1.5)) / np.maximum(r, 1e-12))[..., None]
        ideal = bent.copy()
        for _ in range(40):
            ideal = ideal + (bent - self.bend(ideal[..., 0], ideal[..., 1]))
        return ideal


FISHEYE = Lens(focal=(300.0, 301.0), coefficients=(-0.02, 0.004, -0.002, 0.0004))


@lru_cache(maxsize=4)
def _sample_rays(lens: Lens) -> NDArray[np.float32]:
    width, height = lens.size
    x, y = (np.arange(width * FINER) + 0.5) / FINER - 0.5, (np.arange(height * FINER) + 0.5) / FINER - 0.5
    rays = np.empty((len(y), len(x), 2), np.float32)
    for row in range(0, len(y), 240):
        pixels = np.stack(np.meshgrid(x, y[row : row + 240]), axis=-1)
        rays[row : row + 240] = lens.rays(pixels)
    return rays


def render(
    lens: Lens, T_camera_board: Pose, printed: Print, box: tuple[float, float, float, float],
    rng: np.random.Generator | None = None, around: float = 90.0, blur_px: float = 0.7, noise: float = 1.5,
) -> NDArray[np.uint8]:  # fmt: skip
    """The image (h, w); ``box`` x0, y0, x1, y1 m holds all of the board; ``around`` is what is beside it."""
    width, height = lens.size
    edge = np.linspace(0.0, 1.0, 20)
    x0, y0, x1, y1 = box
    rim = [(x0 + (x1 - x0) * s, y) for s in edge for y in (y0, y1)]
    rim += [(x, y0 + (y1 - y0) * s) for s in edge for x in (x0, x1)]
    seen = lens.project(T_camera_board.map(np.array([(x, y, 0.0) for x, y in rim])))
    left, top = np.maximum(np.floor(seen.min(axis=0)) - 2, 0).astype(int)
    right, bottom = np.minimum(np.ceil(seen.max(axis=0)) + 3, [width, height]).astype(int)
    image = np.full((height, width), float(around))
    if left < right and top < bottom:
        rays = _sample_rays(lens)[top * FINER : bottom * FINER, left * FINER : right * FINER].astype(np.float64)
        R, t = T_camera_board.rotation, T_camera_board.position
        back = np.linalg.inv(np.column_stack([R[:, :2], t]))
        met = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], axis=-1) @ back.T
        light = printed(met[..., 0] / met[..., 2], met[..., 1] / met[..., 2])
        light = np.where(np.isnan(light), around, light)
        image[top:bottom, left:right] = light.reshape(bottom - top, FINER, right - left, FINER).mean(axis=(1, 3))
    image = gaussian_filter(image, blur_px)
    if rng is not None:
        image = image + noise * rng.standard_normal(image.shape)
    exposed: NDArray[np.uint8] = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    return exposed


def _paper(x: Floats, y: Floats, box: tuple[float, float, float, float], level: float) -> Floats:
    x0, y0, x1, y1 = box
    return np.where((x > x0) & (x < x1) & (y > y0) & (y < y1), level, np.nan)


def chessboard(columns: int, rows: int, pitch: float) -> tuple[Print, tuple[float, float, float, float]]:
    """Inner corners; the first at (0, 0), with a white rim of one square."""
    box = (-2 * pitch, -2 * pitch, (columns + 1) * pitch, (rows + 1) * pitch)

    def printed(x: Floats, y: Floats) -> Floats:
        u, v = x / pitch, y / pitch
        squares = (u > -1) & (u < columns) & (v > -1) & (v < rows)
        dark = squares & ((np.floor(u) + np.floor(v)) % 2 == 0)
        return np.where(dark, 25.0, _paper(x, y, box, 210.0))

    return printed, box


def discs(
    centres: Floats, radius: float, rim: float, level: float = 25.0, board: float = 210.0
) -> tuple[Print, tuple[float, float, float, float]]:
    """Discs of one ``level`` on a ``board`` of another that reaches ``rim`` m beyond their centres."""
    box = (*(centres.min(axis=0)[:2] - rim).tolist(), *(centres.max(axis=0)[:2] + rim).tolist())

    def printed(x: Floats, y: Floats) -> Floats:
        light = _paper(x, y, box, board)
        for cx, cy in centres[:, :2]:
            light[(x - cx) ** 2 + (y - cy) ** 2 < radius**2] = level
        return light

    return printed, box


def poses(
    rng: np.random.Generator, count: int, centre: Floats, lens: Lens, reach: float, near: float, far: float,
    tilt: float = 0.6,
) -> Sequence[Pose]:  # fmt: skip
    """The board's ``centre`` (3,) all over the image, at ``near`` to ``far`` m, tilted by up to ``tilt`` rad each way.

    ``reach`` is the share of the image's half width and height that the centre takes.
    """
    every = []
    for k in range(count):
        width, height = lens.size
        u, v = reach * rng.uniform(-1, 1), reach * rng.uniform(-1, 1)
        pixel = np.array([width * (0.5 + 0.5 * u), height * (0.5 + 0.5 * v)])
        x, y = lens.rays(pixel)
        z = near + (far - near) * (k + 0.5) / count
        turn = exp_rotation(np.array([*rng.uniform(-tilt, tilt, 2), 0.0])) @ exp_rotation(
            np.array([0.0, 0.0, rng.uniform(-0.5, 0.5)])
        )
        every.append(Pose.from_matrix(turn, np.array([x * z, y * z, z]) - turn @ centre))
    return every
