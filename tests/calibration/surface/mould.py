"""A mould, its drawing, and robots that drive on it: touches drawn with the covariances that a camera's poses have."""

from collections.abc import Callable

import numpy as np

from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.protocol.surface import Heights
from asterism.server.calibration.surface.contacts import Contacts

LONG, WIDE, STEP = 0.4, 0.3, 0.0025  # m
BUMPS = np.array([  # x, y, height, radius, m
    [0.09, 0.08, 0.012, 0.05], [0.29, 0.20, 0.018, 0.07], [0.20, 0.10, -0.009, 0.045], [0.10, 0.23, 0.007, 0.06],
    [0.34, 0.06, 0.010, 0.04],
])  # fmt: skip
DENT = np.array([0.15, 0.15])  # m, of a mould that is not as drawn
LIES = Pose.from_matrix(exp_rotation(np.array([0.05, -0.08, 0.9])), np.array([-0.15, 0.12, 0.03]))
CAMERA = np.array([0.04, -0.03, 1.3])  # m, in the world
SIGMAS = (2e-5, 2.5e-4)  # m, of a point across the line of sight and along it: six LEDs, f = 1400 px, 1.3 m

Shape = Callable[[Floats, Floats], Floats]


def free_form(x: Floats, y: Floats) -> Floats:
    """Heights of the drawing."""
    z = 0.02 * x + 0.1 * (x - 0.2) ** 2
    for u, v, height, radius in BUMPS:
        z = z + height * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2.0 * radius**2))
    return np.asarray(z)


def dented(x: Floats, y: Floats) -> Floats:
    """The mould: as drawn, but for a dent of 0.3 mm."""
    return free_form(x, y) - 3e-4 * np.exp(-((x - DENT[0]) ** 2 + (y - DENT[1]) ** 2) / (2.0 * 0.02**2))


def drawing_of(shape: Shape, long: float = LONG, wide: float = WIDE, step: float = STEP) -> Heights:
    """A grid of heights over x from 0 to ``long``, y from 0 to ``wide``."""
    x, y = (np.arange(round(size / step) + 1) * step for size in (long, wide))
    values = shape(*np.meshgrid(x, y, indexing="ij"))
    return Heights(np.zeros(2), np.array([step, step]), values, np.zeros(values.shape))


def drives(rng: np.random.Generator, robots: int, count: int, margin: float = 0.02) -> tuple[Floats, Floats]:
    """Places (robots * count, 2) m of robots that each drive straight at 60 mm/s and turn anew at the edge, 60 s; and
    whose each is.
    """
    out = []
    for _ in range(robots):
        place = rng.uniform([margin, margin], [LONG - margin, WIDE - margin])
        heading = rng.uniform(-np.pi, np.pi)
        step = 60.0 * 0.06 / count
        for _ in range(count):
            ahead = place + step * np.array([np.cos(heading), np.sin(heading)])
            while not (margin <= ahead[0] <= LONG - margin and margin <= ahead[1] <= WIDE - margin):
                heading = rng.uniform(-np.pi, np.pi)
                ahead = place + step * np.array([np.cos(heading), np.sin(heading)])
            place = ahead
            out.append(place)
    return np.array(out), np.repeat(np.arange(robots), count)


def touches_on(
    shape: Shape, xy: Floats, robots: Floats, rng: np.random.Generator, lies: Pose = LIES,
    sigmas: tuple[float, float] = SIGMAS, lifts: Floats | float = 0.0, offset_m: float = 0.0,
) -> Contacts:  # fmt: skip
    """Touches at places (n, 2) of the mould, as they are measured; ``lifts`` m along the normal, and for each robot
    ``offset_m`` times a normal deviate.
    """
    x, y = xy.T
    h, n, count = 1e-5, len(xy), int(robots.max()) + 1
    by_x, by_y = (shape(x + h, y) - shape(x - h, y)) / (2 * h), (shape(x, y + h) - shape(x, y - h)) / (2 * h)
    normals = np.column_stack([-by_x, -by_y, np.ones(n)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    above = offset_m * rng.standard_normal(count)[robots] + lifts
    points = lies.map(np.column_stack([x, y, shape(x, y)]) + above[:, None] * normals)
    sight = points - CAMERA
    sight /= np.linalg.norm(sight, axis=1, keepdims=True)
    along = sight[:, :, None] * sight[:, None]
    covariances = sigmas[0] ** 2 * (np.eye(3) - along) + sigmas[1] ** 2 * along
    points = points + (np.linalg.cholesky(covariances) @ rng.standard_normal((n, 3, 1)))[..., 0]
    axes = normals @ lies.rotation.T + 5e-3 * rng.standard_normal((n, 3))
    none = np.full((n, 3), np.nan)
    return Contacts(
        tuple("abcdefgh"[:count]), ("tool",) * count, robots, np.arange(n) / 60.0, np.ones(n, np.int64), points,
        covariances, axes / np.linalg.norm(axes, axis=1, keepdims=True), np.tile(2.5e-5 * np.eye(3), (n, 1, 1)),
        np.tile(np.eye(3), (n, 1, 1)), none, none, np.zeros((n, 3, 0)),
    )  # fmt: skip
