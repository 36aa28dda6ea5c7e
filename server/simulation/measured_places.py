"""Several cameras about one floor, drawn from a seed: where they stand, and where a person would have measured that.

It is what `asterism example --cameras` writes down. Lenses and robots are known; a camera's place is measured with a
tape and a level.
"""

import math
from dataclasses import dataclass

import numpy as np

from asterism.protocol.camera import Camera
from asterism.protocol.geometry import Pose, exp_rotation
from asterism.protocol.rig import Robot, load_rig
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.simulation.measured_rig import BOARD, LED_RADIUS_M, drawn_camera

DRIVING = 3  # of the demonstration's robots
BASE = Pose(np.array([0.27, 0.21, 0.0]), np.array([0.0, 0.0, 0.0, 1.0]))  # where none of them drives
DISTANCE_M, SLANT_RAD = 1.3, math.radians(30.0)  # of cameras from the floor's middle, and from straight above it
HUNG_M, HUNG_RAD = 0.03, 0.03  # of where they were to stand, per axis
TAPE_M, TAPE_MARK_M, LEVEL_RAD = 5e-3, 1e-3, 0.017  # one standard deviation per axis; what the tape is read to


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPlace:
    """A camera with its lens, T_world_camera as it is, and as it was measured."""

    camera: Camera
    true: Pose
    measured: Pose


def draw_places(seed: int, cameras: int) -> list[MeasuredPlace]:
    """So many cameras around the world's origin, cam1, cam2, ..., that look at it."""
    rng = np.random.default_rng([seed, 9])
    return [_place(rng, k, cameras) for k in range(cameras)]


def floor_robots() -> tuple[Robot, ...]:
    """Those that drive there, and `base`, a board with six LEDs that lies on the floor and says where the world is."""
    leds = np.array([(x, y, 0.0) for x, y in BOARD])
    return (*load_rig(DEMO_RIG).robots[:DRIVING], Robot("base", leds, led_radius=LED_RADIUS_M, T_world_fixed=BASE))


def _place(rng: np.random.Generator, k: int, cameras: int) -> MeasuredPlace:
    around = 2.0 * math.pi * (k + 0.25) / cameras
    out = np.array([math.cos(around), math.sin(around), 0.0])
    eye = DISTANCE_M * (math.sin(SLANT_RAD) * out + math.cos(SLANT_RAD) * np.array([0.0, 0.0, 1.0]))
    z, x = -eye / DISTANCE_M, np.array([-out[1], out[0], 0.0])
    stood = np.column_stack([x, np.cross(z, x), z]) @ exp_rotation(HUNG_RAD * rng.normal(size=3))
    place = eye + HUNG_M * rng.normal(size=3)
    read = np.round((place + TAPE_M * rng.normal(size=3)) / TAPE_MARK_M) * TAPE_MARK_M
    levelled = exp_rotation(LEVEL_RAD * rng.normal(size=3)) @ stood
    true = Pose.from_matrix(stood, place.round(6))
    return MeasuredPlace(drawn_camera(rng, f"cam{k + 1}"), true, Pose.from_matrix(levelled, read))
