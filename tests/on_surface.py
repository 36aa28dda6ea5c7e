"""A rig whose robots stand on a surface, where they may stand there, and frames of them: the truth of several tests.

The pose of a robot on a surface is found here by another way than the product's: by bisection along the surface's z and
by numeric slopes.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig
from asterism.protocol.surface import Quadric, Surface
from asterism.protocol.surface_file import Stands
from asterism.server.chain.frame import Frame
from asterism.server.simulation.simulate import Look, Scene, Truth
from tests.rigs import make_rig
from tests.several import looking_at

TOOL = np.array([0.0, 0.0, -0.03])  # m, of every robot, in its frame; the LEDs' plane is its z = 0
# A bowl's and a saddle's bends, 1/m: falls by 12 mm at 0.25 m along x.
BENT = Surface(Quadric(np.array([0.0, 0.03, -0.02, 1.0, 0.4, 0.25, 0.0, 0.15, 0.0, 0.0])))


def rig_on(
    surface: Surface = BENT, robots: int = 5, distance_m: float = 1.3, sigma_m: float = 5e-5,
    tilt_sigma_deg: float = 0.05, seed: int = 0,
) -> Rig:  # fmt: skip
    """A camera straight above the world's origin, turned anyhow, a little askew, and robots whose tool stands on the
    surface within those sigmas.
    """
    place = looking_at(distance_m * np.array([0.03, -0.02, 1.0]), np.zeros(3), 0.7)
    base = make_rig(robots, seed, T_world_camera=place)
    stands = Stands("tool", np.array([0.0, 0.0, 1.0]), sigma_m, float(np.radians(tilt_sigma_deg)))
    standing = tuple(replace(robot, points={"tool": TOOL}, stands=stands) for robot in base.robots)
    return replace(base, robots=standing, surface=surface)


def stood(surface: Surface, x: float, y: float, heading_rad: float, lift_m: float = 0.0) -> Pose:
    """T_world_robot of a robot whose TOOL touches the surface at (x, y) of the surface's frame, upright on it; lifted
    along the normal.
    """
    h = 1e-5
    slope_x = (height(surface, x + h, y) - height(surface, x - h, y)) / (2 * h)
    slope_y = (height(surface, x, y + h) - height(surface, x, y - h)) / (2 * h)
    normal = np.array([-slope_x, -slope_y, 1.0])
    normal /= np.linalg.norm(normal)
    forward = np.array([np.cos(heading_rad), np.sin(heading_rad), 0.0])
    forward -= (forward @ normal) * normal
    forward /= np.linalg.norm(forward)
    turn = np.column_stack([forward, np.cross(normal, forward), normal])
    point = np.array([x, y, height(surface, x, y)]) + lift_m * normal
    return surface.T_world_surface @ Pose.from_matrix(turn, point - turn @ TOOL)


def height(surface: Surface, x: float, y: float) -> float:
    """Of a quadric, by bisection of its sum; in the surface's frame."""
    shape = surface.shape
    assert isinstance(shape, Quadric)

    def total(z: float) -> float:
        dx, dy, dz = np.array([x, y, z]) - shape.about
        return float(shape.terms @ [1, dx, dy, dz, dx * dx, dy * dy, dz * dz, dx * dy, dx * dz, dy * dz])

    low, high = -0.5, 0.5
    assert total(low) < 0.0 < total(high), "the sheet is not within half a metre"
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if total(middle) < 0.0 else (low, middle)
    return 0.5 * (low + high)


def places(rng: np.random.Generator, robots: int, half_m: float = 0.25) -> Floats:
    """Places (robots, 3) x, y, heading that are far enough apart for robots of 0.1 m."""
    while True:
        xy = rng.uniform(-half_m, half_m, (robots, 2)) * [1.0, 0.7]
        apart = np.linalg.norm(xy[:, None] - xy[None], axis=-1) + np.eye(robots)
        if apart.min() > 0.13:
            return np.column_stack([xy, rng.uniform(-np.pi, np.pi, robots)])


def frame_at(
    rig: Rig, poses: Mapping[str, Pose], index: int = 0, look: Look | None = None, seed: int = 0,
    lit: Mapping[str, tuple[bool, ...]] | None = None,
) -> Frame:  # fmt: skip
    """What the rig's camera shows of robots at poses T_world_robot; frames of one seed differ by their index."""
    assert rig.T_world_camera is not None
    T_camera_world = rig.T_world_camera.inverse()
    truth = [Truth(name, T_camera_world @ pose, (lit or {}).get(name, (True,) * 6)) for name, pose in poses.items()]
    ordered = sorted(truth, key=lambda entry: [robot.id for robot in rig.robots].index(entry.robot))
    assert len(ordered) == len(rig.robots), "the scene draws every robot of the rig"
    # Where they are is told, on a surface or off it.
    image = Scene(replace(rig, surface=None), seed, look).render(index, ordered)
    return Frame(image, exposed_ns=(index + 1) * 16_666_667, index=index)
