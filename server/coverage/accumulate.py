"""Poses added to a map, batch after batch: pure, the same poses give the same map however they are cut."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.surface import Surface
from asterism.server.coverage.grid import Box, Grid, patches_between, rounded
from asterism.server.coverage.sightings import COUNTS, Sighted, Told, Tool, sighted
from asterism.server.coverage.sweep import SPEED_OVER_S, Lattice, Sums, Way, sweep
from asterism.server.coverage.visits import GAP, NOT_TRACKED, OFF_MAP, REASONS, UNSURE, CoverageMap, Visits

GAP_FRAMES = 6.5  # between poses that are farther apart nobody knows where the tool was
_FIRST_STEP = 10  # of a way; none of a patch's is so small
_BRIDGED = (NOT_TRACKED, UNSURE)  # the tool goes on meanwhile; for all else it is somewhere else


@dataclass(frozen=True, slots=True, eq=False)
class Going:
    """A robot under way: the last places of its ``way``, the number of the ``step`` to the last, and after which step
    the tool had not yet left each patch, ``near`` (rows, columns). ``broken``: the way ended there.
    """

    way: Way
    near: NDArray[np.int64]
    step: int = _FIRST_STEP
    broken: bool = False

    @staticmethod
    def none(shape: tuple[int, int]) -> "Going":
        """Nowhere yet."""
        floats = np.zeros((0, 3))
        way = Way(np.zeros(0, np.int64), floats, floats[:, :2], floats[:, 0], np.zeros(0, np.bool_))
        return Going(way, np.zeros(shape, np.int64))

    def on(self, old: Box, new: Box) -> "Going":
        """The same on a larger grid."""
        near = np.zeros(new.shape, np.int64)
        near[old.within(new)] = self.near
        return replace(self, near=near)


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """A map that grows: of the robots whose ``tools`` are given by id, to at most about ``most`` patches; and where
    they are under way.
    """

    map: CoverageMap
    tools: Mapping[str, Tool]
    most: int
    going: Mapping[str, Going] = field(default_factory=dict)

    @staticmethod
    def none(surface: Surface, tools: Mapping[str, Tool], pitch_m: float, most: int) -> "Coverage":
        """Nothing yet."""
        grid = Grid.over(surface, pitch_m)
        radii = {robot: tool.radius_m for robot, tool in tools.items()}
        return Coverage(CoverageMap.none(grid, radii), tools, most)

    def add(self, told: Mapping[str, Told], period_s: float) -> "Coverage":
        """With what frames told of robots, in the order of time; ``period_s`` from frame to frame."""
        surface = self.map.grid.surface
        seen = {robot: sighted(told[robot], surface, self.tools[robot]) for robot in told}
        return self.add_sighted(seen, period_s)

    def add_sighted(self, seen: Mapping[str, Sighted], period_s: float) -> "Coverage":
        """The same, of what poses were found to say."""
        grown = self._reaching(seen)
        visits, going = dict(grown.map.robots), dict(grown.going)
        for robot, each in seen.items():
            state = going.get(robot) or Going.none(grown.map.grid.box.shape)
            visits[robot], going[robot] = _added(visits[robot], state, each, grown.map.grid, GAP_FRAMES * period_s)
        times = np.concatenate([np.zeros(0, np.int64), *(each.times_ns for each in seen.values())])
        since, until = grown.map.since_ns, grown.map.until_ns
        if len(times):
            since, until = since or int(times.min()), max(until, int(times.max()))
        return replace(grown, map=replace(grown.map, robots=visits, since_ns=since, until_ns=until), going=going)

    def cut(self) -> "Coverage":
        """The same, nobody under way: what comes next does not go on from here."""
        return replace(self, going={robot: replace(each, broken=True) for robot, each in self.going.items()})

    def _reaching(self, seen: Mapping[str, Sighted]) -> "Coverage":
        """On a grid that holds where tools were, if that is not too large."""
        grid, needed = self.map.grid, self.map.grid.box
        for robot, each in seen.items():
            feet, margin = each.feet[each.why == COUNTS, :2], self.tools[robot].radius_m
            if len(feet) and not grid.ends:
                between = np.array([feet.min(axis=0) - margin, feet.max(axis=0) + margin])
                box = needed.with_(rounded(patches_between(between, grid.pitch_m)))
                needed = box if box.patches <= self.most else needed
        grown = self.map.reaching(needed)
        if grown is self.map:
            return self
        going = {robot: each.on(grid.box, needed) for robot, each in self.going.items()}
        return replace(self, map=grown, going=going)


def _added(visits: Visits, going: Going, seen: Sighted, grid: Grid, gap_s: float) -> tuple[Visits, Going]:
    """A robot's visits, and where it is under way, with what was seen of it."""
    why = np.where((seen.why == COUNTS) & ~_on_map(seen, grid), REASONS.index(OFF_MAP), seen.why)
    counts = why == COUNTS
    left_out = Counter(visits.left_out)
    left_out.update({REASONS[k]: int(n) for k, n in zip(*np.unique(why[~counts], return_counts=True), strict=True)})
    way, first, gaps = _way(going, seen, why, gap_s)
    if gaps:
        left_out[GAP] += gaps
    sums = Sums(
        visits.dwell_s.copy(),
        visits.passes.copy(),
        visits.path_m.copy(),
        visits.shift_m.copy(),
        visits.last_ns.copy(),
        going.near.copy(),
    )
    lattice = Lattice(grid.inside, grid.pitch_m, grid.box.column, grid.box.row)
    step = sweep(way, max(first, 1), going.step, visits.radius_m, lattice, sums)
    went_s = float(np.diff(way.times_ns)[max(first, 1) - 1 :][way.joined[max(first, 1) :]].sum() * 1e-9)
    added = replace(
        visits,
        dwell_s=sums.dwell,
        passes=sums.passes,
        path_m=sums.path,
        shift_m=sums.shift,
        last_ns=sums.last_ns,
        counted=visits.counted + int(counts.sum()),
        counted_s=visits.counted_s + went_s,
        left_out=left_out,
    )
    return added, Going(_last(way), sums.near, step, _breaks(why, going.broken))


def _on_map(seen: Sighted, grid: Grid) -> NDArray[np.bool_]:
    """Which places are on the grid; all where the surface ends, whose grid holds it."""
    patch = np.floor(np.nan_to_num(seen.feet[:, :2]) / grid.pitch_m)
    least, most = grid.box[:2], grid.box[2:]
    on: NDArray[np.bool_] = np.logical_or(((patch >= least) & (patch < most)).all(axis=1), grid.ends)
    return on


def _way(going: Going, seen: Sighted, why: NDArray[np.int64], gap_s: float) -> tuple[Way, int, int]:
    """The way that was seen behind its last places before, the place of the first new one, and how many gaps it has."""
    counts, last = why == COUNTS, going.way
    # Between two places that count: is there one where the tool was somewhere else?
    breaks = np.cumsum(~counts & ~np.isin(why, [REASONS.index(reason) for reason in _BRIDGED]))
    broken = np.diff(breaks[counts], prepend=-1 if going.broken else 0) > 0
    times = np.concatenate([last.times_ns, seen.times_ns[counts]])
    steps = np.diff(times, prepend=times[:1])[len(last.times_ns) :]
    apart = (steps <= 0) | (steps > gap_s * 1e9)
    if not len(last.times_ns):
        broken[:1] = True
    joined = ~(broken | apart)
    way = Way(
        times,
        np.concatenate([last.feet, seen.feet[counts]]),
        np.concatenate([last.slopes, seen.slopes[counts]]),
        np.concatenate([last.leaves, seen.leaves[counts]]),
        np.concatenate([last.joined, joined]),
    )
    return way, len(last.times_ns), int((apart & ~broken).sum())


def _last(way: Way) -> Way:
    """The last place, and those before it that the speed at the next one asks for."""
    begin = len(way.times_ns) - 1
    while begin > 0 and way.joined[begin] and way.times_ns[-1] - way.times_ns[begin - 1] <= SPEED_OVER_S * 1e9:
        begin -= 1
    since = slice(max(begin, 0), None)
    return Way(way.times_ns[since], way.feet[since], way.slopes[since], way.leaves[since], way.joined[since])


def _breaks(why: NDArray[np.int64], before: bool) -> bool:
    """Whether the tool was somewhere else since the last place that counts."""
    counts = np.flatnonzero(why == COUNTS)
    rest = why[counts[-1] + 1 :] if len(counts) else why
    somewhere = ~np.isin(rest, [COUNTS, *(REASONS.index(reason) for reason in _BRIDGED)])
    return bool(somewhere.any() or (before and not len(counts)))
