"""Who is who for several cameras that see three or four LEDs each: `python -m tests.measure.joined_identity`.

`drawn`: spots at their true places with noise (0.05 px an axis), which no camera claims, found from each exposure
alone. `rendered [frames]`: rendered films, located by each camera's own chain, cold (every frame alone) and followed.
Of a robot two cameras see three or four LEDs each, random ones. "wrong": more than 5 mm or 3 degrees off, or beyond
one in a million of its covariance; "tilt": two poses were told, of which the likelier is off and the other right.
"""

import argparse
import math
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from rich.console import Console
from rich.table import Table

from asterism.protocol.geometry import Pose, log_rotation
from asterism.protocol.rig import Rig
from asterism.server.chain.frame import Frame
from asterism.server.chain.pipeline import localize
from asterism.server.chain.report import frame_report
from asterism.server.fusing.fleet import Fleet, View
from asterism.server.fusing.fuse import fuse
from asterism.server.fusing.fused import FusedPose
from asterism.server.fusing.memory import Joint
from asterism.server.fusing.sighting import Sighting, sighting_of
from asterism.server.pose.solve import Lost
from asterism.server.pose.track import Tracks
from asterism.server.simulation.simulate import Look
from tests.fusing.spotted import drawn
from tests.several import Drive, facing_pair, frames_of, looking_at, rigs_at

FAR_M, FAR_RAD = 0.005, math.radians(3.0)
BEYOND = 38.3  # chi squared of six degrees of freedom: one in a million
PERIOD_NS = 16_666_667


@dataclass(frozen=True, slots=True)
class Case:
    """``robots`` in view of two cameras ``degrees`` apart, or of ``cameras``; ``glints`` in each frame; robots of these
    that are ``hidden``, and that are ``strangers``: lit, but in no rig. ``film``: the same LEDs are seen throughout.
    """

    robots: int
    degrees: float = 60.0
    glints: int = 0
    hidden: int = 0
    strangers: int = 0
    film: bool = False
    cameras: int = 2

    @property
    def name(self) -> str:
        """What it is, in words."""
        words = [f"{self.robots} robots" if self.robots > 1 else "1 robot", f"{self.degrees:g} degrees"]
        words += [f"{self.cameras} cameras"] * (self.cameras > 2) + [f"{self.glints} glints"] * (self.glints > 0)
        words += ["one hidden"] * self.hidden + ["a stranger"] * self.strangers + ["LEDs of a film"] * self.film
        return ", ".join(words)


CASES = (
    *(Case(robots, glints=glints, film=film) for robots in (1, 3, 6) for glints in (0, 10) for film in (False, True)),
    *(Case(3, degrees, 10) for degrees in (30.0, 120.0)),
    Case(2, hidden=1, glints=10),
    Case(2, strangers=1, glints=10),
    Case(10, glints=20, cameras=3),
)


class Lights:
    """Which LEDs each camera sees of each robot: three or four, random ones, of each frame or of a whole film."""

    def __init__(self, case: Case, seed: int) -> None:
        self.case, self.seed = case, seed

    def __call__(self, camera: str, robot: str, frame: int) -> tuple[bool, ...]:
        number = int(robot[1:])
        if number < self.case.hidden:
            return (False,) * 6
        key = [self.seed, sum(camera.encode()), number, 0 if self.case.film else frame]
        rng = np.random.default_rng(key)
        seen = rng.choice(6, rng.integers(3, 5), replace=False)
        return tuple(led in seen for led in range(6))


def rigs_of(case: Case, seed: int) -> list[Rig]:
    """Rigs of all that is lit; the last robots are strangers."""
    places = facing_pair(case.degrees)
    if case.cameras > 2:
        places.append(looking_at(np.array([0.0, 0.6, 1.15]), np.zeros(3), 0.2))
    return rigs_at(places, case.robots + case.strangers, seed)


def known(rig: Rig, case: Case) -> Rig:
    """The rig as it is believed."""
    return replace(rig, robots=rig.robots[: case.robots])


def drive_of(case: Case, rigs: list[Rig], seed: int) -> Drive:
    """Where robots drive: several of them farther apart, as bodies are."""
    apart = 0.2 if case.robots < 6 else 0.3
    return Drive(tuple(robot.id for robot in rigs[0].robots), seed, apart_m=apart)


Exposure = tuple[dict[str, Pose], list[Sighting]]


def drawn_exposures(case: Case, count: int, seed: int) -> Iterator[Exposure]:
    """Exposures of drawn spots, far apart in time."""
    rigs, rng, lights = rigs_of(case, seed), np.random.default_rng([seed, 1]), Lights(case, seed)
    drive = drive_of(case, rigs, seed)
    for frame in range(count):
        poses, sightings = drive(0.37 * frame), []
        everybody = {robot.id: (robot, poses[robot.id]) for robot in rigs[0].robots}
        for rig in rigs:
            lit = {robot: np.flatnonzero(lights(rig.camera.name, robot, frame)) for robot in everybody}
            sighting = drawn(known(rig, case), everybody, lit, rng, case.glints, exposed_ns=frame * 370_000_000)
            sightings.append(sighting)
        yield poses, sightings


def rendered_exposures(case: Case, count: int, seed: int, alone: bool) -> Iterator[Exposure]:
    """Exposures of rendered frames, each camera's chain beginning anew with every frame, or following."""
    rigs, lights = rigs_of(case, seed), Lights(case, seed)
    drive = drive_of(case, rigs, seed)
    period = 370_000_000 if alone else PERIOD_NS
    times = [frame * period for frame in range(count)]
    films = [frames_of(rig, drive, times, lights, Look(glints=case.glints), seed) for rig in rigs]
    views, tracks = [View(known(rig, case)) for rig in rigs], [Tracks.none() for _ in rigs]
    for time_ns, *frames in zip(times, *films, strict=True):
        sightings = []
        for k, (frame, view) in enumerate(zip(frames, views, strict=True)):
            sighting, tracks[k] = _located(frame, view, Tracks.none() if alone else tracks[k])
            sightings.append(sighting)
        yield drive(time_ns * 1e-9), sightings


def _located(frame: Frame, view: View, tracks: Tracks) -> tuple[Sighting, Tracks]:
    result, tracks = localize(frame, view.rig, tracks)
    return sighting_of(frame_report(frame, result, view.rig, frame.exposed_ns), view), tracks


def is_off(pose: Pose, covariance: np.ndarray, truth: Pose) -> str:
    """How a pose is wrong; empty if it is not."""
    away, turn = pose.position - truth.position, log_rotation(pose.rotation @ truth.rotation.T)
    if np.linalg.norm(away) > FAR_M or np.linalg.norm(turn) > FAR_RAD:
        return f"{1e3 * np.linalg.norm(away):.2f} mm, {np.degrees(np.linalg.norm(turn)):.2f} degrees"
    off = np.concatenate([away, turn])
    chi2 = float(off @ np.linalg.solve(covariance, off))
    return f"chi squared {chi2:.0f}" if chi2 > BEYOND else ""


def judged(answer: FusedPose | Lost, truth: Pose) -> tuple[str, str]:
    """What became of a robot that is there, and how far off it is."""
    if isinstance(answer, Lost):
        return ("doubt" if answer.state == "IDENTITY_AMBIGUOUS" else "lost"), answer.reason
    off = is_off(answer.pose, answer.covariance, truth)
    if not off:
        return "found", ""
    other = answer.alternative
    if other is not None and not is_off(other.pose, 4.0 * answer.covariance, truth):
        return "tilt", off
    return "wrong", off


@dataclass
class Tally:
    """What was counted in a case; seconds that fuse() took."""

    counts: Counter[str]
    seconds: list[float]


def tally(case: Case, exposures: Iterator[Exposure], alone: bool, console: Console) -> Tally:
    """Fuse all exposures, each alone or with what was before."""
    joint, total = Joint.none(), Tally(Counter(), [])
    fleet: Fleet | None = None
    for number, (poses, sightings) in enumerate(exposures):
        fleet = fleet or Fleet.of([sighting.view for sighting in sightings])
        began = time.thread_time()
        fused, after = fuse(sightings, fleet, Joint.none() if alone else joint)
        total.seconds.append(time.thread_time() - began)
        joint = after
        for robot, answer in fused.answers.items():
            if int(robot[1:]) < case.hidden:
                total.counts["ghost"] += isinstance(answer, FusedPose)
                continue
            what, why = judged(answer, poses[robot])
            total.counts[what] += 1
            if what in ("wrong", "tilt"):
                console.print(f"  {case.name}: exposure {number}, {robot}: {what}, {why}")
    return total


def _table(title: str) -> Table:
    table = Table(title=title)
    for column in ("case", "robots", "found", "wrong", "tilt", "doubt", "ghosts", "median ms", "worst ms"):
        table.add_column(column, justify="left" if column == "case" else "right")
    return table


def _row(table: Table, case: Case, told: Tally) -> None:
    n = sum(told.counts[what] for what in ("found", "wrong", "tilt", "doubt", "lost"))
    share = [f"{100 * told.counts[what] / max(n, 1):.2f} %" for what in ("found",)]
    rest = [str(told.counts[what]) for what in ("wrong", "tilt", "doubt", "ghost")]
    times = 1e3 * np.array(told.seconds[1:] or [0.0])
    table.add_row(case.name, str(n), *share, *rest, f"{np.median(times):.1f}", f"{times.max():.1f}")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("how", choices=["drawn", "cold", "followed"], nargs="?", default="drawn")
    parser.add_argument("--frames", type=int, default=300, help="exposures of each case")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=int, help="number of the only case")
    arguments = parser.parse_args()
    console = Console(width=120)
    table = _table({"drawn": "drawn spots, every exposure alone", "cold": "rendered, every frame alone",
                    "followed": "rendered, followed"}[arguments.how])  # fmt: skip
    for case in CASES if arguments.only is None else CASES[arguments.only :][:1]:
        alone = arguments.how != "followed"
        if arguments.how == "drawn":
            exposures = drawn_exposures(case, arguments.frames, arguments.seed)
        else:
            exposures = rendered_exposures(case, arguments.frames, arguments.seed, alone)
        told = tally(case, exposures, alone, console)
        print(case.name, dict(told.counts), flush=True)
        _row(table, case, told)
    console.print(table)


if __name__ == "__main__":
    main()
