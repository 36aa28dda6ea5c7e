"""Films of robots on a surface for `tests.measure.surface`: one is lifted; the rig has the surface wrong.

`lifted`: five robots drive; one is lifted by 1 mm along the normal for fifteen frames, then set down. Every robot
stands off by a draw of its own that stays. Told by light alone: the first frame in which its distance, solved without a
surface, is 5 of its sigmas (the pose's, the stand's and the surface's together).

`wrong`: the rig has the surface 1 mm too high or too low, or turned by 0.5 degrees about its middle. In which frame
the watch says so (tests of false alarms: the same rig with nothing wrong), and what the poses are until then and after.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from asterism.protocol.geometry import Pose, exp_rotation
from asterism.protocol.rig import Rig
from asterism.protocol.surface import Surface
from asterism.server import PoseEstimate, Tracks, localize
from asterism.server.chain.frame import FrameResult
from asterism.server.service.surface_watch import SurfaceWatch
from asterism.server.simulation.simulate import Scene
from tests.measure.surface_bound import error_of, jacobian, moved, off_surface
from tests.measure.surface_cases import CASES, SIGMA_M, Case, drawn, rig_of, strayed
from tests.on_surface import places, stood

FRAMES, LIFTED_AT, DOWN_AT, LIFT_M = 40, 15, 30, 1e-3
STEP_M = 1e-3  # a frame
TELLS = 5.0  # sigmas
WRONG_M, TURNED_DEG = 1e-3, 0.5


def film(
    case: Case, seed: int, robots: int, frames: int, lifts: Callable[[int], float]
) -> Iterator[tuple[int, dict[str, Pose], Scene, Rig]]:
    """Truth T_world_robot frame by frame; ``lifts`` says by how much the first robot is lifted in a frame, m."""
    rig = rig_of(case, seed, robots)
    scene, rng = Scene(rig, seed, case.look), np.random.default_rng([seed, 51])
    starts, ways = places(rng, robots, case.half_m - STEP_M * frames / 2), rng.uniform(-np.pi, np.pi, robots)
    # How each robot stands off: the same in every frame.
    strays = [strayed(Pose.identity(), rng) for _ in range(robots)]
    for index in range(frames):
        gone = STEP_M * (index - frames / 2)
        truth = {}
        for k, (robot, (x, y, heading), way) in enumerate(zip(rig.robots, starts, ways, strict=True)):
            lift = lifts(index) if k == 0 else 0.0
            place = x + gone * np.cos(way), y + gone * np.sin(way)
            truth[robot.id] = stood(case.surface, *place, heading + 0.01 * index, lift) @ strays[k]
        yield index, truth, scene, rig


@dataclass
class Lifts:
    """What films of a lifted robot gave."""

    by_light: list[int] = field(default_factory=list)  # frames after the lift; -1: never
    noticed: list[int] = field(default_factory=list)
    back: list[int] = field(default_factory=list)
    told_but_on: int = 0  # frames in which light alone can tell, and the surface was used
    up: int = 0  # frames lifted
    up_off: int = 0  # of those without the surface
    nees_up: list[float] = field(default_factory=list)
    others: int = 0  # frames of robots on the surface
    others_off: int = 0
    nees: list[float] = field(default_factory=list)


def lifted(films: int, console: Console) -> None:
    """Measure and print."""
    table = Table(
        "", "films", "light tells in frame", "without from frame", "tells, but on", "without / lifted", "NEES lifted",
        "worst", "back after", "others off", "NEES", title="lifted by 1 mm", box=box.SIMPLE_HEAD, pad_edge=False,
    )  # fmt: skip
    for name in ("near", "far"):
        out = Lifts()
        for seed in range(films):
            _lift(CASES[name], seed, out)
        table.add_row(
            name, str(films), _range(out.by_light), _range(out.noticed), str(out.told_but_on), f"{out.up_off}/{out.up}",
            f"{np.mean(out.nees_up):.1f}", f"{max(out.nees_up):.1f}", _range(out.back),
            f"{out.others_off}/{out.others}", f"{np.mean(out.nees):.2f}",
        )  # fmt: skip
    console.print(table)


def _lift(case: Case, seed: int, out: Lifts) -> None:
    tracks, plain, by_light, noticed, back = Tracks.none(), Tracks.none(), -1, -1, -1
    for index, truth, scene, rig in film(
        case, seed, 5, FRAMES, lambda at: LIFT_M * (LIFTED_AT <= at < DOWN_AT)
    ):  # fmt: skip
        frame = drawn(scene, truth, index)
        result, tracks = localize(frame, rig, tracks)
        alone, plain = localize(frame, replace(rig, surface=None), plain)
        for name, standing, nees in standings(result, truth):
            if name != rig.robots[0].id:
                out.others, out.others_off = out.others + 1, out.others_off + (standing != "ON_SURFACE")
                out.nees.append(nees)
            elif LIFTED_AT <= index < DOWN_AT:
                tells = abs(sigmas_off(case.surface, alone.answers[name])) >= TELLS
                on = standing == "ON_SURFACE"
                by_light = index - LIFTED_AT if tells and by_light < 0 else by_light
                noticed = index - LIFTED_AT if not on and noticed < 0 else noticed
                out.told_but_on += tells and on
                out.up, out.up_off = out.up + 1, out.up_off + (not on)
                out.nees_up.append(nees)
            elif index >= DOWN_AT and standing == "ON_SURFACE" and back < 0:
                back = index - DOWN_AT
    out.by_light.append(by_light)
    out.noticed.append(noticed)
    out.back.append(back)


def standings(result: FrameResult, truth: dict[str, Pose]) -> Iterator[tuple[str, str, float]]:
    """Every located robot: its id, its standing, its squared error weighted by its covariance."""
    for name, answer in result.answers.items():
        if isinstance(answer, PoseEstimate):
            error = error_of(answer.pose, truth[name])
            standing = "" if answer.surface is None else answer.surface.standing
            yield name, standing, float(error @ np.linalg.solve(answer.covariance, error))


def sigmas_off(surface: Surface, answer: object) -> float:
    """How many sigmas light alone has a robot off the surface."""
    if not isinstance(answer, PoseEstimate):
        return 0.0
    by_pose = jacobian(lambda step: off_surface(surface, moved(answer.pose, step)))[0]
    variance = float(by_pose @ answer.covariance @ by_pose) + SIGMA_M**2
    return float(off_surface(surface, answer.pose)[0]) / np.sqrt(variance)


def _range(numbers: list[int]) -> str:
    """The median, the largest, and how many never were."""
    found = [number for number in numbers if number >= 0]
    never = len(numbers) - len(found)
    told = f"{np.median(found):g} (most {max(found)})" if found else "-"
    return told + (f", {never} never" if never else "")


@dataclass
class Wrongs:
    """What films with a wrong surface gave."""

    said: list[int] = field(default_factory=list)  # frames up to and with the one in which it is said
    sentence: str = ""
    off: int = 0  # poses without the surface
    nees: list[float] = field(default_factory=list)
    heights: list[float] = field(default_factory=list)  # errors along the camera's axis in sigmas of the pose
    worst_m: float = 0.0

    def cells(self) -> list[str]:
        """The figures as the table shows them."""
        return [
            _range(self.said),
            f"{self.off}/{len(self.nees)}",
            f"{np.mean(self.nees):.2f}",
            f"{max(self.nees):.1f}",
            f"{np.sqrt(np.mean(np.square(self.heights))):.2f}",
            f"{np.abs(self.heights).max():.1f}",
            f"{1e3 * self.worst_m:.2f}",
        ]


def wrong(films: int, console: Console) -> None:
    """Measure and print."""
    table = Table(
        "", "robots", "said in frame", "without", "NEES", "worst", "z RMS sigmas", "worst", "z worst mm",
        title="a rig whose surface is off", box=box.SIMPLE_HEAD, pad_edge=False,
    )  # fmt: skip
    sentences = []
    for name in ("near", "far"):
        for robots in (1, 5):
            for what, shift in _WRONGS.items():
                out = Wrongs()
                for seed in range(films):
                    _play(CASES[name], shift, seed, robots, out)
                table.add_row(f"{name}, {what}", str(robots), *out.cells())
                sentences.append(f"{name}, {what}, {robots}: {out.sentence}")
    console.print(table)
    for sentence in sentences:
        console.print(sentence, soft_wrap=True, markup=False, highlight=False)


_WRONGS = {
    "right": Pose.identity(),
    "1 mm too high": Pose(np.array([0.0, 0.0, WRONG_M]), np.array([0.0, 0.0, 0.0, 1.0])),
    "1 mm too low": Pose(np.array([0.0, 0.0, -WRONG_M]), np.array([0.0, 0.0, 0.0, 1.0])),
    "turned": Pose.from_matrix(exp_rotation(np.radians([TURNED_DEG, 0.0, 0.0])), np.zeros(3)),
}


def _play(case: Case, shift: Pose, seed: int, robots: int, out: Wrongs) -> None:
    said: list[str] = []
    tracks, at, watch = Tracks.none(), -1, None
    for index, truth, scene, rig in film(case, seed, robots, 30, lambda _: 0.0):
        told = replace(rig, surface=replace(case.surface, T_world_surface=shift @ case.surface.T_world_surface))
        watch = watch or SurfaceWatch(told, said.append)
        result, tracks = localize(drawn(scene, truth, index), told, tracks)
        watch.add(result)
        if said and at < 0:
            at, out.sentence = index + 1, said[0]
        for name, standing, nees in standings(result, truth):
            answer = result.answers[name]
            assert isinstance(answer, PoseEstimate)
            error = answer.position[2] - truth[name].position[2]
            out.off += standing != "ON_SURFACE"
            out.nees.append(nees)
            out.heights.append(error / np.sqrt(answer.covariance[2, 2]))
            out.worst_m = max(out.worst_m, abs(float(error)))
    out.said.append(at)


FILMS = {"lifted": lifted, "wrong": wrong}
