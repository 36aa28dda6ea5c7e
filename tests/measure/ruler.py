"""A rig from a ruler: found, wrong, and how honest, against what the rig has wrong: `python -m tests.measure.ruler`.

Eight robots with constellations of `asterism design`, all six LEDs lit, about 1.3 m before a camera with f = 1400 px.
The rig is told LED positions that are off by a normal error an axis of the plate, a focal length that is 2 % off, or a
lens without its distortion (k1 = -0.1). Rigs are drawn, and a few frames each; centres are drawn with their own noise,
no image is rendered. A row: robots found of those in view; wrong, that is with a spot that is not its LED's, or more
than 20 mm and five sigma off; of these, with a spot that is not its LED's; silent: squared error of 60 covariances or
more, tilt not flagged; share flagged TILT_AMBIGUOUS; LEDs left out a robot; NEES over the expected 5.35, median and
mean, without flagged poses that are the other tilt; ms a frame, median. `alone`: frames without memory; `film`: the
last ten frames of a film.

The truth is that of the robots' own frames; errors of a rig that has focal length or distortion wrong, which no pose
can know, say nothing and are left out.
"""

import argparse
import time
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from asterism.protocol.camera import Camera
from asterism.protocol.geometry import Floats, Pose, exp_rotation, log_rotation
from asterism.protocol.rig import Rig, Robot
from asterism.server.design.plate_design import Request, design
from asterism.server.identity.identify import identify
from asterism.server.identity.plan import Plan
from asterism.server.identity.rays import Rays
from asterism.server.pose.choose import Choices, choose
from asterism.server.pose.lens import undistort
from asterism.server.pose.matched import Matched, Measured
from asterism.server.pose.solve import Solutions, solve_robots
from asterism.server.pose.track import Tracks
from tests.chain.frames import poses_apart
from tests.chain.judging import TILTED_RAD
from tests.measure.line_plot import Axis, draw_lines

SIGMA_PX = 0.015
ROBOTS = 8
MEDIAN = 5.35  # of chi squared with six degrees of freedom
DESIGNS = ((0.10, 0.020), (0.10, 0.018), (0.09, 0.018), (0.11, 0.022))  # diameter of the plates, spacing, m
DISTORTION = np.array([-0.1, 0.0, 0.0, 0.0, 0.0])
SILENT = 60.0  # squared error, in units of the covariance, beyond which a pose is wrong in silence
SURE = 100.0  # odds of a tilt beyond which it is not flagged
FILM = 140
WORK = 30_000  # of the search for constellations: a small part of what the command spends


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """A ``true`` rig, and the one that was measured, ``told``, with its plan."""

    true: Rig
    told: Rig
    plan: Plan


@dataclass
class Row:
    """What frames of one kind gave."""

    seen: int = 0
    found: int = 0
    wrong: int = 0
    labels: int = 0
    silent: int = 0
    flagged: int = 0
    left_out: int = 0
    nees: list[float] = field(default_factory=list)
    ms: list[float] = field(default_factory=list)

    def cells(self) -> list[str]:
        """As the table shows them."""
        told = [
            f"{self.found}/{self.seen}",
            f"{self.found / max(self.seen, 1):.1%}",
            str(self.wrong),
            str(self.labels),
            str(self.silent),
        ]
        told += [f"{self.flagged / max(self.found, 1):.1%}", f"{self.left_out / max(self.found, 1):.2f}"]
        ratio = np.array(self.nees) / MEDIAN
        told += [f"{np.median(ratio):.2f}", f"{np.mean(ratio) * MEDIAN / 6.0:.2f}"] if len(ratio) else ["-", "-"]
        return [*told, f"{np.median(self.ms):.2f}"]


@lru_cache(maxsize=8)
def layouts_of(which: int) -> Floats:
    """(8, 6, 2) m of one of the DESIGNS."""
    disc, spacing = DESIGNS[which % len(DESIGNS)]
    found: Floats = design(Request(ROBOTS, disc, spacing, 1.5, 0.05), WORK).layouts
    return found


def camera_of(focal: float, distortion: Floats) -> Camera:
    """1280 x 1024."""
    matrix = np.array([[focal, 0.0, 643.0], [0.0, focal, 508.0], [0.0, 0.0, 1.0]])
    return Camera("test", 1280, 1024, matrix, "plumb_bob", distortion)


def draw_rig(seed: int, led_m: float, focal: float = 1.0, distorted: bool = False, bad: int = ROBOTS) -> Drawn:
    """LED positions off by ``led_m`` an axis, one sigma, of the first ``bad`` robots; told focal length over the true
    one; a lens whose distortion is not told.
    """
    rng = np.random.default_rng([seed, 77])
    layouts = layouts_of(seed)
    names = [f"r{k:02d}" for k in range(ROBOTS)]
    true = [
        Robot(name, np.column_stack([xy, np.zeros(6)]), led_radius=0.0017)
        for name, xy in zip(names, layouts, strict=True)
    ]
    off = led_m * rng.normal(size=(ROBOTS, 6, 2))
    off[bad:] = 0.0
    told = [replace(robot, leds=robot.leds + np.column_stack([off[k], np.zeros(6)])) for k, robot in enumerate(true)]
    is_true = Rig(camera_of(1400.0, DISTORTION if distorted else np.zeros(5)), tuple(true), range_m=(0.8, 2.0))
    is_told = Rig(camera_of(1400.0 * focal, np.zeros(5)), tuple(told), range_m=(0.8, 2.0))
    return Drawn(is_true, is_told, Plan(is_told))


def rays_of(drawn: Drawn, poses: dict[str, Pose], rng: np.random.Generator) -> tuple[Rays, Floats, Floats]:
    """Spots as the chain would see them, shuffled; their centres (n, 2) px; and whose they are (n, 2): robot, LED."""
    pixels, radii, heights, owner = [], [], [], []
    camera = drawn.true.camera
    for k, robot in enumerate(drawn.true.robots):
        pose = poses[robot.id]
        places = pose.map(robot.leds)
        facing = -places @ pose.rotation[:, 2] / np.linalg.norm(places, axis=1)
        pixels.append(camera.project(places) + SIGMA_PX * rng.normal(size=(6, 2)))
        radii.append(0.0017 * 1400.0 / places[:, 2] * np.sqrt(facing) + 0.5)
        heights.append(170.0 * facing * rng.uniform(0.9, 1.1, 6))
        owner.append(np.column_stack([np.full(6, k), np.arange(6)]))
    order = rng.permutation(6 * len(pixels))
    centres = np.concatenate(pixels)[order]
    n = len(centres)
    variances = np.full(n, SIGMA_PX**2)
    rays, covariances = np.empty((n, 2)), np.empty((n, 3))
    undistort(drawn.plan.lens, centres, np.column_stack([variances, np.zeros(n), variances]), rays, covariances)
    flat = rays * [drawn.plan.focal, -drawn.plan.focal]
    mean = 0.5 * (covariances[:, 0] + covariances[:, 2])
    seen = Rays(
        np.arange(n), flat, rays, covariances, mean, np.concatenate(heights)[order], np.concatenate(radii)[order]
    )
    return seen, centres, np.concatenate(owner)[order]


def located(
    seen: Rays, centres: Floats, plan: Plan, tracks: Tracks, exposed_ns: int
) -> tuple[Matched, Solutions, Choices]:
    """The chain behind the centres; the tracks are written."""
    learned = tracks.learned_at(exposed_ns)
    found = identify(seen, plan, tracks, exposed_ns).found
    solutions, choices = Solutions.room(len(found.ts), learned[found.robots]), Choices.room(len(found.ts))
    solve_robots(plan.lens, plan.constellations, found, Measured(seen.rays, seen.covariances, centres), solutions)
    choose(found, exposed_ns, solutions, seen.heights, plan.mounts, tracks, choices)
    return found, solutions, choices


def judge(
    row: Row, drawn: Drawn, poses: dict[str, Pose], owner: Floats, told: tuple[Matched, Choices], exact: bool
) -> None:
    """Count one frame's answers in; ``exact``: the lens is told as it is, so that poses have errors to be weighed."""
    found, choices = told
    row.seen += ROBOTS
    for k, robot in enumerate(found.robots.tolist()):
        if choices.best[k] < 0:
            continue
        row.found += 1
        labels = found.assignment[k]
        row.left_out += int((labels < 0).sum())
        mine = [tuple(owner[spot]) == (robot, led) for led, spot in enumerate(labels) if spot >= 0]
        true = poses[drawn.true.robots[robot].id]
        position = choices.positions[k, 0]
        scale = drawn.told.camera.matrix[0, 0] / drawn.true.camera.matrix[0, 0]
        other = choices.positions[k, 1] if choices.odds[k] < SURE else position
        away = min(np.linalg.norm(p - true.position * [1, 1, scale]) for p in (position, other))
        sigma = np.sqrt(np.linalg.eigvalsh(choices.covariances[k, :3, :3])[-1])
        row.wrong += not all(mine) or (exact and bool(away > max(0.02, 5.0 * sigma)))
        row.labels += not all(mine)
        is_flagged = bool(choices.odds[k] < SURE)
        row.flagged += is_flagged
        if exact:
            turn = Pose(np.zeros(3), choices.quaternions[k, 0]).rotation
            error = np.concatenate([position - true.position, log_rotation(turn @ true.rotation.T)])
            nees = float(error @ np.linalg.solve(choices.covariances[k], error))
            if is_flagged and np.linalg.norm(error[3:]) > TILTED_RAD:
                continue  # the other tilt, which is told
            row.silent += nees > SILENT
            row.nees.append(nees)


def alone(drawn: Drawn, frames: int, row: Row, seed: int, exact: bool) -> None:
    """Frames without memory."""
    rng = np.random.default_rng([seed, 78])
    for _ in range(frames):
        poses = poses_apart(drawn.true, rng, depth_m=(1.15, 1.45), tilt_deg=(0.0, 45.0))
        seen, centres, owner = rays_of(drawn, poses, rng)
        start = time.perf_counter()
        found, _, choices = located(seen, centres, drawn.plan, Tracks.none(ROBOTS), 1)
        row.ms.append(1e3 * (time.perf_counter() - start))
        judge(row, drawn, poses, owner, (found, choices), exact)


def film(drawn: Drawn, row: Row, seed: int, exact: bool) -> None:
    """A film at 60 Hz of robots that sway and turn where they stand; its last ten frames count."""
    rng = np.random.default_rng([seed, 79])
    start = poses_apart(drawn.true, rng, depth_m=(1.15, 1.45), tilt_deg=(5.0, 40.0))
    turns = {name: np.clip(rng.normal(size=3), -2, 2) * [0.1, 0.1, 1.0] for name in start}
    tracks = Tracks.none(ROBOTS)
    for frame in range(FILM):
        swing = np.sin(2.0 * np.pi * frame / 90.0)
        poses = {
            name: pose @ Pose.from_matrix(exp_rotation(turns[name] * [swing, swing, frame / 60.0]), np.zeros(3))
            for name, pose in start.items()
        }
        seen, centres, owner = rays_of(drawn, poses, rng)
        began = time.perf_counter()
        found, _, choices = located(seen, centres, drawn.plan, tracks, 1_000_000_000 + frame * 16_666_667)
        row.ms.append(1e3 * (time.perf_counter() - began))
        if frame >= FILM - 10:
            judge(row, drawn, poses, owner, (found, choices), exact)


CASES: dict[str, dict[str, float]] = {
    "true rig": {"led_m": 0.0},
    "LEDs 0.05 mm": {"led_m": 0.05e-3},
    "LEDs 0.1 mm": {"led_m": 0.1e-3},
    "LEDs 0.2 mm": {"led_m": 0.2e-3},
    "LEDs 0.3 mm": {"led_m": 0.3e-3},
    "LEDs 0.5 mm": {"led_m": 0.5e-3},
    "LEDs 1.0 mm": {"led_m": 1.0e-3},
    "one plate 0.5 mm": {"led_m": 0.5e-3, "bad": 1},
    "f + 2 %": {"led_m": 0.0, "focal": 1.02},
    "f - 2 %": {"led_m": 0.0, "focal": 0.98},
    "no distortion told": {"led_m": 0.0, "distorted": True},
    "all three, 0.3 mm": {"led_m": 0.3e-3, "focal": 1.02, "distorted": True},
}


def plot(measured: dict[str, dict[str, Row]], out: Path) -> None:
    """Found, and flagged, against how far off LED positions are; rigs that have something else wrong are left out."""
    only = {name: 1000 * CASES[name]["led_m"] for name in measured if CASES[name].keys() == {"led_m"}}
    lines = {}
    for kind, said in (("alone", "each frame alone"), ("film", "followed")):
        rows = [measured[name][kind] for name in only]
        lines[f"found, {said}"] = list(only.values()), [100 * row.found / row.seen for row in rows]
        lines[f"ambiguous, {said}"] = list(only.values()), [100 * row.flagged / max(row.found, 1) for row in rows]
    across = Axis("LED positions off by, one sigma a coordinate, mm", (0, 0.1, 0.2, 0.3, 0.5, 1.0), (-0.01, 1.01))
    draw_lines(lines, across, Axis("% of robots", (0, 20, 40, 60, 80, 100), (0.0, 100.0)), out)


def main(rigs: int, frames: int, cases: list[str], out: Path | None) -> None:
    """Measure, print, plot."""
    table = Table(title=f"{rigs} rigs", box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in (
        "rig",
        "",
        "found",
        "",
        "wrong",
        "labels",
        "silent",
        "ambiguous",
        "left out",
        "NEES: median",
        "mean",
        "ms",
    ):
        table.add_column(heading, justify="left" if heading == "rig" else "right", no_wrap=True)
    measured = {}
    for name in cases:
        kinds = CASES[name]
        exact = "focal" not in kinds and "distorted" not in kinds
        measured[name] = rows = {"alone": Row(), "film": Row()}
        for seed in range(rigs):
            drawn = draw_rig(seed, **kinds)  # type: ignore[arg-type]
            alone(drawn, frames, rows["alone"], seed, exact)
            if seed % 5 == 0:
                film(drawn, rows["film"], seed, exact)
        for kind, row in rows.items():
            table.add_row(name if kind == "alone" else "", kind, *row.cells())
    Console(width=140).print(table)
    if out is not None:
        plot(measured, out)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--rigs", type=int, default=50)
    parser.add_argument("--frames", type=int, default=4)
    parser.add_argument("--cases", nargs="*", default=list(CASES))
    parser.add_argument("--out", type=Path, help="a plot against how far off the LED positions are")
    options = parser.parse_args()
    main(options.rigs, options.frames, options.cases, options.out)
