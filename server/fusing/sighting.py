"""One camera's frame as fusing takes it: a frame report as arrays, its spots as rays."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import report_pose
from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.messages import Fate
from asterism.server.fusing.fleet import View
from asterism.server.fusing.reported import refuse_impossible
from asterism.server.pose.fit import LEDS
from asterism.server.pose.lens import FX, FY, undistort
from asterism.server.pose.matched import LEAST_SIGMA_PX

SHOWN = 40  # of names from the network, in sentences
LED, UNEXPLAINED = int(Fate.LED), int(Fate.UNEXPLAINED)  # of spots that may be LEDs


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """A camera's frame: the spots that may be LEDs, n of them, in the order of the report.

    ``centres_px`` (n, 2) with ``covariances_px2`` (n, 3) xx, xy, yy; ``rays`` (n, 2) = (x / z, y / z) in the camera's
    frame with ``ray_covariances`` (n, 3); ``robots`` (n,) of the view's rig and ``leds`` (n,), -1 where the camera does
    not say whose they are. ``told`` is what the camera says of its robots, by their ids; ``misfits_m`` how far off
    their LEDs were found to be, one sigma, m, 0 where nothing is known yet. T_world_camera with its covariance (6, 6),
    m and rad about the world's axes: where the camera was.

    By that, once for all exposures in which the frame counts: ``weighed`` (n, 3), the rays' covariances, none less than
    centres are known at best; ``row_times`` (n,) s after the exposure, by a rolling shutter; ``spots`` (6,) by the
    robots that the camera found, rows, -1 for LEDs not seen; ``tilts`` by those that it sees in two; and whether all
    is settled, ``is_clear``: it tells where those robots are, and no other spot may be an LED.
    """

    view: View
    exposed_ns: int
    session: int
    sequence: int
    T_world_camera: Pose
    place_covariance: Floats
    centres_px: Floats
    covariances_px2: Floats
    rays: Floats
    ray_covariances: Floats
    robots: NDArray[np.int64]
    leds: NDArray[np.int64]
    told: "dict[str, pb.RobotReport]"
    misfits_m: dict[str, float]
    weighed: Floats = field(init=False)
    row_times: Floats = field(init=False)
    spots: dict[str, NDArray[np.int64]] = field(init=False)
    tilts: dict[str, tuple[Pose, Pose]] = field(init=False)
    is_clear: bool = field(init=False)
    camera: str = field(init=False)

    def __post_init__(self) -> None:
        owned = self.robots >= 0
        labels = np.full((len(self.told), LEDS), -1)
        labels[self.robots[owned], self.leds[owned]] = np.flatnonzero(owned)
        seen = labels >= 0
        spots = {robot: labels[k] for k, robot in enumerate(self.told) if seen[k].any()}
        is_clear = bool(owned.all() or seen.all()) and all(self.told[robot].HasField("pose") for robot in spots)
        object.__setattr__(self, "camera", self.view.camera)
        object.__setattr__(self, "spots", spots)
        object.__setattr__(
            self,
            "tilts",
            {robot: _tilts(self.told[robot]) for robot in spots if self.told[robot].HasField("alternative")},
        )
        object.__setattr__(self, "is_clear", is_clear)
        object.__setattr__(self, "weighed", _weighed(self))
        object.__setattr__(self, "row_times", _row_times(self))


def sighting_of(report: "pb.FrameReport", view: View) -> Sighting:
    """The sighting in a frame report of that camera. Raises InputError for a report that does not fit its rig."""
    ids = [robot.id for robot in view.rig.robots]
    if [entry.id for entry in report.robots] != ids:
        raise InputError(
            f"a frame report of camera {view.camera} tells of robots {_named(report)}, "
            f"expected those of its rig: {', '.join(ids)}"
        )
    refuse_impossible(report, view)
    spots = report.spots
    columns = (spots.x, spots.y, spots.covariance_xx, spots.covariance_xy, spots.covariance_yy)
    fates = np.array(spots.fate, np.int64)
    kept = np.flatnonzero((fates == LED) | (fates == UNEXPLAINED))
    numbers = [np.array(column, np.float64)[kept] for column in columns]
    centres, covariances = np.column_stack(numbers[:2]), np.column_stack(numbers[2:])
    robots, leds = np.array(spots.robot, np.int64)[kept], np.array(spots.led, np.int64)[kept]
    rays, ray_covariances = np.empty_like(centres), np.empty_like(covariances)
    undistort(view.lens, centres, covariances, rays, ray_covariances)
    T_world_camera, place_covariance = view.T_world_camera, view.place_covariance
    if report.HasField("camera"):
        T_world_camera = report_pose(report.camera.pose)
        place_covariance = np.array(report.camera.covariance[:], np.float64).reshape(6, 6)
    misfits = dict(zip(ids, report.learned.led_misfit, strict=False))
    return Sighting(
        view=view,
        exposed_ns=report.exposed_ns,
        session=report.session,
        sequence=report.sequence,
        T_world_camera=T_world_camera,
        place_covariance=place_covariance,
        centres_px=centres,
        covariances_px2=covariances,
        rays=rays,
        ray_covariances=ray_covariances,
        robots=robots,
        leds=leds,
        told={entry.id: entry for entry in report.robots},
        misfits_m=misfits,
    )


def _named(report: "pb.FrameReport") -> str:
    names = ", ".join(entry.id[:SHOWN] for entry in report.robots[:SHOWN])[: 5 * SHOWN]
    return "".join(char if char.isprintable() else "?" for char in names)


def _weighed(sighting: Sighting) -> Floats:
    lens = sighting.view.lens
    out: Floats = sighting.ray_covariances + LEAST_SIGMA_PX**2 / (lens[FX] * lens[FY]) * np.array([1.0, 0.0, 1.0])
    return out


def _row_times(sighting: Sighting) -> Floats:
    rig = sighting.view.rig
    line_s = 1e-6 * rig.capture.line_time_us
    if not line_s > 0.0:
        return np.zeros(len(sighting.rays))
    out: Floats = (sighting.centres_px[:, 1] - 0.5 * (rig.camera.height - 1)) * line_s
    return out


def _tilts(told: "pb.RobotReport") -> tuple[Pose, Pose]:
    return report_pose(told.pose), report_pose(told.alternative.pose)
