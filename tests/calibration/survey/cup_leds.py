"""LEDs as they are built: a chip in a reflector cup under an epoxy dome on a cylinder, traced ray by ray.

Rays go from the camera into the LED, are bent by Snell's law where they enter, mirrored by the cup and by total
reflection at the epoxy's wall, and are as bright as what they end on. Nothing is shared with the product.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from asterism.protocol.geometry import Floats

SAMPLES = 120  # rays across an LED, along each axis
EVENTS = 7  # bounces that are followed
FINER = 8  # samples a pixel
NEVER = 1e9


@dataclass(frozen=True)
class CupLed:
    """Lengths in m; the origin is the dome's centre, the light goes along +z.

    The cup's rim lies ``rim`` below the origin; it is a cone ``deep``, ``wide`` at the rim and ``narrow`` at its floor
    (radii), on which the chip stands, a box of half width ``chip`` and height ``tall``. The epoxy's wall is in view
    down to ``proud`` below the origin, where the plate begins. ``mirror``: reflectance of the cup; ``dull``: how bright
    its wall is by itself, the chip being 1; ``spilled``: the plate's brightness out to twice the LED's radius.
    """

    radius: float = 2.5e-3
    rim: float = 1.0e-3
    deep: float = 0.6e-3
    wide: float = 0.9e-3
    narrow: float = 0.45e-3
    chip: float = 0.15e-3
    tall: float = 0.15e-3
    proud: float = 4e-3
    index: float = 1.5
    mirror: float = 0.85
    dull: float = 0.08
    spilled: float = 0.0

    @property
    def spacing(self) -> float:
        """Between rays, m."""
        return 2.0 * self.radius / SAMPLES

    def seen(self, led: Floats, axis: Floats) -> tuple[Floats, Floats]:
        """Points (n, 3) m, camera's frame, through which rays of the camera go, evenly, and their light (n,), of an LED
        at ``led`` (3,) m with the unit ``axis`` (3,).
        """
        sight = led / np.linalg.norm(led)
        across = np.cross(sight, axis)
        across = across / np.linalg.norm(across) if np.linalg.norm(across) > 1e-9 else _any_normal(sight)
        side = np.cross(across, sight)  # where the axis points in the image
        reach = self.radius + (self.radius if self.spilled else 0.0)
        low, high = -reach - self.proud * np.linalg.norm(np.cross(sight, axis)), reach
        step = self.spacing
        u = np.arange(low, high, step) + 0.5 * step
        v = np.arange(-reach, reach, step) + 0.5 * step
        grid_u, grid_v = (grid.ravel() for grid in np.meshgrid(u, v))
        points = led + grid_u[:, None] * side + grid_v[:, None] * across
        frame = np.column_stack([np.cross(across, axis), across, axis])  # of the LED, in the camera's
        start, way = -led @ frame, points @ frame
        way /= np.linalg.norm(way, axis=1)[:, None]
        light = self._trace(start, way)
        lit = light > 0.0
        return points[lit], light[lit]

    def _trace(self, start: Floats, way: Floats) -> Floats:
        place, inside = self._enter(start, way)
        light = np.zeros(len(way))
        if self.spilled:
            t = (-self.proud - start[2]) / way[:, 2]
            hit = start + t[:, None] * way
            rho = np.hypot(hit[:, 0], hit[:, 1])
            light[~inside & (rho > self.radius) & (rho < 2 * self.radius)] = self.spilled
        rows = np.flatnonzero(inside)
        place, way = place[rows], way[rows]
        normal = self._outward(place)
        cosine = -np.einsum("ij,ij->i", way, normal)
        inner = np.sqrt(1.0 - (1.0 - cosine**2) / self.index**2)
        way = way / self.index + (cosine / self.index - inner)[:, None] * normal
        weight = _transmitted(cosine, inner, self.index)
        for _ in range(EVENTS):
            times = self._times(place, way)
            first = np.argmin(times, axis=0)
            t = times[first, np.arange(len(first))]
            place = place + np.minimum(t, 1.0)[:, None] * way
            ends = np.array([1.0, 0.6, 0.6, 2 * self.dull, 0.0])  # chip's top, its sides, the cup's floor, dark things
            dark = first <= 4
            light[rows[dark]] += weight[dark] * ends[first[dark]]
            wall, outer = first == 5, first == 6
            light[rows[wall]] += weight[wall] * self.dull
            normal = np.zeros_like(place)
            normal[wall] = self._cup_normal(place[wall])
            normal[outer] = self._outward(place[outer])
            cosine = np.einsum("ij,ij->i", way, normal)
            total = outer & (1.0 - cosine**2 > 1.0 / self.index**2)
            weight = np.where(wall, self.mirror * weight, weight)
            way = way - 2.0 * cosine[:, None] * normal
            goes_on = (wall | total) & (weight > 0.02)
            rows, place, way, weight = rows[goes_on], place[goes_on], way[goes_on], weight[goes_on]
            place = place + 1e-9 * way
            if not len(rows):
                break
        return light

    def _enter(self, start: Floats, way: Floats) -> tuple[Floats, Floats]:
        """Where rays from outside meet the epoxy (n, 3), and whether they do (n,)."""
        b, c = way @ start, start @ start - self.radius**2
        root = b * b - c
        dome = start + (-b - np.sqrt(np.maximum(root, 0.0)))[:, None] * way
        on_dome = (root > 0.0) & (dome[:, 2] >= 0.0)
        wall = start + _cylinder(start[None], way, self.radius, near=True)[:, None] * way
        on_wall = ~on_dome & (wall[:, 2] < 0.0) & (wall[:, 2] > -self.proud)
        return np.where(on_dome[:, None], dome, wall), on_dome | on_wall

    def _outward(self, place: Floats) -> Floats:
        normal = place.copy()
        normal[place[:, 2] < 0.0, 2] = 0.0
        unit: Floats = normal / np.maximum(np.linalg.norm(normal, axis=1), 1e-12)[:, None]
        return unit

    def _cup_normal(self, place: Floats) -> Floats:
        slope = (self.wide - self.narrow) / self.deep
        rho = np.maximum(np.hypot(place[:, 0], place[:, 1]), 1e-12)
        normal = np.column_stack([place[:, 0] / rho, place[:, 1] / rho, np.full(len(rho), -slope)])
        return normal / np.hypot(1.0, slope)

    def _times(self, place: Floats, way: Floats) -> Floats:
        """How far (7, n) to the chip's top and its sides (x, y), the cup's floor, the frame, the cup's wall, the
        epoxy's surface."""
        floor = -self.rim - self.deep
        top = floor + self.tall
        with np.errstate(divide="ignore", invalid="ignore"):
            flat = [_only((z - place[:, 2]) / way[:, 2]) for z in (top, floor, -self.rim)]
            tops, floors, rims = (place + t[:, None] * way for t in flat)
            sides = [self._side(place, way, axis, floor, top) for axis in (0, 1)]
            in_chip = np.maximum(np.abs(tops[:, 0]), np.abs(tops[:, 1])) < self.chip
            in_floor = np.hypot(floors[:, 0], floors[:, 1]) < self.narrow
            on_frame = (np.hypot(rims[:, 0], rims[:, 1]) > self.wide) & (way[:, 2] < 0.0)
            cone = self._cone(place, way)
            b, c = np.einsum("ij,ij->i", place, way), np.einsum("ij,ij->i", place, place) - self.radius**2
            dome = -b + np.sqrt(np.maximum(b * b - c, 0.0))
            dome = np.where(place[:, 2] + dome * way[:, 2] >= 0.0, _only(dome), NEVER)
            wall = _only(_cylinder(place, way, self.radius, near=False))
            wall = np.where(place[:, 2] + wall * way[:, 2] < 0.0, wall, NEVER)
        return np.array([
            np.where(in_chip, flat[0], NEVER), sides[0], sides[1], np.where(in_floor, flat[1], NEVER),
            np.where(on_frame, flat[2], NEVER), cone, np.minimum(dome, wall),
        ])  # fmt: skip

    def _side(self, place: Floats, way: Floats, axis: int, floor: float, top: float) -> Floats:
        t = _only((-np.sign(way[:, axis]) * self.chip - place[:, axis]) / way[:, axis])
        hit = place + t[:, None] * way
        there = (np.abs(hit[:, 1 - axis]) < self.chip) & (hit[:, 2] > floor) & (hit[:, 2] < top)
        return np.where(there, t, NEVER)

    def _cone(self, place: Floats, way: Floats) -> Floats:
        slope = (self.wide - self.narrow) / self.deep
        at = self.wide + slope * (place[:, 2] + self.rim)  # radius of the cone at the ray's height
        a = way[:, 0] ** 2 + way[:, 1] ** 2 - (slope * way[:, 2]) ** 2
        b = place[:, 0] * way[:, 0] + place[:, 1] * way[:, 1] - at * slope * way[:, 2]
        c = place[:, 0] ** 2 + place[:, 1] ** 2 - at**2
        root = np.sqrt(b * b - a * c)
        best = np.full(len(a), NEVER)
        for sign in (-1.0, 1.0):
            t = _only((-b + sign * root) / a)
            z = place[:, 2] + t * way[:, 2]
            there = (z < -self.rim) & (z > -self.rim - self.deep)
            best = np.where(there, np.minimum(best, t), best)
        return best


def _only(t: Floats) -> Floats:
    ahead: Floats = np.where(np.isfinite(t) & (t > 1e-8), t, NEVER)
    return ahead


def _cylinder(place: Floats, way: Floats, radius: float, near: bool) -> Floats:
    a = way[:, 0] ** 2 + way[:, 1] ** 2
    b = place[:, 0] * way[:, 0] + place[:, 1] * way[:, 1]
    c = place[:, 0] ** 2 + place[:, 1] ** 2 - radius**2
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(b * b - a * c)
        t = (-b - root) / a if near else (-b + root) / a
    found: Floats = np.where(np.isfinite(t), t, NEVER)
    return found


def _transmitted(outer: Floats, inner: Floats, index: float) -> Floats:
    """Fresnel's share of unpolarized light that passes, by the cosines outside and inside."""
    s = ((outer - index * inner) / (outer + index * inner)) ** 2
    p = ((inner - index * outer) / (inner + index * outer)) ** 2
    share: Floats = 1.0 - 0.5 * (s + p)
    return share


def _any_normal(way: Floats) -> Floats:
    other = np.cross(way, [1.0, 0.0, 0.0] if abs(way[0]) < 0.7 else [0.0, 1.0, 0.0])
    unit: Floats = other / np.linalg.norm(other)
    return unit


def add_light(fine: Floats, pixels: Floats, light: Floats) -> None:
    """Add points' light to a canvas of FINER samples a pixel, pixels (n, 2) px of its own; keeps their centroid."""
    at = (pixels + 0.5) * FINER - 0.5
    whole = np.floor(at).astype(np.int64)
    part = at - whole
    for dx in (0, 1):
        for dy in (0, 1):
            share = np.abs(1 - dx - part[:, 0]) * np.abs(1 - dy - part[:, 1])
            np.add.at(fine, (whole[:, 1] + dy, whole[:, 0] + dx), share * light)


def blurred(fine: Floats, psf_px: float) -> Floats:
    """The canvas as a lens blurs it, on pixels."""
    smooth = gaussian_filter(fine, psf_px * FINER, truncate=5)
    h, w = fine.shape
    pixels: Floats = smooth.reshape(h // FINER, FINER, w // FINER, FINER).mean(axis=(1, 3))
    return pixels
