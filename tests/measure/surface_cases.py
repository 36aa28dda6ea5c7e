"""What `tests.measure.surface` stages: surfaces that are seen somehow, and robots that stand on them not quite as told.

The rig has the surface as it is on average; every sighting has its own draw of how far the robot stands off it. Where
the rig has a grid of heights, the truth still stands on the quadric that the grid was taken from.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.protocol.rig import Rig
from asterism.protocol.surface import Heights, Quadric, Surface
from asterism.server import Frame
from asterism.server.simulation.simulate import Look, Scene, Truth
from tests.on_surface import BENT, TOOL, height, places, rig_on, stood

SIGMA_M, TILT_DEG = 5e-5, 0.05
ROBOTS, RIGS = 5, 8
OWN, DIM = Look(), Look(brightness=40.0, read_noise=2.0)
FLAT = Surface(Quadric.plane(np.zeros(3), np.array([0.0, 0.0, 1.0])))
STRONG = Surface(Quadric(np.array([0.0, 0.1, 0.0, 1.0, 1.2, -0.9, 0.0, 0.8, 0.0, 0.0])))  # slopes up to 0.6
BALL_M = 0.6
SPHERE = Surface(
    Quadric(np.array([-(BALL_M**2), 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0]), np.array([0.0, 0.0, -BALL_M]))
)
GRID_M, GRID_HALF = 0.01, 35  # pitch, and nodes to either side


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """One kind of sightings: how many LEDs are ``seen``, how far off the rig has each of them (``leds_off_m``), whether
    the rig has the surface as a ``grid`` of heights.
    """

    name: str
    surface: Surface = BENT
    distance_m: float = 1.3
    look: Look = OWN
    seen: int = 6
    half_m: float = 0.25
    leds_off_m: float = 0.0
    grid: bool = False


CASES = {
    "near": Case("own light, 1.3 m"),
    "far": Case("dim LEDs, 2 m", distance_m=2.0, look=DIM),
    "five": Case("5 LEDs seen, 1.3 m", seen=5),
    "four": Case("4 LEDs seen, 1.3 m", seen=4),
    "frontal": Case("frontal: a plane below the camera, 1.3 m", FLAT, half_m=0.2),
    "strong": Case("strongly bent, 1.3 m", STRONG, half_m=0.2),
    "sphere": Case("a sphere of 0.6 m, 1.3 m", SPHERE, half_m=0.2),
    "grid": Case("a grid of heights, 1.3 m", grid=True),
    "leds": Case("LEDs off by 0.05 mm, 1.3 m", leds_off_m=5e-5),
    "leds-far": Case("LEDs off by 0.05 mm, dim, 2 m", distance_m=2.0, look=DIM, leds_off_m=5e-5),
}


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """A frame and where its robots are: ``truth`` T_world_robot by id, in the ``scene`` that drew it."""

    frame: Frame
    rig: Rig
    scene: Scene
    truth: dict[str, Pose]
    lit: dict[str, tuple[bool, ...]]


def sightings(case: Case, draws: int) -> Iterator[Sighting]:
    """Frames of five robots each, so that ``draws`` robots are seen; every one stands off by a draw of its own."""
    rigs = [rig_of(case, seed) for seed in range(RIGS)]
    scenes = [Scene(rig, seed, case.look) for seed, rig in enumerate(rigs)]
    for number in range(-(-draws // ROBOTS)):
        rng = np.random.default_rng([number, 15])
        rig, scene = rigs[number % RIGS], scenes[number % RIGS]
        if case.leds_off_m:
            scene = Scene(with_leds_off(rig, rng, case.leds_off_m), number, case.look)
        standing = zip(rig.robots, places(rng, ROBOTS, case.half_m), strict=True)
        truth = {robot.id: strayed(stood(case.surface, *place), rng) for robot, place in standing}
        lit = {robot.id: _lit(rng, case.seen) for robot in rig.robots}
        yield Sighting(drawn(scene, truth, number, lit), rig, scene, truth, lit)


def rig_of(case: Case, seed: int, robots: int = ROBOTS) -> Rig:
    """The rig as its owner has it."""
    rig = rig_on(case.surface, robots, case.distance_m, SIGMA_M, TILT_DEG, seed)
    return replace(rig, surface=as_grid(case.surface)) if case.grid else rig


def as_grid(surface: Surface) -> Surface:
    """A quadric's heights, by bisection, at the nodes of a grid."""
    ticks = np.arange(-GRID_HALF, GRID_HALF + 1) * GRID_M
    values = np.array([[height(surface, x, y) for y in ticks] for x in ticks])
    shape = Heights(np.full(2, ticks[0]), np.full(2, GRID_M), values, np.zeros_like(values))
    return Surface(shape, surface.T_world_surface)


def strayed(pose: Pose, rng: np.random.Generator) -> Pose:
    """The same robot off the surface along the normal and tilted about its tool, by as much as the rig says."""
    off, tilts = rng.normal(0.0, SIGMA_M), rng.normal(0.0, np.radians(TILT_DEG), 2)
    turn = exp_rotation(np.array([*tilts, 0.0]))
    return pose @ Pose.from_matrix(turn, TOOL - turn @ TOOL + np.array([0.0, 0.0, off]))


def with_leds_off(rig: Rig, rng: np.random.Generator, sigma_m: float) -> Rig:
    """The robots as they are, where the rig has them a little otherwise."""
    return replace(
        rig, robots=tuple(replace(robot, leds=robot.leds + rng.normal(0.0, sigma_m, (6, 3))) for robot in rig.robots)
    )


def drawn(scene: Scene, truth: dict[str, Pose], index: int, lit: dict[str, tuple[bool, ...]] | None = None) -> Frame:
    """What the scene's camera sees of robots at T_world_robot, in the rig's order."""
    assert scene.rig.T_world_camera is not None
    T_camera_world = scene.rig.T_world_camera.inverse()
    told = [
        Truth(robot.id, T_camera_world @ truth[robot.id], (lit or {}).get(robot.id, (True,) * 6))
        for robot in scene.rig.robots
    ]
    return Frame(scene.render(index, told), exposed_ns=(index + 1) * 16_666_667, index=index)


def _lit(rng: np.random.Generator, seen: int) -> tuple[bool, ...]:
    lit: Floats = np.ones(6)
    lit[rng.permutation(6)[seen:]] = 0.0
    return tuple(bool(led) for led in lit)
