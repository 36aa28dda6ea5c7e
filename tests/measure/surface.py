"""Poses of robots on a surface beside the bound that the surface is part of: `python -m tests.measure.surface`.

`python -m tests.measure.surface [CASE ...] [--seeds N]`: N robots a case (default 200; films: N / 10), rendered, each
frame alone; the rig knows the surface to 0.05 mm and 0.05 degrees, and every sighting stands off it by a draw of its
own. A case: RMS errors in the world by light alone and with the surface, the Cramer-Rao bound of both
(surface_bound.py), errors over bound (root mean of squares, each over its own bound), NEES (6 where covariances are
meant) with its standard error, TILT_AMBIGUOUS, wrong (more than 20 mm or 5 degrees off), not ON_SURFACE. The cases
`lifted` and `wrong` are films (surface_films.py): a robot that is lifted, a rig whose surface is off.
"""

import argparse
from dataclasses import dataclass, field, replace

import numpy as np
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

from asterism.protocol.geometry import Floats, Pose
from asterism.server import PoseEstimate, Tracks, localize
from tests.measure.surface_bound import bounds_of, error_of
from tests.measure.surface_cases import CASES, ROBOTS, Case, Sighting, sightings
from tests.measure.surface_films import FILMS

FAR_OFF_M, TILTED_RAD = 0.02, np.radians(5.0)
SCALES = np.array([1e6] * 3 + [1e3 * 180 / np.pi] * 3)  # to micrometres and thousandths of a degree
WIDTH = 110


@dataclass
class Poses:
    """What one way of solving gave: errors (6,), their bounds' and own covariances (6, 6)."""

    errors: list[Floats] = field(default_factory=list)
    bounds: list[Floats] = field(default_factory=list)
    nees: list[float] = field(default_factory=list)
    wrong: int = 0
    tilts: int = 0
    off: int = 0
    lost: int = 0

    def add(self, answer: object, true: Pose, bound: Floats) -> None:
        """One more robot."""
        if not isinstance(answer, PoseEstimate):
            self.lost += 1
            return
        self.tilts += answer.alternative is not None
        self.off += answer.surface is None or answer.surface.standing != "ON_SURFACE"
        error = error_of(answer.pose, true)
        if np.linalg.norm(error[:3]) > FAR_OFF_M or np.linalg.norm(error[3:]) > TILTED_RAD:
            self.wrong += 1
            return
        self.errors.append(error)
        self.bounds.append(np.diag(bound))
        self.nees.append(float(error @ np.linalg.solve(answer.covariance, error)))

    @property
    def rms(self) -> Floats:
        """(6,) in m and rad."""
        return np.sqrt(np.mean(np.square(self.errors), axis=0))

    @property
    def least(self) -> Floats:
        """(6,): the bound."""
        return np.sqrt(np.mean(self.bounds, axis=0))

    @property
    def ratios(self) -> Floats:
        """(6,): errors over bound."""
        return np.sqrt(np.mean(np.square(self.errors) / np.array(self.bounds), axis=0))

    def told(self) -> str:
        """NEES and its standard error."""
        return f"{np.mean(self.nees):.2f} ±{np.std(self.nees) / np.sqrt(len(self.nees)):.2f}"


def measured(case: Case, draws: int) -> tuple[Poses, Poses, int]:
    """Poses by light alone, and with the surface; how often an answer's own `without` is not what light alone gives."""
    light, both, other = Poses(), Poses(), 0
    frames = -(-draws // ROBOTS)
    for sighting in track(sightings(case, draws), case.name, frames, transient=True):
        other += _add(case, sighting, light, both)
    return light, both, other


def _add(case: Case, sighting: Sighting, light: Poses, both: Poses) -> int:
    rig, other = sighting.rig, 0
    with_surface, _ = localize(sighting.frame, rig, Tracks.none())
    without, _ = localize(sighting.frame, replace(rig, surface=None), Tracks.none())
    for number, robot in enumerate(rig.robots):
        by_light, by_both = bounds_of(case, sighting, number)
        alone, answer = without.answers[robot.id], with_surface.answers[robot.id]
        light.add(alone, sighting.truth[robot.id], by_light)
        both.add(answer, sighting.truth[robot.id], by_both)
        if isinstance(answer, PoseEstimate) and answer.surface is not None and isinstance(alone, PoseEstimate):
            told = answer.surface.without or answer.pose
            other += not np.allclose(told.position, alone.position, atol=1e-9)
    return other


def shown(case: Case, light: Poses, both: Poses, other: int, console: Console) -> None:
    """One case's table."""
    table = Table(
        "", "x um", "y um", "z um", "rx mdeg", "ry mdeg", "rz mdeg", "NEES", "wrong", "tilts",
        title=case.name, box=box.SIMPLE_HEAD, pad_edge=False, title_justify="left",
    )  # fmt: skip
    for name, poses in (("light alone", light), ("with the surface", both)):
        table.add_row(name, *_cells(poses.rms * SCALES, 1), poses.told(), str(poses.wrong), str(poses.tilts))
        table.add_row("  bound", *_cells(poses.least * SCALES, 1))
        table.add_row("  over bound", *_cells(poses.ratios, 2))
    table.add_row("gain", *_cells(light.rms / both.rms, 2))
    console.print(table)
    n = len(both.errors) + both.wrong
    console.print(
        f"{n} located ({both.lost} lost, {light.lost} by light alone), {both.off} not ON_SURFACE, "
        f"{other} whose `without` is not what light alone gives\n"
    )


def _cells(values: Floats, digits: int) -> list[str]:
    return [f"{value:.{digits}f}" for value in values]


def main() -> None:
    """Measure and print."""
    part = argparse.ArgumentParser()
    part.add_argument("cases", nargs="*", metavar="CASE", help=", ".join([*CASES, *FILMS]))
    part.add_argument("--seeds", type=int, default=200)
    options = part.parse_args()
    console = Console(width=WIDTH)
    for name in options.cases or [*CASES, *FILMS]:
        if name in CASES:
            shown(CASES[name], *measured(CASES[name], options.seeds), console)
        else:
            FILMS[name](max(1, options.seeds // 10), console)


if __name__ == "__main__":
    main()
