"""Small images with known truth: discs, streaks, lamps, rendered by slow and obvious supersampling.

Nothing here is shared with the product's simulator or its estimators.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from asterism.protocol.geometry import Floats

FINER = 8  # samples a pixel along each axis


@dataclass
class Canvas:
    """Expected grey levels of an image; light is added, then exposed."""

    light: Floats  # (h, w)
    psf_px: float = 0.9

    @staticmethod
    def of(height: int, width: int, background: float = 8.0, slope: tuple[float, float] = (0.0, 0.0)) -> "Canvas":
        """An empty image, with a brightness gradient in grey levels per px along x and y."""
        y, x = np.mgrid[0:height, 0:width]
        return Canvas(background + slope[0] * x + slope[1] * y + 0.0)

    def ellipse(
        self, x: float, y: float, a: float, b: float | None = None, angle: float = 0.0, level: float = 170.0,
        blur: float | None = None,
    ) -> "Canvas":  # fmt: skip
        """Add a uniform ellipse, centre (x, y) px, blurred by the point spread (or by ``blur``)."""
        b = a if b is None else b
        psf = self.psf_px if blur is None else blur
        half = int(np.ceil(max(a, b) + 5 * psf + 2))
        x0, y0 = round(x) - half, round(y) - half
        size = 2 * half + 1
        ticks = (np.arange(size * FINER) + 0.5) / FINER - 0.5
        u, v = np.meshgrid(ticks + x0 - x, ticks + y0 - y)
        p, q = np.cos(angle) * u + np.sin(angle) * v, np.cos(angle) * v - np.sin(angle) * u
        # How much of each sample's square the ellipse covers, by its distance from the edge.
        gradient = np.hypot(p / a**2, q / b**2) + 1e-12
        distance = (1.0 - (p / a) ** 2 - (q / b) ** 2) / (2.0 * gradient)
        fine = np.clip(0.5 + distance * FINER, 0.0, 1.0)
        fine = gaussian_filter(fine, psf * FINER, truncate=5)
        self._add(level * fine.reshape(size, FINER, size, FINER).mean(axis=(1, 3)), x0, y0)
        return self

    def streak(self, x: float, y: float, length: float, angle: float, level: float = 200.0) -> "Canvas":
        """Add a glint: a line of light."""
        for along in np.linspace(-length / 2, length / 2, max(2, int(length))):
            self.ellipse(x + along * np.cos(angle), y + along * np.sin(angle), 1.0, level=level / 2)
        return self

    def pixel(self, x: int, y: int, level: float = 200.0) -> "Canvas":
        """Add a hot pixel."""
        self.light[y, x] += level
        return self

    def expose(
        self, rng: np.random.Generator | None = None, read: float = 1.2, gain: float = 0.03
    ) -> NDArray[np.uint8]:
        """The image (h, w) uint8, with noise if there is a generator."""
        level = self.light
        if rng is not None:
            above = np.maximum(level - level.min(), 0.0)
            level = level + np.sqrt(gain * above + read**2) * rng.standard_normal(level.shape)
        exposed: NDArray[np.uint8] = np.clip(np.rint(level), 0, 255).astype(np.uint8)
        return exposed

    def _add(self, patch: Floats, x0: int, y0: int) -> None:
        height, width = self.light.shape
        left, top, right, bottom = (
            max(x0, 0),
            max(y0, 0),
            min(x0 + patch.shape[1], width),
            min(y0 + patch.shape[0], height),
        )
        if left < right and top < bottom:
            self.light[top:bottom, left:right] += patch[top - y0 : bottom - y0, left - x0 : right - x0]
