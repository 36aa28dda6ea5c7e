"""A rig drawn from a seed, as it is and as a person would have measured it: what lens maker, soldering iron, ruler and
calipers get wrong.

It is what `asterism example` writes down. The errors are those of common tools: a steel ruler is read to half a
millimetre and laid on by eye, calipers repeat to 0.02 mm, LEDs soldered to a circuit board sit where its drawing says
to 0.03 mm.
"""

from dataclasses import dataclass

import numpy as np

from asterism.protocol.camera import Camera
from asterism.protocol.constellation import LEDS
from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.protocol.rig import Rig, Robot

# What a file that holds a simulation's truth says in a line of its own, so that no calibration writes over it.
TRUTH_MARK = "# The truth of a simulation: nothing measured belongs here."

# The robot's plate and the board that is shown to the camera first, as they were drawn, m.
PLATE = (
    (-0.0240, -0.0285), (0.0230, 0.0320), (0.0020, 0.0320), (0.0100, -0.0145), (0.0385, -0.0265), (-0.0260, 0.0255),
)  # fmt: skip
BOARD = ((-0.12, -0.09), (0.12, -0.09), (0.12, 0.06), (0.03, 0.09), (-0.12, 0.09), (-0.02, -0.03))
PLATE_HEIGHT_M = 0.012  # above the robot's origin
TOOL = (0.0, 0.0, -0.03)  # the tip of the robot's tool as it was drawn, m
LED_RADIUS_M = 0.0025
RANGE_M = (0.8, 1.5)
WIDTH_PX, HEIGHT_PX, FOCAL_PX = 1280, 1024, 1400.0
HEIGHT_M = 1.3  # of the camera above the table

# One standard deviation, m where nothing else is said.
DRILLED_M = 0.3e-3  # of the plate's LEDs, per axis in the plate, from where they were drawn
UPRIGHT_M = 0.05e-3  # of the plate's LEDs along its normal
SOLDERED_M = 0.03e-3  # of the board's LEDs, per axis in the board
RULER_M, RULER_MARK_M = 0.35e-3, 0.5e-3  # of laying on a ruler, per axis; what it is read to
CALIPERS_M, CALIPERS_MARK_M = 0.02e-3, 0.01e-3
FOCAL_SHARE, MIDDLE_PX = 0.01, 8.0  # of the lens as it was bought: focal length; principal point per axis
CLAMPED_M = 0.5e-3  # of the tool's tip from where it was drawn, per axis
HUNG_M, HUNG_RAD = 0.02, 0.03  # of the camera from straight above the world's origin, per axis


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredRig:
    """``true``: the camera in the world, and the robot alpha, whose tool was drawn to be at TOOL. ``board`` is the true
    board, its drawing being BOARD.

    ``ruler`` (6, 3) m: alpha's LEDs as a ruler says. ``calipers``: the two LEDs of alpha that are farthest apart, and
    the distance that calipers say is between them, m.
    """

    true: Rig
    board: Robot
    ruler: Floats
    calipers: tuple[int, int, float]


def draw_rig(seed: int) -> MeasuredRig:
    """The rig of a seed; every seed has its own errors of everything."""
    rng = np.random.default_rng([seed, 6])
    camera, T_world_camera = drawn_camera(rng), _place(rng)
    leds = _flat(PLATE, PLATE_HEIGHT_M) + rng.normal(size=(LEDS, 3)) * [DRILLED_M, DRILLED_M, UPRIGHT_M]
    alpha = Robot("alpha", leds.round(7), led_radius=LED_RADIUS_M, points={"tool": _tool(seed)})
    board = _flat(BOARD, 0.0) + rng.normal(size=(LEDS, 3)) * [SOLDERED_M, SOLDERED_M, 0.0]
    return MeasuredRig(
        Rig(camera, (alpha,), RANGE_M, T_world_camera=T_world_camera),
        Robot("board", board.round(7), led_radius=LED_RADIUS_M),
        _by_ruler(alpha.leds, rng),
        _by_calipers(alpha.leds, rng),
    )


def _tool(seed: int) -> Floats:
    """Where the tool's tip really is, clamped by hand."""
    rng = np.random.default_rng([seed, 8])
    return np.array((np.array(TOOL) + CLAMPED_M * rng.normal(size=3)).round(7))


def _flat(drawn: tuple[tuple[float, float], ...], height: float) -> Floats:
    return np.array([(x, y, height) for x, y in drawn])


def drawn_camera(rng: np.random.Generator, name: str = "camera") -> Camera:
    """A lens that bends some pixels at the edge, bought as 1400 px."""
    focal = FOCAL_PX * (1.0 + FOCAL_SHARE * rng.normal())
    x, y = np.array([WIDTH_PX - 1, HEIGHT_PX - 1]) / 2.0 + MIDDLE_PX * rng.normal(size=2)
    matrix = np.array([[focal, 0.0, x], [0.0, focal * (1.0 + 1e-4 * rng.normal()), y], [0.0, 0.0, 1.0]]).round(3)
    distortion = [-0.11, 0.03, 0.0, 0.0, 0.0] + rng.normal(size=5) * [0.02, 0.01, 3e-4, 3e-4, 0.0]
    return Camera(name, WIDTH_PX, HEIGHT_PX, matrix, "plumb_bob", distortion.round(6))


def _place(rng: np.random.Generator) -> Pose:
    """T_world_camera: above the table, looking down, turned anyhow about its axis and a little askew."""
    askew = exp_rotation(HUNG_RAD * rng.normal(size=3) * [1.0, 1.0, 0.0])
    turned = exp_rotation(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)]))
    place = np.array([0.0, 0.0, HEIGHT_M]) + HUNG_M * rng.normal(size=3)
    return Pose.from_matrix(turned @ askew @ np.diag([1.0, -1.0, -1.0]), place.round(6))


def _by_ruler(leds: Floats, rng: np.random.Generator) -> Floats:
    """Every LED's x and y for itself; the height of the plate once."""
    read = leds + RULER_M * rng.normal(size=leds.shape)
    read[:, 2] = read[:, 2].mean()
    return np.round(read / RULER_MARK_M) * RULER_MARK_M


def _by_calipers(leds: Floats, rng: np.random.Generator) -> tuple[int, int, float]:
    apart = np.linalg.norm(leds[:, None] - leds[None], axis=-1)
    first, second = (int(led) for led in np.unravel_index(int(apart.argmax()), apart.shape))
    read = apart[first, second] + CALIPERS_M * rng.normal()
    return first, second, round(float(np.round(read / CALIPERS_MARK_M) * CALIPERS_MARK_M), 5)
