"""Gaps and overworked patches: connected parts of the surface that a map says too little or too much of."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from asterism.protocol.geometry import Floats
from asterism.server.coverage.visits import CoverageMap, Visits

OVERWORKED = 3.0  # times the median dwell of all visited patches
LEAST_OVERWORKED = 0.5  # of the tool's area: a tool that stands still overworks little more than its own

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """A connected part of the surface. ``number`` in the list, from 1; ``area_m2`` of the surface itself; ``xy`` (2,) m
    of the frame and ``place`` (3,) m of the world: where it is widest, within it; ``length_m`` and ``width_m`` along
    and across its longer way; the ``mean_s`` and ``most_s`` dwell of its patches; ``robots`` that were there with their
    shares of the time, the largest first; ``last_ns``: when a tool was there last, 0: never.
    """

    number: int
    area_m2: float
    xy: Floats
    place: Floats
    length_m: float
    width_m: float
    mean_s: float
    most_s: float
    robots: tuple[tuple[str, float], ...]
    last_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class Regions:
    """All regions of one kind, the largest ``found`` first. ``limit_s`` of dwell is what makes one; ``numbers`` (rows,
    columns) says which patches are of which, 0: of none. Regions below ``least_m2`` are left out: so many ``specks``,
    of ``specks_m2`` in all.
    """

    limit_s: float
    least_m2: float
    found: tuple[Region, ...]
    numbers: Ints
    specks: int
    specks_m2: float


def gaps_of(covered: CoverageMap, least_s: float = 0.0) -> Regions:
    """Parts that no tool has been over; with ``least_s``, for less than so long in all.

    Of a surface without an end of its own a gap is only what is closed in by patches that are none.
    """
    whole, grid = covered.together, covered.grid
    missing = grid.inside & (~whole.visited | (whole.dwell_s < least_s))
    if not grid.ends:
        missing &= ~_reaching_the_rim(missing)
    return _regions(covered, whole, missing, least_s, np.pi * whole.radius_m**2)


def overworked_of(covered: CoverageMap) -> Regions:
    """Parts over which tools were more than `OVERWORKED` times as long as the median of all that was visited."""
    whole = covered.together
    limit = OVERWORKED * median_dwell(whole)
    least = LEAST_OVERWORKED * np.pi * whole.radius_m**2
    return _regions(covered, whole, whole.visited & (whole.dwell_s > limit), limit, least)


def median_dwell(visits: Visits) -> float:
    """Of all visited patches, s; 0 where there are none."""
    return float(np.median(visits.dwell_s[visits.visited])) if visits.visited.any() else 0.0


def _reaching_the_rim(marked: Bools) -> Bools:
    """What of the marked patches is connected to the outer ones of the grid."""
    numbers, _ = ndimage.label(marked)
    rim = np.concatenate([numbers[:1].ravel(), numbers[-1:].ravel(), numbers[:, :1].ravel(), numbers[:, -1:].ravel()])
    reaching: Bools = np.isin(numbers, rim[rim > 0])
    return reaching


def _regions(covered: CoverageMap, whole: Visits, marked: Bools, limit_s: float, least_m2: float) -> Regions:
    areas = covered.grid.areas
    labels, count = ndimage.label(marked)
    sizes = np.bincount(labels.ravel(), areas.ravel(), count + 1)[1:]
    order = np.argsort(-sizes, kind="stable")
    kept = order[sizes[order] >= least_m2]
    new = np.zeros(count + 1, np.int64)
    new[kept + 1] = np.arange(1, len(kept) + 1)
    numbers = new[labels]
    boxes = ndimage.find_objects(numbers, len(kept)) if len(kept) else []
    found = tuple(_region(covered, whole, numbers, number, box) for number, box in enumerate(boxes, 1))
    specks = np.delete(sizes, kept)
    return Regions(limit_s, least_m2, found, numbers, len(specks), float(specks.sum()))


def _region(covered: CoverageMap, whole: Visits, numbers: Ints, number: int, box: tuple[slice, ...]) -> Region:
    grid, own = covered.grid, numbers[box] == number
    areas = np.where(own, grid.areas[box], 0.0)
    area = float(areas.sum())
    xy = np.stack([*np.meshgrid(grid.x_m[box[1]], grid.y_m[box[0]])], axis=-1)
    depth = ndimage.distance_transform_edt(np.pad(own, 1))[1:-1, 1:-1]
    widest = xy[np.unravel_index(int(np.argmax(depth)), depth.shape)]
    points = np.column_stack([xy[own], grid.surface.ground(xy[own]).heights])
    length, width = _extent(points, np.sqrt(area / own.sum()))
    height = grid.surface.ground(widest).heights
    dwell = whole.dwell_s[box]
    return Region(
        number,
        area,
        widest,
        grid.surface.T_world_surface.map(np.concatenate([widest, height])),
        length,
        width,
        float((dwell * areas).sum() / area),
        float(dwell[own].max()),
        _shares({robot: float((each.dwell_s[box] * areas).sum()) for robot, each in covered.robots.items()}),
        int(whole.last_ns[box][own].max()),
    )


def _extent(points: Floats, side: float) -> tuple[float, float]:
    """Length and width, m, of points (n, 3) that are the middles of patches so wide: along their principal axes."""
    axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][:2]
    spans = np.ptp(points @ axes.T, axis=0) + side
    length, width = sorted([*spans.tolist(), side][:2], reverse=True)
    return length, width


def _shares(seconds: dict[str, float]) -> tuple[tuple[str, float], ...]:
    total = sum(seconds.values())
    there = [(robot, each / total) for robot, each in seconds.items() if each > 0.0]
    return tuple(sorted(there, key=lambda each: -each[1]))
