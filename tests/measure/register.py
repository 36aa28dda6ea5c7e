"""A drawing registered to a drive, against the truth: `python -m tests.measure.register [CASES] [--spots N]`.

A free-form mould of 0.4 x 0.3 m with five hills and hollows of 7 to 18 mm lies anyhow under a camera at 1.3 m; five
robots drive on it for 60 s. "touches": 20 of each robot, then 100, then 720, drawn with covariances as poses have
them (0.02 mm across the line of sight, 0.15 mm along it), each robot's point off by 0.05 mm (one sigma). Printed:
RMSE of the drawing's middle and turn beside what is told, squared errors weighted by the covariance (6 on average
where it is meant, with their standard error), and how many are found.

"dent": the mould has a dent of 0.3 mm, 20 mm (one sigma) wide, that the drawing has not: its depth as the map has it,
and how many maps call a place different that is as drawn.

"spots": N drives at 20 Hz of spots with the noise of their light, solved as the chain does, LEDs off by 2 um, through
the whole calibration; "away": the surface that the rig has then, from the truth.
"""

import argparse
import sys
import time

import numpy as np

from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.protocol.surface import Surface
from asterism.server.calibration.surface.calibration import calibrate_surface
from asterism.server.calibration.surface.register import Placed, Registration, register
from asterism.server.calibration.surface.register_left import between
from asterism.server.calibration.surface.residual_map import as_it_is, residual_map
from tests.calibration.surface.driven import Driven, drive, located, touched, upright, ways
from tests.calibration.surface.mould import (
    DENT,
    LIES,
    LONG,
    WIDE,
    Shape,
    dented,
    drawing_of,
    drives,
    free_form,
    touches_on,
)

SIGMAS = (2e-5, 1.5e-4)  # m
OFFSET_M = 5e-5
COUNTS = (20, 100, 720)
FAR_M = 0.06  # from the dent: there the mould is as drawn
FLAT = Pose.from_matrix(exp_rotation(np.array([0.0, 0.0, 0.5])), np.array([-0.11, -0.22, 0.01]))  # of "spots"


def main() -> int:
    """Draw, register, compare."""
    parser = argparse.ArgumentParser(prog="python -m tests.measure.register")
    parser.add_argument("cases", nargs="?", type=int, default=40)
    parser.add_argument("--spots", type=int, default=3, help="drives (default: 3)")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    seeds = range(options.seed, options.seed + options.cases)
    for count in COUNTS:
        tell(
            f"{5 * count} touches",
            [registered(free_form, count, seed) for seed in seeds[: None if count < 700 else 12]],
        )
    found = [registered(dented, 720, seed) for seed in seeds[:12]]
    tell("3600 touches, dent", found)
    dent("3600 touches, dent", found, free=False)
    dent("3600 touches, as drawn", [registered(free_form, 720, seed) for seed in seeds[:12]], free=True)
    for seed in range(options.spots):
        spots(seed)
    return 0


def registered(shape: Shape, count: int, seed: int) -> Registration:
    """A drawing of the free form, from nothing, to touches on a mould."""
    rng = np.random.default_rng([seed, count])
    turn = Pose.from_matrix(exp_rotation(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)])), np.zeros(3))
    lies = turn @ LIES
    xy, robots = drives(rng, 5, count)
    touches = touches_on(shape, xy, robots, rng, lies, SIGMAS, offset_m=OFFSET_M)
    placed, every = Placed(drawing_of(free_form)), np.ones(len(touches), np.bool_)
    found = register([placed], touches, every, OFFSET_M, "the drawing")
    TRUTH[id(found)] = lies
    return found


TRUTH: dict[int, Pose] = {}  # of every registration, T_world_drawing


def tell(kind: str, found: list[Registration]) -> None:
    """A line of errors."""
    errors = np.array([between(one.drawing, one.T_world_drawing, TRUTH[id(one)]) for one in found])
    sigmas = np.array([np.sqrt(np.diag(one.about_centre)) for one in found])
    weighted = np.array([e @ np.linalg.solve(one.about_centre, e) for e, one in zip(errors, found, strict=True)])
    right = np.abs(errors) < [5e-3, 5e-3, 5e-3, 0.05, 0.05, 0.05]
    rmse, told = (np.sqrt((part**2).mean(axis=0)) for part in (errors, sigmas))
    scale = np.array([1e3, 1e3, 1e3, *[180.0 / np.pi] * 3])
    print(
        f"{kind}: {right.all(axis=1).sum()} of {len(found)} found; RMSE {_row(rmse * scale)} (mm, degrees), told "
        f"{_row(told * scale)}; weighted {weighted.mean():.2f} +- {weighted.std() / len(found) ** 0.5:.2f}; "
        f"fits elsewhere as well {sum(bool(one.others) for one in found)}",
        flush=True,
    )


def dent(kind: str, found: list[Registration], *, free: bool) -> None:
    """A line about maps."""
    depths, sigmas, wrong, within = [], [], 0, []
    for one in found:
        differs = residual_map(one)
        nodes = differs.origin + differs.step * np.stack(np.indices(differs.values.shape), axis=-1)
        away = np.hypot(*np.moveaxis(nodes - DENT, -1, 0))
        middle = np.unravel_index(away.argmin(), away.shape)
        depths.append(differs.values[middle])
        sigmas.append(differs.sigmas[middle])
        wrong += bool((differs.real & ((away > FAR_M) | free)).any())
        truth = (free_form if free else dented)(*np.moveaxis(nodes, -1, 0)) - free_form(*np.moveaxis(nodes, -1, 0))
        off = (differs.values - truth)[differs.visited]
        within.append((np.abs(off) < 2.0 * differs.sigmas[differs.visited]).mean())
    told = 1e3 * np.array(depths)
    right = np.mean(np.abs(told + (0.0 if free else 0.3)) < 0.05)
    print(
        f"{kind}: depth {told.mean():.3f} mm, scatter {told.std():.3f}, told +- {1e3 * np.mean(sigmas):.3f}; within "
        f"0.05 mm of the truth {right:.0%}; {wrong} of {len(found)} maps call a place different that is not; map "
        f"within 2 sigma {np.mean(within):.1%}",
        flush=True,
    )


def ground(xy: Floats) -> tuple[Floats, Floats]:
    """Heights and slopes in the world of the dented mould that lies `FLAT`."""

    def heights(places: Floats) -> Floats:
        own = (places - FLAT.position[:2]) @ FLAT.rotation[:2, :2]
        return np.asarray(FLAT.position[2] + dented(*own.T))

    h = 1e-5
    slopes = [(heights(xy + step) - heights(xy - step)) / (2.0 * h) for step in h * np.eye(2)]
    return heights(xy), np.column_stack(slopes)


def spots(seed: int) -> None:
    """A line of one drive through the whole calibration."""
    blank = drive(ground, seed)
    half = 0.5 * np.array([LONG, WIDE]) - 0.02
    moved = ways(len(blank.rig.robots), blank.times_s, seed, half)
    moved[..., :2] = (moved[..., :2] + [0.5 * LONG, 0.5 * WIDE]) @ FLAT.rotation[:2, :2].T + FLAT.position[:2]
    poses = {robot.id: upright(ground, moved[k]) for k, robot in enumerate(blank.rig.robots)}
    driven = Driven(blank.rig, ground, blank.times_s, poses)
    contacts = touched(driven, located(driven, seed, 2e-6))
    fit = calibrate_surface(contacts, [np.array([0.0, 0.0, 1.0])] * len(blank.rig.robots), "the drive")
    began = time.perf_counter()
    found = register([Placed(drawing_of(free_form))], fit.contacts, fit.used, OFFSET_M, "the drawing")
    differs = residual_map(found)
    seconds = time.perf_counter() - began
    TRUTH[id(found)] = FLAT
    tell(f"spots, {len(contacts)} touches, {seconds:.0f} s", [found])
    dent("spots", [found], free=False)
    surface = Surface(as_it_is(found, differs), found.T_world_drawing)
    xy = np.random.default_rng(0).uniform([0.02, 0.02], [LONG - 0.02, WIDE - 0.02], (4000, 2))
    touch = surface.touch(FLAT.map(np.column_stack([xy, dented(*xy.T)])))
    print(
        f"spots: away {1e3 * np.sqrt((touch.distances**2).mean()):.3f} mm RMS, within 2 sigma "
        f"{(np.abs(touch.distances) < 2.0 * touch.sigmas).mean():.1%}",
        flush=True,
    )


def _row(values: Floats) -> str:
    return " ".join(f"{value:.3f}" for value in values)


if __name__ == "__main__":
    sys.exit(main())
