"""How often is a pose wrong in silence? `python -m tests.measure.silent [THOUSANDS OF POSES PER ROW]`.

No images: plates of many kinds at tilts of 0 to 75 degrees (dense near 0), 0.3 to 2.5 m away, anywhere in the view, of
spots that are as uncertain as is told, 0.003 to 0.2 px; LEDs in view at least a fifth as wide as long. Each pose alone,
started as the search starts it. In some rows the LEDs lie 0.05 mm off what the rig says, or one spot lies 0.03 to 0.3
px off beside what it is told to.

Printed: poses; how many per cent have an alternative, and how many would by the true likelihood of both minima at the
same odds; silent ones, without an alternative and with a squared error of more than FAR times the covariance, and of
these wrong tilts; the mean squared error weighted by the covariance (6 where it is meant) of those without alternative,
each counted with FAR at most; then, of poses told odds from ODDS on, whose minima are clearly apart, how many are wrong
over how many should be.
"""

import sys
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

from asterism.protocol.geometry import Floats
from asterism.server.chain.answers import SURE
from asterism.server.compiled import compiled
from asterism.server.pose.choose import Choices, Mounts, choose
from asterism.server.pose.fit import CHI2, LEDS, SYSTEMATIC_PX, fit_labelled, fit_room
from asterism.server.pose.lens import lens_of
from asterism.server.pose.matched import Constellations, Matched, Measured
from asterism.server.pose.planar import NO_SOLUTION
from asterism.server.pose.rotations import log_between
from asterism.server.pose.solve import Solutions, solve_robots
from asterism.server.pose.spot_shift import OPTICS
from asterism.server.pose.track import Tracks
from tests.rigs import make_camera, random_layout

FAR = 60.0
FOCAL = 1400.0
LAYOUTS = 400
BLOCK = 20_000
ODDS = (10.0, 30.0, 100.0, 1e3, 1e4)
APART = 60.0  # squared difference of two minima, weighted by the covariance, to be told apart at all


class Kind(NamedTuple):
    """LEDs that are seen, how far the others lie off the rig (m), and whether one spot is disturbed."""

    lit: int
    led_error_m: float = 0.0
    disturbed: bool = False


KINDS = (
    Kind(6), Kind(5), Kind(4),
    Kind(6, 5e-5), Kind(5, 5e-5), Kind(4, 5e-5),
    Kind(6, 0.0, True), Kind(5, 0.0, True), Kind(4, 0.0, True),
)  # fmt: skip


class Drawn(NamedTuple):
    """Poses ``rotations`` (n, 3, 3), ``ts`` (n, 3) of plates ``layouts`` (n, 6, 3), and what is seen of them."""

    layouts: Floats
    rotations: Floats
    ts: Floats
    matched: Matched
    measured: Measured
    lit: Any  # (n, 6) rows of the spots
    sigmas: Floats  # (n,) px
    tilts: Floats  # (n,) rad


def plates(rng: np.random.Generator, count: int) -> Floats:
    """Plates (count, 6, 3) about their middle: a third round, a third long, a third small or large."""
    flat = np.zeros((count, LEDS, 3))
    for k in range(count):
        layout = random_layout(rng)
        if k % 3 == 1:
            layout = layout * [1.0, rng.uniform(0.3, 0.8)]
        elif k % 3 == 2:
            layout = layout * rng.uniform(0.5, 1.8)
        flat[k, :, :2] = layout - layout.mean(axis=0)
    return flat


def facing(rng: np.random.Generator, count: int, deepest: float = 2.5) -> tuple[Floats, Floats, Floats]:
    """Rotations, translations and tilts of ``count`` plates that turn their +z to the camera."""
    depth = rng.uniform(0.3, deepest, count)
    ts = depth[:, None] * np.column_stack(
        [rng.uniform(-0.4, 0.4, count), rng.uniform(-0.3, 0.3, count), np.ones(count)]
    )
    near_front = rng.random(count) < 0.6
    tilts = np.radians(np.where(near_front, np.minimum(rng.exponential(6.0, count), 75.0), rng.uniform(0, 75, count)))
    sight = ts / np.linalg.norm(ts, axis=1)[:, None]
    across = np.cross(sight, rng.normal(size=(count, 3)))
    across /= np.linalg.norm(across, axis=1)[:, None]
    normal = -np.cos(tilts)[:, None] * sight + np.sin(tilts)[:, None] * across
    x = np.cross(normal, rng.normal(size=(count, 3)))
    x /= np.linalg.norm(x, axis=1)[:, None]
    return np.stack([x, np.cross(normal, x), normal], axis=2), ts, tilts


def draw(rng: np.random.Generator, kind: Kind, count: int, deepest: float = 2.5) -> Drawn:
    """``count`` poses of a kind and their spots."""
    layouts = plates(rng, LAYOUTS)[np.arange(count) % LAYOUTS]
    rotations, ts, tilts = facing(rng, count, deepest)
    sigmas = np.exp(rng.uniform(np.log(0.003), np.log(0.2), count))
    off = kind.led_error_m * rng.standard_normal((count, LEDS, 3)) * [1, 1, 0]
    mapped = np.einsum("nij,nkj->nki", rotations, layouts + off) + ts[:, None]
    # Of every spot its own two axes, turned somehow, since no two spots are equally bright and round.
    axes = (sigmas[:, None, None] * np.exp(rng.uniform(-0.3, 0.3, (count, LEDS, 2)))) / FOCAL
    angle = rng.uniform(0, np.pi, (count, LEDS))
    c, s = np.cos(angle), np.sin(angle)
    along = axes * rng.standard_normal((count, LEDS, 2))
    noise = np.stack([c * along[..., 0] - s * along[..., 1], s * along[..., 0] + c * along[..., 1]], axis=2)
    a, b = axes[..., 0] ** 2, axes[..., 1] ** 2
    covariances = np.stack([c * c * a + s * s * b, c * s * (a - b), s * s * a + c * c * b], axis=2)
    rays = mapped[..., :2] / mapped[..., 2:] + noise
    if kind.disturbed:
        far, way = np.exp(rng.uniform(np.log(0.03), np.log(0.3), count)) / FOCAL, rng.uniform(0, 2 * np.pi, count)
        rays[:, LEDS - 1] += far[:, None] * np.column_stack([np.cos(way), np.sin(way)])
    assignment = np.arange(LEDS * count).reshape(count, LEDS)
    assignment[:, : LEDS - kind.lit] = -1
    flat, spreads = np.ascontiguousarray(rays.reshape(-1, 2)), np.ascontiguousarray(covariances.reshape(-1, 3))
    starts, start_ts = np.empty((count, 3, 3)), np.empty((count, 3))
    start(layouts, assignment, flat, spreads, starts, start_ts)
    pixels = make_camera().project(np.column_stack([flat, np.ones(len(flat))]))
    # What the search refuses is not solved, nor LEDs less than a fifth as wide as long, nearly on a line.
    lit = layouts[:, LEDS - kind.lit :]
    spans = np.linalg.svd(lit - lit.mean(axis=1)[:, None], compute_uv=False)
    keep = (start_ts[:, 2] > 0) & (spans[:, 1] > 0.2 * spans[:, 0])
    matched = Matched(np.arange(keep.sum()), assignment[keep], starts[keep], start_ts[keep])
    seen = Measured(flat, spreads, pixels)
    return Drawn(
        layouts[keep], rotations[keep], ts[keep], matched, seen, assignment[keep].copy(), sigmas[keep], tilts[keep]
    )


@compiled
def start(layouts, assignment, rays, covariances, rotations, ts):
    """Fill ``rotations`` (n, 3, 3) and ``ts`` (n, 3) with poses as the search finds them, behind the camera if not."""
    room = fit_room()
    variances = 0.5 * (covariances[:, 0] + covariances[:, 2])
    for k in range(layouts.shape[0]):
        count, cost, which = fit_labelled(
            layouts[k], assignment[k], rays, variances, (SYSTEMATIC_PX / FOCAL) ** 2, 5, room
        )
        rotations[k], ts[k] = np.diag(np.array([1.0, -1.0, -1.0])), np.array([0.0, 0.0, -1.0])
        if which >= 0 and cost <= CHI2[count]:
            rotations[k], ts[k] = room.rotations[which], room.ts[which]


class Judged(NamedTuple):
    """Per pose: NEES of the chosen one; its rotation's error and the other one's, rad; the odds it was told."""

    nees: Floats
    turned: Floats
    other_turned: Floats
    odds: Floats
    found: Any  # (n,) bool
    solutions: Solutions
    choices: Choices


def judge(drawn: Drawn) -> Judged:
    """Solve and judge every pose."""
    count = len(drawn.ts)
    lens = lens_of(make_camera())
    solutions, choices = Solutions.room(count), Choices.room(count)
    constellations = Constellations(drawn.layouts, np.zeros((count, OPTICS)))
    solve_robots(lens, constellations, drawn.matched, drawn.measured, solutions)
    unit, none = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
    mounts = Mounts(np.eye(3), np.zeros(3), unit, none, none, none, np.full(count, -1.0))
    heights = np.full(len(drawn.measured.rays), 100.0)
    choose(drawn.matched, 1, solutions, heights, mounts, Tracks.none(count), choices)
    best = choices.best
    rows = np.arange(count)
    error = np.empty((count, 2, 6))
    errors(drawn.rotations, drawn.ts, solutions.rotations, solutions.ts, error)
    turned = np.linalg.norm(error[:, :, 3:], axis=2)
    chosen = error[rows, best]
    nees = weighted(chosen, np.where(best[:, None, None] < 0, np.eye(6), choices.covariances))
    other = solutions.costs[rows, best - 1] < NO_SOLUTION  # -1: the other row
    other_turned = np.where(other, turned[rows, best - 1], np.inf)
    return Judged(nees, turned[rows, best], other_turned, choices.odds, best >= 0, solutions, choices)


def weighted(moves: Floats, covariances: Floats) -> Floats:
    """Squares (n,) of moves (n, 6) weighted by covariances (n, 6, 6), of whatever units."""
    sigma = np.sqrt(np.einsum("nii->ni", covariances))
    scaled, unit = covariances / (sigma[:, :, None] * sigma[:, None]), moves / sigma
    squares: Floats = np.einsum("ni,ni->n", unit, np.linalg.solve(scaled, unit[..., None])[..., 0])
    return squares


@compiled
def errors(rotations, ts, found, found_ts, error):
    """Fill ``error`` (n, 2, 6): translations (m) and turns (rad) of both minima less the truth."""
    for k in range(ts.shape[0]):
        for which in range(2):
            for i in range(3):
                error[k, which, i] = found_ts[k, which, i] - ts[k, i]
            log_between(rotations[k], found[k, which], error[k, which, 3:])


def apart(judged: Judged) -> Floats:
    """Squared difference (n,) of both minima, weighted by the covariance of the one that is not chosen, the smaller."""
    solutions, best, rows = judged.solutions, judged.choices.best, np.arange(len(judged.nees))
    move = np.empty((len(rows), 2, 6))
    errors(solutions.rotations[rows, best], solutions.ts[rows, best], solutions.rotations, solutions.ts, move)
    covariances = np.where(judged.found[:, None, None], judged.choices.covariances, np.eye(6))
    there = np.isfinite(judged.other_turned)
    told: Floats = np.where(there, weighted(move[rows, best - 1], covariances), 0.0)
    return told


def demanded(drawn: Drawn, judged: Judged, kind: Kind) -> Floats:
    """Log odds (n,) of the chosen minimum by the noise as it is, infinite where there is no other."""
    solutions, best, rows = judged.solutions, judged.choices.best, np.arange(len(judged.nees))
    points = drawn.layouts[:, LEDS - kind.lit :]
    lit = drawn.lit[:, LEDS - kind.lit :]
    spots = drawn.measured.covariances[lit]
    inverse = np.linalg.inv(spots[..., [[0, 1], [1, 2]]])
    cost = np.empty((len(rows), 2))
    for which, row in enumerate((best, best - 1)):
        mapped = np.einsum("nij,nkj->nki", solutions.rotations[rows, row], points) + solutions.ts[rows, row][:, None]
        off = drawn.measured.rays[lit] - mapped[..., :2] / mapped[..., 2:]
        cost[:, which] = np.einsum("nki,nkij,nkj->n", off, inverse, off)
    told: Floats = np.where(np.isfinite(judged.other_turned), 0.5 * (cost[:, 1] - cost[:, 0]), np.inf)
    return told


def cells(drawn: Drawn, judged: Judged, kind: Kind) -> list[str]:
    """The figures of a row."""
    flagged = judged.odds < SURE
    silent = ~flagged & (judged.nees > FAR)
    wrong, clear = judged.other_turned < judged.turned, apart(judged) > APART
    calibrated = []
    for least, most in pairwise(ODDS):
        told = clear & (judged.odds >= least) & (judged.odds < most)
        calibrated.append(f"{wrong[told].sum()}/{(1.0 / (1.0 + judged.odds[told])).sum():.1f}")
    should = demanded(drawn, judged, kind) < np.log(SURE)
    return [
        str(kind.lit),
        f"{1e3 * kind.led_error_m:g}",
        "one" if kind.disturbed else "",
        str(len(flagged)),
        f"{100 * flagged.mean():.1f}",
        f"{100 * should.mean():.1f}",
        str(silent.sum()),
        str((silent & wrong).sum()),
        f"{np.minimum(judged.nees, FAR)[~flagged].mean():.2f}",
        *calibrated,
    ]


def main(thousands: int) -> None:
    """Measure and print."""
    table = Table(title="wrong in silence, each pose alone", box=box.SIMPLE_HEAD, pad_edge=False)
    headings = ("LEDs", "off mm", "disturbed", "poses", "flagged %", "demanded", "silent", "tilt", "NEES")
    for heading in (*headings, *(f"odds {least:g}" for least in ODDS[:-1])):
        table.add_column(heading, justify="right")
    for kind in track(KINDS, description="solving", transient=True):
        rng = np.random.default_rng([kind.lit, round(1e6 * kind.led_error_m), kind.disturbed, 7])
        drawn = draw(rng, kind, 1000 * thousands)
        table.add_row(*cells(drawn, judge(drawn), kind))
    Console(width=130).print(table)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100)
