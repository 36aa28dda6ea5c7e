"""What calibrations fit to: the labelled LED centres of every robot in every frame of a source, with its pose.

Every frame is localized alone, so that no pose leans on the one before it.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig
from asterism.server.chain.frame import Frame
from asterism.server.chain.pipeline import localize
from asterism.server.pose.fit import LEDS
from asterism.server.pose.solve import PoseEstimate
from asterism.server.pose.track import Tracks
from asterism.server.segmentation.spot_table import SHOULDER


@dataclass(frozen=True, slots=True, eq=False)
class LedCentres:
    """A robot's LEDs in an image; row k is LED k, nan where it is not seen.

    ``centres_px`` (6, 2); ``covariances_px2`` (6, 2, 2) as the estimator of centres says; ``strange_px`` (6,) what
    these allow for light that it cannot explain.
    """

    centres_px: Floats
    covariances_px2: Floats
    strange_px: Floats = field(default_factory=lambda: np.zeros(LEDS))

    @staticmethod
    def of(
        spots: Floats, covariances: Floats, labels: Iterable[int], leds: Iterable[int], strange: Floats | None = None
    ) -> "LedCentres":
        """From a frame's spots (n, 2) px, their covariances (n, 3) xx, xy, yy px^2 and strange light (n,) px: spot
        ``labels[k]`` is LED ``leds[k]``.
        """
        centres, spreads = np.full((LEDS, 2), np.nan), np.full((LEDS, 2, 2), np.nan)
        allowed = np.zeros(LEDS)
        for spot, led in zip(labels, leds, strict=True):
            centres[led] = spots[spot]
            xx, xy, yy = covariances[spot]
            spreads[led] = [[xx, xy], [xy, yy]]
            allowed[led] = 0.0 if strange is None else strange[spot]
        return LedCentres(centres, spreads, allowed)

    @property
    def count(self) -> int:
        """How many LEDs are seen."""
        return int(np.isfinite(self.centres_px[:, 0]).sum())


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """One robot in one frame.

    ``pose`` is T_camera_robot, also where the rig has a world; ``covariance`` (6, 6), m and rad, about the camera's
    axes. ``alternative`` is the other tilt that explains the spots, None where there is no doubt.
    """

    frame: str  # the frame's name
    index: int  # the frame's number in its source
    robot: str
    centres: LedCentres
    pose: Pose
    covariance: Floats
    alternative: Pose | None
    without: Pose | None = None  # by light alone, where the pose rests on the surface too


def observe(frames: Iterable[Frame], rig: Rig) -> Iterator[tuple[Frame, list[Sighting]]]:
    """Every frame with the robots that were located in it. Raises InputError as `localize` does."""
    if rig.follows_world:
        rig = replace(rig, follows_world=False)  # poses about the camera are told
    T_camera_parent = (rig.T_world_camera or Pose.identity()).inverse()
    turn = np.kron(np.eye(2), T_camera_parent.rotation)
    for frame in frames:
        result, _ = localize(frame, rig, Tracks.none())
        blobs = result.blobs
        sightings = []
        for robot, answer in result.answers.items():
            if not isinstance(answer, PoseEstimate):
                continue
            other = answer.alternative
            sightings.append(
                Sighting(
                    frame.name,
                    frame.index,
                    robot,
                    LedCentres.of(
                        blobs.centres_px, blobs.covariances_px2, answer.spots, answer.leds, blobs.table[:, SHOULDER]
                    ),
                    T_camera_parent @ answer.pose,
                    turn @ answer.covariance @ turn.T,
                    None if other is None else T_camera_parent @ other.pose,
                    _by_light(answer, T_camera_parent),
                )
            )
        yield frame, sightings


def _by_light(answer: PoseEstimate, T_camera_parent: Pose) -> Pose | None:
    told = None if answer.surface is None else answer.surface.without
    return None if told is None else T_camera_parent @ told
