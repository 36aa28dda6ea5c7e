"""Frames through the chain, and what the checks need of them: arrays, no images."""

from collections import Counter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.constellation import LEDS
from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig
from asterism.server.chain.frame import Frame, FrameResult
from asterism.server.chain.pipeline import localize
from asterism.server.doctor.cuts import Cut, Cutter
from asterism.server.pose.solve import PoseEstimate
from asterism.server.pose.track import Tracks
from asterism.server.segmentation.spot_table import ANGLE, NOISE, SATURATED_SHARE, SEMI_A, SEMI_B
from asterism.server.service.tally import BRIGHT, Tally

Ints = NDArray[np.int64]
STEP = 4  # every so many rows and columns are looked at for the share of bright pixels


class Times(NamedTuple):
    """Of all n frames that came, looked at or not: ``exposed_ns``, ``indices`` and ``clocks`` (n,)."""

    exposed_ns: Ints
    indices: Ints
    clocks: Ints


class Pictures(NamedTuple):
    """n frames that were looked at: ``exposed_ns`` (n,); ``bright`` (n,) the share of pixels that are as good as
    saturated; ``fates`` of their spots, counted; ``spots``, of each its (k, 4) x, y px, height, fate of all spots.
    """

    exposed_ns: Ints
    bright: Floats
    fates: list[Counter[int]]
    spots: list[Floats]


class Sightings(NamedTuple):
    """m sightings of robots. ``frames`` and ``robots`` (m,), places in the stream and in the rig; ``poses``
    T_camera_robot; by LED, nan where one was not seen: ``centres`` and ``residuals`` (m, 6, 2) px, ``covariances``
    (m, 6, 3) px^2, ``heights`` and ``noises`` (m, 6) grey levels, ``saturated`` (m, 6) shares, ``shapes`` (m, 6, 3)
    semi-axes, px, and angle.
    """

    frames: Ints
    robots: Ints
    poses: list[Pose]
    centres: Floats
    residuals: Floats
    covariances: Floats
    heights: Floats
    noises: Floats
    saturated: Floats
    shapes: Floats

    @property
    def lit(self) -> NDArray[np.bool_]:
        """Which LEDs (m, 6) were seen."""
        return np.isfinite(self.heights)

    @property
    def columns(self) -> list[Floats]:
        """What there is by LED."""
        return [
            *(self.centres, self.residuals, self.covariances),
            *(self.heights, self.noises, self.saturated, self.shapes),
        ]

    def of(self, robot: int) -> "Sightings":
        """Those of one robot."""
        return self.take(np.flatnonzero(self.robots == robot))

    def take(self, rows: Ints) -> "Sightings":
        """Some of them."""
        poses = [self.poses[k] for k in rows.tolist()]
        return Sightings(self.frames[rows], self.robots[rows], poses, *(column[rows] for column in self.columns))


class Gathered(NamedTuple):
    """All that the frames told. ``cuts`` are some LEDs' pixels, ``tally`` is what a server would keep of them."""

    rig: Rig
    times: Times
    pictures: Pictures
    sightings: Sightings
    cuts: list[Cut]
    tally: Tally


class Gatherer:
    """Takes frames, one after the other."""

    def __init__(self, rig: Rig, tracks: Tracks | None = None) -> None:
        self.rig = rig
        self.tracks = tracks or Tracks.none()
        self.tally = Tally(robot.id for robot in rig.robots)
        self.cutter = Cutter(rig)
        T_world_camera = rig.T_world_camera or Pose.identity()
        self._T_camera_parent = T_world_camera.inverse()
        self._times: list[tuple[int, int, int]] = []
        self._pictures: list[tuple[int, float, Counter[int], Floats]] = []
        self._seen: list[tuple[int, int, Pose]] = []
        self._numbers: list[Floats] = []

    def note(self, frame: Frame) -> None:
        """Keep a frame's stamp; of every frame that came, in order."""
        self._times.append((frame.exposed_ns, frame.index, int(frame.clock)))

    def add(self, frame: Frame) -> FrameResult:
        """Localize one frame and keep what it tells. Raises InputError as `localize` does."""
        result, self.tracks = localize(frame, self.rig, self.tracks)
        self.tally.add(frame, result)
        place, blobs = len(self._pictures), result.blobs
        bright = float((frame.image[::STEP, ::STEP] >= BRIGHT).mean())
        spots = np.column_stack([blobs.centres_px, blobs.heights, blobs.fates.astype(np.float64)])
        fates = Counter(blobs.fates.tolist())
        self._pictures.append((frame.exposed_ns, bright, fates, spots))
        for number, robot in enumerate(self.rig.robots):
            answer = result.answers[robot.id]
            if isinstance(answer, PoseEstimate):
                pose = self._T_camera_parent @ answer.pose
                self._seen.append((place, number, pose))
                self._numbers.append(_by_led(answer, result))
                self.cutter.add(frame.image, blobs, number, pose, answer)
        if not any(isinstance(answer, PoseEstimate) for answer in result.answers.values()):
            self.cutter.add_unknown(frame.image, blobs)
        return result

    def __len__(self) -> int:
        return len(self._pictures)

    def gathered(self) -> Gathered:
        """What there is so far."""
        frames, robots, poses = zip(*self._seen, strict=True) if self._seen else ((), (), ())
        numbers = np.array(self._numbers).reshape(-1, LEDS, 13)
        parts = np.split(numbers, (2, 4, 7, 8, 9, 10), axis=2)
        flat = [part[..., 0] if 3 <= k <= 5 else part for k, part in enumerate(parts)]
        whole = np.array(frames, np.int64), np.array(robots, np.int64)
        times = np.array(self._times, np.int64).reshape(-1, 3).T
        return Gathered(
            self.rig,
            Times(*times),
            self._all_pictures(),
            Sightings(*whole, list(poses), *flat),
            self.cutter.cuts,
            self.tally,
        )

    def _all_pictures(self) -> Pictures:
        times, bright, fates, spots = zip(*self._pictures, strict=True) if self._pictures else ((), (), (), ())
        return Pictures(np.array(times, np.int64), np.array(bright, np.float64), list(fates), list(spots))


def _by_led(answer: PoseEstimate, result: FrameResult) -> Floats:
    """The row (6, 13) of a sighting: centre, residual, covariance, height, noise, saturated share, shape."""
    row = np.full((LEDS, 13), np.nan)
    leds, spots = list(answer.leds), list(answer.spots)
    table = result.blobs.table[spots]
    row[leds, :2], row[leds, 2:4] = result.blobs.centres_px[spots], answer.residuals_px
    row[leds, 4:7] = result.blobs.covariances_px2[spots]
    row[leds, 7] = result.blobs.heights[spots]
    row[leds, 8:10] = table[:, [NOISE, SATURATED_SHARE]]
    row[leds, 10:13] = table[:, [SEMI_A, SEMI_B, ANGLE]]
    return row
