"""Spots under any lens, exactly: a uniform ellipse, its blur and the pixel are multiplied in the frequency plane.

Nothing is sampled finely and nothing is cut off: the grey levels of the pixels are the Fourier sum of Bessel function
(the ellipse), optical transfer function (the lens) and sinc (the pixel), with the frequencies beyond the pixels' own
folded back (ALIASES of them on either side; what lies beyond is below 1e-4 of the peak). Independent of `rendering`,
of the product's simulator and of its estimators; `bound` is the Cramer-Rao bound of this very model.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import j1

from asterism.protocol.geometry import Floats
from tests.centres.bounds import GAIN, READ

SIZE = 64  # px, of an image; it repeats itself beyond
ALIASES = 2
BACKGROUND = 8.0  # grey levels
CLIPPED = 254.5  # grey levels beyond which a pixel tells nothing

Complexes = NDArray[np.complex128]
Lens = Callable[[Floats, Floats], Floats | Complexes]  # frequencies x, y, cycles per px -> transfer


def gauss(sigma: float) -> Lens:
    """A Gaussian point spread, px."""
    return lambda fx, fy: np.exp(-2.0 * (np.pi * sigma) ** 2 * (fx**2 + fy**2))


def airy(dark: float) -> Lens:
    """A perfect lens whose first dark ring has a radius of ``dark`` px."""
    cutoff = 1.21967 / dark

    def transfer(fx: Floats, fy: Floats) -> Floats:
        x = np.minimum(np.hypot(fx, fy) / cutoff, 1.0)
        out: Floats = 2.0 / np.pi * (np.arccos(x) - x * np.sqrt(1.0 - x * x))
        return out

    return transfer


def defocus(radius: float) -> Lens:
    """The uniform disc of px that a point becomes out of focus, each of its points blurred by a Gaussian of 0.5 px."""
    return lambda fx, fy: _jinc(radius * np.hypot(fx, fy)) * gauss(0.5)(fx, fy)


def mixed(share: float, one: Lens, other: Lens) -> Lens:
    """``share`` of the light through one lens, the rest through the other."""
    return lambda fx, fy: share * one(fx, fy) + (1.0 - share) * other(fx, fy)


def coma(share: float, away: float) -> Lens:
    """A Gaussian with a broader one for a tail, ``away`` px beside it; told from the centroid of all light."""

    def transfer(fx: Floats, fy: Floats) -> Complexes:
        core, tail = gauss(0.7)(fx, fy), gauss(1.3)(fx, fy)
        turn = np.exp(-2j * np.pi * fx * away)
        out: Complexes = ((1 - share) * core + share * tail * turn) * np.exp(2j * np.pi * fx * share * away)
        return out

    return transfer


def _jinc(s: Floats) -> Floats:
    """Transform of the unit disc, 1 at 0."""
    t = 2.0 * np.pi * np.maximum(s, 1e-9)
    out: Floats = 2.0 * j1(t) / t
    return out


SYMMETRIC: dict[str, Lens] = {
    "gauss 0.7": gauss(0.7),
    "airy 1.683": airy(1.683),
    "airy and gauss": mixed(0.5, airy(1.683), gauss(1.0)),
    "halo": mixed(0.8, gauss(0.7), gauss(4.0)),
    "defocus 2": defocus(2.0),
    "defocus 4": defocus(4.0),
    "defocus 6": defocus(6.0),
}


@lru_cache(maxsize=4)
def _frequencies() -> tuple[Floats, Floats]:
    """Frequencies of the image and those that look like them, cycles per px."""
    ticks = np.arange(-ALIASES * SIZE - SIZE // 2, ALIASES * SIZE + SIZE // 2) / SIZE
    return np.meshgrid(ticks, ticks)


@lru_cache(maxsize=64)
def _transfer(lens: Lens) -> Complexes:
    """Lens and pixel."""
    fx, fy = _frequencies()
    return np.asarray(lens(fx, fy) * np.sinc(fx) * np.sinc(fy), np.complex128)


@dataclass(frozen=True, slots=True)
class Spot:
    """What is seen: centre px from the image's middle, semi-axes px, angle rad, grey levels of its middle above the
    background, and the background's slopes, grey levels per px.
    """

    lens: Lens
    a: float
    b: float
    level: float
    x: float = 0.0
    y: float = 0.0
    angle: float = 0.0
    background: float = BACKGROUND
    slope_x: float = 0.0
    slope_y: float = 0.0
    scale: float = 1.0  # of the lens's blur

    def light(self) -> Floats:
        """Expected grey levels (SIZE, SIZE), not clipped."""
        return self._seen()[0]

    def _seen(self) -> tuple[Floats, Floats, Floats]:
        """Grey levels, and their derivatives by x and y."""
        fx, fy = _frequencies()
        cos, sin = np.cos(self.angle), np.sin(self.angle)
        u, v = self.a * (cos * fx + sin * fy), self.b * (cos * fy - sin * fx)
        if self.scale == 1.0:
            transfer = _transfer(self.lens)
        else:
            transfer = self.lens(self.scale * fx, self.scale * fy) * np.sinc(fx) * np.sinc(fy)
        spectrum = _jinc(np.hypot(u, v)) * transfer
        spectrum = spectrum * (self.level / np.real(spectrum.sum()))
        spectrum = spectrum * np.exp(-2j * np.pi * (fx * (SIZE // 2 + self.x) + fy * (SIZE // 2 + self.y)))
        y, x = np.mgrid[:SIZE, :SIZE] - SIZE // 2
        plane = self.background + self.slope_x * x + self.slope_y * y
        return (
            plane + _folded(spectrum),
            _folded(-2j * np.pi * fx * spectrum),
            _folded(-2j * np.pi * fy * spectrum),
        )

    def bound(self, read: float = READ, gain: float = GAIN) -> Floats:
        """Covariance (2, 2) px^2 of the best unbiased estimate of the centre: level, brightness, size, shape, the
        blur's width and the slopes of the background are unknown as well. Rounding adds a variance of 1/12.
        """
        middle, by_x, by_y = self._seen()
        columns = [by_x, by_y]
        for name, step in _STEPS:
            if name == "angle" and self.a == self.b:
                continue  # a circle has none
            size = step * self.level if name == "level" else step
            at = getattr(self, name)
            up, down = replace(self, **{name: at + size}).light(), replace(self, **{name: at - size}).light()
            columns.append((up - down) / (2.0 * size))
        jacobian = np.stack([column.ravel() for column in columns], axis=1)
        variance = read**2 + gain * np.maximum(middle - self.background, 0.0).ravel() + 1 / 12
        weight = np.where(middle.ravel() < CLIPPED, 1.0 / variance, 0.0)
        return np.linalg.inv(jacobian.T @ (weight[:, None] * jacobian))[:2, :2]


_STEPS = (
    ("level", 0.01), ("a", 0.02), ("b", 0.02), ("angle", 0.02), ("background", 0.5), ("slope_x", 0.01),
    ("slope_y", 0.01), ("scale", 0.02),
)  # fmt: skip


def _folded(spectrum: Complexes) -> Floats:
    """The pixels (SIZE, SIZE) of a spectrum with its aliases."""
    copies = 2 * ALIASES + 1
    folded = spectrum.reshape(copies, SIZE, copies, SIZE).sum(axis=(0, 2))
    out: Floats = np.real(np.fft.ifft2(np.fft.ifftshift(folded))) * SIZE**2
    return out


def expose(light: Floats, rng: np.random.Generator, read: float = READ, gain: float = GAIN) -> NDArray[np.uint8]:
    """The image (h, w) uint8 of expected grey levels: read noise, shot noise, clipped, rounded."""
    above = np.maximum(light - light.min(), 0.0)
    noisy = light + np.sqrt(gain * above + read**2) * rng.standard_normal(light.shape)
    exposed: NDArray[np.uint8] = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    return exposed
