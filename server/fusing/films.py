"""Every camera's newest frame but one, as the rays of robots' LEDs: what the next frame's are compared with."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.fusing.follow import ARM2, JERKS, UNKNOWN_RATES
from asterism.server.fusing.gather import Sight
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


def film_of(camera: str, spots: Mapping[str, Spots], sight: Sight) -> Film:
    """A camera's frame of those robots' ``spots``, by their ids and the camera's name."""
    r, rows = len(sight.robots), np.full((len(sight.robots), LEDS), -1)
    for robot, by_camera in spots.items():
        if camera in by_camera:
            rows[sight.robots[robot]] = by_camera[camera]
    seen = rows >= 0
    some = rows[seen] + sight.first[camera]
    exposed_ns = sight.sightings[camera].exposed_ns
    film = Film(exposed_ns, np.full((r, LEDS, 2), np.nan), np.zeros((r, LEDS, 3)), np.zeros((r, LEDS)))
    film.rays[seen], film.covariances[seen] = sight.rays[some], sight.covariances[some]
    film.times[seen] = sight.times[some] - (exposed_ns - sight.exposed_ns) * 1e-9
    return film


def pairs_of(
    robots: NDArray[np.int64], before: Mapping[str, Film], now: Mapping[str, Film], sight: Sight
) -> tuple[Bundle, Motion]:
    """The rays of robots, rows (m,), in frames of this exposure and, after them, in the same cameras' frames before."""
    names = [name for name, film in now.items() if name in before and _is_near(before[name], film)]
    m = len(robots)
    motion = Motion(
        np.zeros(m), np.zeros((m, 12)), np.tile(UNKNOWN_RATES, (m, 1, 1)),
        np.tile(JERKS[-1] * np.repeat([1.0, ARM2], 3), (m, 1)),
    )  # fmt: skip
    parts = [_pair(robots, before[name], now[name], sight.number[name]) for name in names]
    rows, rays, covariances, cameras, leds, times = map(np.concatenate, zip(*(parts or [_nothing()]), strict=True))
    order = np.argsort(rows, kind="stable")
    first = np.searchsorted(rows[order], 2 * np.arange(m + 1))
    bundle = Bundle(
        first, rays[order], covariances[order], cameras[order], leds[order], times[order], robots, np.zeros(m)
    )
    return bundle, motion


def _is_near(before: Film, now: Film) -> bool:
    return 0 < now.exposed_ns - before.exposed_ns <= LONGEST_NS


def _pair(robots: NDArray[np.int64], before: Film, now: Film, camera: int) -> Sequence[NDArray[Any]]:
    """Columns of the rays that both frames show: twice the row of their robot, plus one for the frame before."""
    seen = np.isfinite(now.rays[robots, :, 0]) & np.isfinite(before.rays[robots, :, 0])
    which, leds = np.nonzero(seen)
    k, apart_s = robots[which], (before.exposed_ns - now.exposed_ns) * 1e-9
    films = ((0, now, 0.0), (1, before, apart_s))
    return (
        np.concatenate([2 * which + older for older, _, _ in films]),
        np.concatenate([film.rays[k, leds] for _, film, _ in films]),
        np.concatenate([film.covariances[k, leds] for _, film, _ in films]),
        np.full(2 * len(k), camera),
        np.concatenate([leds, leds]),
        np.concatenate([film.times[k, leds] + late for _, film, late in films]),
    )


def _nothing() -> Sequence[NDArray[Any]]:
    none = np.zeros(0, np.int64)
    return none, np.zeros((0, 2)), np.zeros((0, 3)), none, none, np.zeros(0)
