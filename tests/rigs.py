"""Rigs for tests and benchmarks, made from a seed."""

import numpy as np

from asterism.protocol.camera import Camera
from asterism.protocol.constellation import confusions
from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig, Robot

FOCAL_PX = 1400.0


def make_camera(width: int = 1280, height: int = 1024, focal_px: float = FOCAL_PX, name: str = "test") -> Camera:
    """A camera with some distortion of both kinds."""
    matrix = np.array([[focal_px, 0.0, width / 2 + 3.3], [0.0, focal_px * 1.001, height / 2 - 4.2], [0.0, 0.0, 1.0]])
    return Camera(name, width, height, matrix, "plumb_bob", np.array([-0.11, 0.03, 0.0004, -0.0003, 0.0]))


def random_layout(rng: np.random.Generator, radius_m: float = 0.05, spacing_m: float = 0.02) -> Floats:
    """Six points (6, 2) m in a disc, a least distance apart, spread in both directions."""
    while True:
        points: list[Floats] = []
        for _ in range(300):
            r, angle = radius_m * np.sqrt(rng.uniform()), rng.uniform(0, 2 * np.pi)
            point = r * np.array([np.cos(angle), np.sin(angle)])
            if all(np.hypot(*(point - other)) >= spacing_m for other in points):
                points.append(point)
            if len(points) == 6:
                break
        layout = np.array(points)
        if len(points) == 6 and np.linalg.eigvalsh(np.cov(layout.T, bias=True))[0] > 0.15 * radius_m**2:
            return layout


def random_layouts(count: int, seed: int, least_m: float = 0.004) -> list[Floats]:
    """Layouts of which any two, and any with itself turned, are a least separation apart."""
    rng = np.random.default_rng(seed)
    layouts: list[Floats] = []
    while len(layouts) < count:
        candidate = random_layout(rng)
        if all(c.separation >= least_m for c in confusions([*layouts[-12:], candidate])):
            layouts.append(candidate)
    return layouts


def make_rig(
    count: int,
    seed: int = 0,
    camera: Camera | None = None,
    range_m: tuple[float, float] | None = (0.8, 2.0),
    T_world_camera: Pose | None = None,
) -> Rig:
    """A rig of ``count`` robots r00, r01, ... with random constellations."""
    robots = tuple(
        Robot(f"r{k:02d}", np.column_stack([layout, np.zeros(6)]), led_radius=0.0025)
        for k, layout in enumerate(random_layouts(count, seed))
    )
    return Rig(camera or make_camera(), robots, range_m=range_m, T_world_camera=T_world_camera)
