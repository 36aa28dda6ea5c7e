"""Every camera's newest frame but one, as the rays of robots' LEDs: what the next frame's are compared with."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.fusing.follow import JERKS, UNKNOWN_RATES
from asterism.server.fusing.gather import PER_AXIS, Sight
from asterism.server.fusing.joint_rays import Bundle, Motion
from asterism.server.pose.fit import LEDS

LONGEST_NS = 100_000_000  # from a camera's frame to the one before, to tell motion by

Spots = Mapping[str, NDArray[np.int64]]


class Film(NamedTuple):
    """A camera's frame: of r robots' LEDs the ``rays`` (r, 6, 2), nan where they are not seen, their ``covariances``
    (r, 6, 3) and ``times`` (r, 6) s after the exposure.
    """

    exposed_ns: int
    rays: Floats
    covariances: Floats
    times: Floats


def films_of(cameras: Sequence[str], spots: Mapping[str, Spots], sight: Sight) -> dict[str, Film]:
    """The frames of cameras that exposed now, of those robots' ``spots``, by their ids and the cameras' names."""
    c, r = len(cameras), len(sight.robots)
    rows = np.full((c, r, LEDS), -1)
    for robot, by_camera in spots.items():
        for k, camera in enumerate(cameras):
            if camera in by_camera:
                rows[k, sight.robots[robot]] = by_camera[camera]
    seen = rows >= 0
    some = (rows + np.array([sight.first[camera] for camera in cameras])[:, None, None])[seen]
    rays, covariances = np.full((c, r, LEDS, 2), np.nan), np.zeros((c, r, LEDS, 3))
    times = np.zeros((c, r, LEDS))
    rays[seen], covariances[seen], times[seen] = sight.rays[some], sight.covariances[some], sight.times[some]
    return {camera: Film(sight.exposed_ns, rays[k], covariances[k], times[k]) for k, camera in enumerate(cameras)}


def pairs_of(
    robots: NDArray[np.int64], before: Mapping[str, Film], now: Mapping[str, Film], sight: Sight
) -> tuple[Bundle, Motion]:
    """The rays of robots, rows (m,), in frames of this exposure and, after them, in the same cameras' frames before."""
    names = [name for name, film in now.items() if name in before and _is_near(before[name], film)]
    m = len(robots)
    motion = Motion(
        np.zeros(m), np.zeros((m, 12)), np.tile(UNKNOWN_RATES, (m, 1, 1)),
        np.tile(JERKS[-1] * PER_AXIS, (m, 1)),
    )  # fmt: skip
    films = [film for name in names for film in (now[name], before[name])]
    if not films:
        return _no_pairs(robots), motion
    # By robot, camera and whether now or before, and LED.
    rays, covariances, times = (np.array([film[k] for film in films])[:, robots] for k in (1, 2, 3))
    seen = np.isfinite(rays[0::2, :, :, 0]) & np.isfinite(rays[1::2, :, :, 0])
    which, pair, leds = np.nonzero(seen.transpose(1, 0, 2))
    count = np.bincount(which, minlength=m)
    first = np.concatenate([[0], np.cumsum(2 * count)])
    # All of a robot's rays now, then in the same order those of before.
    to = np.arange(len(which)) + np.repeat(first[:-1] - np.cumsum(count) + count, count)
    rows = np.empty((3, 2 * len(which)), np.int64)
    rows[:, to] = 2 * pair, which, leds
    rows[:, to + count[which]] = 2 * pair + 1, which, leds
    film, robot, led = rows
    late = np.array(
        [(one.exposed_ns - now[name].exposed_ns) * 1e-9 for name in names for one in (now[name], before[name])]
    )
    numbers = np.array([sight.number[name] for name in names])
    bundle = Bundle(
        first, rays[film, robot, led], covariances[film, robot, led], numbers[film // 2], led.copy(),
        times[film, robot, led] + late[film], robots, np.zeros(m),
    )  # fmt: skip
    return bundle, motion


def _is_near(before: Film, now: Film) -> bool:
    return 0 < now.exposed_ns - before.exposed_ns <= LONGEST_NS


def _no_pairs(robots: NDArray[np.int64]) -> Bundle:
    m, none = len(robots), np.zeros(0, np.int64)
    return Bundle(
        np.zeros(m + 1, np.int64), np.zeros((0, 2)), np.zeros((0, 3)), none, none, np.zeros(0), robots, np.zeros(m)
    )
