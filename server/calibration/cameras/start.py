"""Where cameras stand to begin with: each pair from the robots that both see, all from the pairs that agree best.

A pair's place is what lays robots' ways onto each other (`fusing.clocks`), or what a single robot's poses in both
cameras say, with either tilt in each: of all these the one with which most poses agree, which a robot's wrong tilt or
name does not decide.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose
from asterism.server.calibration.cameras.views import TILTS, Ints, Seen
from asterism.server.fusing.clocks import ClockFit, clock_between

WITHIN_S = 5.0  # clocks may be so far apart
TRIED = 30  # poses of a pair of cameras that propose a place
COMPARED = 200  # that are asked what they think of it
ARM_M = 0.05  # an angle counts by what it moves there
AGREES_M = 0.02
FEWEST_AGREE = 5


@dataclass(frozen=True, slots=True, eq=False)
class Link:
    """A pair of cameras, by their numbers: T_first_second, their clocks, and how many poses agree."""

    first: int
    second: int
    T_first_second: Pose
    clock: ClockFit | None
    agree: int


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """T_0_c of every camera c in the first's frame, and by how much its clock is ahead of the first's, s."""

    poses: tuple[Pose, ...]
    offsets_s: Floats
    links: tuple[Link, ...]


def start_of(seen: Sequence[Seen], leds: Floats) -> Start:
    """All cameras from their links, strongest first (a spanning tree); ``leds`` (robots, 6, 3).

    Raises InputError naming the cameras that no robot links to the first.
    """
    pairs = [(a, b) for a in range(len(seen)) for b in range(a + 1, len(seen))]
    links = [link for link in (_link(seen, a, b, leds) for a, b in pairs) if link is not None]
    links.sort(key=lambda link: -link.agree)
    poses: dict[int, Pose] = {0: Pose.identity()}
    offsets = {0: 0.0}
    while True:
        # The strongest link that leads on from those that are placed.
        link = next((link for link in links if (link.first in poses) != (link.second in poses)), None)
        if link is None:
            break
        ahead = link.clock.offset_s if link.clock else 0.0
        if link.first in poses:
            poses[link.second] = poses[link.first] @ link.T_first_second
            offsets[link.second] = offsets[link.first] + ahead
        else:
            poses[link.first] = poses[link.second] @ link.T_first_second.inverse()
            offsets[link.first] = offsets[link.second] - ahead
    _refuse_unlinked(seen, poses)
    order = range(len(seen))
    return Start(tuple(poses[c] for c in order), np.array([offsets[c] for c in order]), tuple(links))


def _refuse_unlinked(seen: Sequence[Seen], poses: dict[int, Pose]) -> None:
    placed = [each.camera for c, each in enumerate(seen) if c in poses]
    for c, each in enumerate(seen):
        if c in poses:
            continue
        if len(each.views) == 0:
            raise InputError(f"{each.source}: camera {each.camera} located no robot that another camera's rig has")
        others = placed[0] if len(placed) == 1 else f"{', '.join(placed[:-1])} or {placed[-1]}"
        raise InputError(
            f"camera {each.camera} shares no robot at the same time with {others}: drive one through both views"
        )


def _link(seen: Sequence[Seen], a: int, b: int, leds: Floats) -> Link | None:
    first, second = seen[a].views, seen[b].views
    common = sorted(set(first.robots.tolist()) & set(second.robots.tolist()))
    ways = [(first.way_of(robot, leds), second.way_of(robot, leds)) for robot in common]
    clock = clock_between(ways, WITHIN_S)
    ones, others = _together(seen, a, b, clock)
    if len(ones) < FEWEST_AGREE:
        return None
    candidates = list(_proposed(seen, a, b, ones, others))
    if clock is not None:
        candidates.append(clock.T_first_second)
    spread = np.unique(np.linspace(0, len(ones) - 1, COMPARED).round().astype(np.int64))
    scores = [_away(seen, a, b, (ones[spread], others[spread]), leds, T) for T in candidates]
    likeliest = int(np.argmin([np.minimum(away, AGREES_M).sum() for away in scores]))
    share = float((scores[likeliest] < AGREES_M).mean())
    if share * len(ones) < FEWEST_AGREE:
        return None
    return Link(a, b, candidates[likeliest], clock, round(share * len(ones)))


def _together(seen: Sequence[Seen], a: int, b: int, clock: ClockFit | None) -> tuple[Ints, Ints]:
    """Views of the same robot at nearly the same time: rows of both."""
    first, second = seen[a].views, seen[b].views
    ahead = clock.offset_s if clock else 0.0
    ones, others = [], []
    for robot in sorted(set(first.robots.tolist()) & set(second.robots.tolist())):
        rows, there = np.flatnonzero(first.robots == robot), np.flatnonzero(second.robots == robot)
        times = second.times_s[there] - ahead
        after = np.clip(np.searchsorted(times, first.times_s[rows]), 1, max(len(times) - 1, 1))
        near = np.clip(after - 1, 0, len(times) - 1)
        after = np.clip(after, 0, len(times) - 1)
        closer = np.abs(times[after] - first.times_s[rows]) < np.abs(times[near] - first.times_s[rows])
        near = np.where(closer, after, near)
        period = max(second.way_of(robot, np.zeros((robot + 1, 6, 3))).period_s if len(there) > 1 else 0.0, 2e-3)
        good = np.abs(times[near] - first.times_s[rows]) <= 0.6 * period
        ones.append(rows[good])
        others.append(there[near[good]])
    empty = np.empty(0, np.int64)
    return (np.concatenate(ones), np.concatenate(others)) if ones else (empty, empty)


def _proposed(seen: Sequence[Seen], a: int, b: int, ones: Ints, others: Ints) -> Iterator[Pose]:
    """T_first_second as single robots' poses have it."""
    for k in np.unique(np.linspace(0, len(ones) - 1, TRIED).round().astype(np.int64)):
        for one in _tilts(seen[a], ones[k]):
            for other in _tilts(seen[b], others[k]):
                yield one @ other.inverse()


def _tilts(seen: Seen, row: int) -> list[Pose]:
    rotations, ts = seen.views.rotations[row], seen.views.ts[row]
    return [Pose.from_matrix(rotations[k], ts[k]) for k in range(TILTS) if np.isfinite(ts[k, 0])]


def _away(seen: Sequence[Seen], a: int, b: int, rows: tuple[Ints, Ints], leds: Floats, T: Pose) -> Floats:
    """How far apart the poses of both cameras are, m: of the LEDs' mean, and by the angle; the best of the tilts."""
    first, second = seen[a].views[rows[0]], seen[b].views[rows[1]]
    middle = leds.mean(axis=1)[first.robots]
    best = np.full(len(first), np.inf)
    for i in range(TILTS):
        for j in range(TILTS):
            turn = T.rotation @ second.rotations[:, j]
            place = T.map(np.einsum("mij,mj->mi", second.rotations[:, j], middle) + second.ts[:, j])
            here = np.einsum("mij,mj->mi", first.rotations[:, i], middle) + first.ts[:, i]
            chord = np.linalg.norm((turn - first.rotations[:, i]).reshape(-1, 9), axis=1) / np.sqrt(2.0)
            away = np.linalg.norm(place - here, axis=1) + ARM_M * chord
            best = np.fmin(best, away)
    return best
