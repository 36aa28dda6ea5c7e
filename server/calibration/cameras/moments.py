"""Moments: windows of a few frames in which cameras see a robot, so many as tell enough, spread over all."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.constellation import LEDS
from asterism.protocol.geometry import Floats
from asterism.server.calibration.cameras.motion import DEGREE, Motion
from asterism.server.calibration.cameras.start import Start
from asterism.server.calibration.cameras.views import TILTS, Ints, Seen
from asterism.server.pose.matched import LEAST_SIGMA_PX

LENGTH = 2.5  # frame periods: three frames of each camera
SAME_TIME = 0.02  # of a period: exposures nearer than this are at one time
MOST = 600  # moments
MOST_NUMBERS = 2e7  # of the equations of all of them, so that many cameras fit into memory
APART = 0.5  # rad, of rotations that are not alike

Bools = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Moments:
    """g moments of at most n spots (6 for each time that a camera saw the robot; what is not there has no information).

    ``robots`` (g,); of each spot ``cameras`` (g, n), ``times_s`` (g, n) by that camera's clock, ``pixels`` (g, n, 2)
    and ``information`` (g, n, 2, 2), 1/px^2. Spot k is LED k % 6.
    """

    robots: Ints
    cameras: Ints
    times_s: Floats
    pixels: Floats
    information: Floats

    def __len__(self) -> int:
        return len(self.robots)

    def __getitem__(self, rows: "Bools | Ints") -> "Moments":
        return Moments(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))

    @property
    def lit(self) -> Bools:
        """(g, n): which spots are there."""
        seen: Bools = self.information[..., 0, 0] > 0.0
        return seen

    def without(self, bad: Bools) -> "Moments":
        """Without single spots (g, n)."""
        information = self.information * ~bad[:, :, None, None]
        return Moments(self.robots, self.cameras, self.times_s, self.pixels, information)


def moments_of(seen: Sequence[Seen], start: Start) -> tuple[Moments, Motion]:
    """The moments, and how the robots move in them as far as the poses of single frames tell."""
    windows = [each for robot in range(_robots(seen)) for each in _windows(seen, start, robot)]
    windows = _chosen(windows, len(seen))
    width = LEDS * max(len(window) for window in windows)
    g = len(windows)
    moments = Moments(
        np.empty(g, np.int64), np.zeros((g, width), np.int64), np.zeros((g, width)), np.zeros((g, width, 2)),
        np.zeros((g, width, 2, 2)),
    )  # fmt: skip
    middles, halves, degrees = np.zeros(g), np.zeros(g), np.zeros(g, np.int64)
    places, rotations = np.zeros((g, DEGREE + 1, 3)), np.zeros((g, 3, 3))
    for k, window in enumerate(windows):
        times = []
        for place, (camera, row) in enumerate(window):
            views = seen[camera].views
            spots = slice(LEDS * place, LEDS * (place + 1))
            moments.robots[k] = views.robots[row]
            moments.cameras[k, spots] = camera
            moments.times_s[k, spots] = views.times_s[row] + _row_times(seen[camera], views.centres_px[row])
            moments.pixels[k, spots] = np.nan_to_num(views.centres_px[row])
            moments.information[k, spots] = _information(views.covariances_px2[row])
            times.append(views.times_s[row] - start.offsets_s[camera])
        middles[k], halves[k], degrees[k] = _span(np.array(times), _period(seen))
        moments.times_s[k, LEDS * len(window) :] = middles[k]
        rotations[k], places[k, 0] = _agreed(seen, start, window)
    motion = Motion(middles, halves, degrees, places, rotations, np.zeros((g, DEGREE, 3)))
    return moments, motion


def _robots(seen: Sequence[Seen]) -> int:
    return 1 + max(int(each.views.robots.max(initial=-1)) for each in seen)


def _period(seen: Sequence[Seen]) -> float:
    """From frame to frame, of the slowest camera."""
    periods = [np.diff(np.unique(each.views.times_s)) for each in seen]
    return max(float(np.median(each)) if len(each) else 0.0 for each in periods) or 1e-3


def _windows(seen: Sequence[Seen], start: Start, robot: int) -> "list[list[tuple[int, int]]]":
    """Camera and row of a robot's views, window by window; those in which one camera sees it alone are left out."""
    views = []
    for camera, each in enumerate(seen):
        rows = np.flatnonzero(each.views.robots == robot)
        times = each.views.times_s[rows] - start.offsets_s[camera]
        views += [(float(time), camera, int(row)) for time, row in zip(times, rows, strict=True)]
    views.sort()
    length = LENGTH * _period(seen)
    windows: list[list[tuple[int, int]]] = []
    until = -np.inf
    for time, camera, row in views:
        if time >= until:
            windows.append([])
            until = time + length
        windows[-1].append((camera, row))
    return [window for window in windows if len({camera for camera, _ in window}) > 1]


def _chosen(windows: "list[list[tuple[int, int]]]", cameras: int) -> "list[list[tuple[int, int]]]":
    """No more than it takes: of every set of cameras as many, evenly spread over the time."""
    if not windows:
        return windows
    unknowns = 6 * (DEGREE + 1) + 8 * cameras + 3 * LEDS
    spots = 2 * LEDS * max(len(window) for window in windows)
    most = max(min(MOST, int(MOST_NUMBERS / spots / unknowns)), 10)
    sets: dict[frozenset[int], list[int]] = {}
    for k, window in enumerate(windows):
        sets.setdefault(frozenset(camera for camera, _ in window), []).append(k)
    chosen: list[int] = []
    for left, rows in enumerate(sorted(sets.values(), key=len)):
        share = (most - len(chosen)) // (len(sets) - left)
        chosen += [rows[k] for k in np.unique(np.linspace(0, len(rows) - 1, min(share, len(rows))).round().astype(int))]
    return [windows[k] for k in sorted(chosen)]


def _row_times(seen: Seen, centres: Floats) -> Floats:
    """When a rolling shutter sees the spots (6,), s after mid-frame; 0 of a global one."""
    line_s = seen.rig.capture.line_time_us * 1e-6
    return np.asarray(np.nan_to_num(centres[:, 1] - 0.5 * (seen.rig.camera.height - 1)) * line_s, np.float64)


def _information(covariances: Floats) -> Floats:
    """Inverses (6, 2, 2) of (6, 3); zero where there is no spot."""
    xx, xy, yy = covariances.T + np.array([[LEAST_SIGMA_PX**2], [0.0], [LEAST_SIGMA_PX**2]])
    inverse = np.stack([np.stack([yy, -xy], -1), np.stack([-xy, xx], -1)], -2) / (xx * yy - xy * xy)[:, None, None]
    return np.asarray(np.nan_to_num(inverse), np.float64)


def _span(times: Floats, period_s: float) -> tuple[float, float, int]:
    """The middle of a window, half its length, s, and the degree that so many times tell."""
    apart = int((np.diff(np.sort(times)) > SAME_TIME * period_s).sum())
    return float(0.5 * (times.min() + times.max())), max(0.5 * float(np.ptp(times)), 1e-3), min(apart, DEGREE)


def _agreed(seen: Sequence[Seen], start: Start, window: "list[tuple[int, int]]") -> tuple[Floats, Floats]:
    """The robot's rotation with which most views agree, with one of their tilts, and the mean of its places then."""
    turns, places, owners = [], [], []
    for k, (camera, row) in enumerate(window):
        T, views = start.poses[camera], seen[camera].views
        for tilt in range(TILTS):
            if np.isfinite(views.ts[row, tilt, 0]):
                turns.append(T.rotation @ views.rotations[row, tilt])
                places.append(T.map(views.ts[row, tilt]))
                owners.append(k)
    all_turns, all_places, whose = np.array(turns), np.array(places), np.array(owners)
    chords = np.linalg.norm((all_turns[:, None] - all_turns[None]).reshape(len(turns), -1, 9), axis=-1)
    best = np.full((len(turns), len(window)), APART)
    for k in range(len(window)):
        best[:, k] = np.minimum(APART, chords[:, whose == k].min(axis=1))
    likeliest = int(np.argmin(best.sum(axis=1)))
    alike = chords[likeliest] < APART
    return all_turns[likeliest], all_places[alike].mean(axis=0)
