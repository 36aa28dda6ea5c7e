"""What one camera saw of every robot, from frame reports: labelled spots, and poses to start from."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import report_pose
from asterism.protocol.constellation import LEDS
from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig
from asterism.server.fusing.clocks import Way

FEWEST_LEDS = 4  # of a robot in a frame
TILTS = 2
TILT_VARIANCE = 1e-6  # m^2: what a position whose tilt is open may be off

Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """m times that one camera saw a robot, in the order of time.

    ``times_s`` (m,) by the camera's clock; ``robots`` (m,) by their place in the list that
    all cameras share; ``centres_px`` (m, 6, 2), nan for LEDs not seen, ``covariances_px2`` (m, 6, 3) xx, xy, yy;
    ``rotations`` (m, 2, 3, 3) and ``ts`` (m, 2, 3) T_camera_robot, both tilts, the second nan where there is one only;
    ``spreads`` (m, 3, 3) m^2, of the first's position of the LEDs' mean.
    """

    times_s: Floats
    robots: Ints
    centres_px: Floats
    covariances_px2: Floats
    rotations: Floats
    ts: Floats
    spreads: Floats

    def __len__(self) -> int:
        return len(self.times_s)

    def __getitem__(self, rows: "Ints | NDArray[np.bool_]") -> "Views":
        return Views(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))

    def middles(self, leds: Floats) -> Floats:
        """Where the LEDs' means are (m, 3) in the camera's frame; ``leds`` (robots, 6, 3)."""
        middle: Floats = np.einsum("mij,mj->mi", self.rotations[:, 0], leds.mean(axis=1)[self.robots]) + self.ts[:, 0]
        return middle

    def way_of(self, robot: int, leds: Floats) -> Way:
        """The way of one robot in the camera's frame."""
        mine = self[self.robots == robot]
        return Way(mine.times_s, mine.middles(leds), mine.spreads)


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What a camera's recording holds: its rig, the views, how many frames, and the times of the first and the last."""

    rig: Rig
    views: Views
    frames: int
    span_s: tuple[float, float] = (0.0, 0.0)
    source: str = ""
    camera: str = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "camera", self.rig.camera.name)


def views_of(
    reports: "Iterable[tuple[pb.FrameReport, Rig]]", rig: Rig, robots: Sequence[str], origin_ns: int, source: str
) -> Seen:
    """The views in frame reports, each with the rig that was in force for it; times are after ``origin_ns``.

    Raises InputError for a report that does not fit its rig, or images of another size than ``rig`` is for.
    """
    rows: list[tuple[float, int, Floats, Floats, Floats, Floats, Floats]] = []
    frames, first_s, last_s = 0, np.inf, -np.inf
    for report, then in reports:
        if (then.camera.width, then.camera.height) != (rig.camera.width, rig.camera.height):
            raise InputError(
                f"{source}: images of {then.camera.width}x{then.camera.height} px, expected "
                f"{rig.camera.width}x{rig.camera.height} px as the rig of camera {rig.camera.name} has them"
            )
        time_s = (report.exposed_ns - origin_ns) * 1e-9
        frames, first_s, last_s = frames + 1, min(first_s, time_s), max(last_s, time_s)
        rows += [(time_s, *row) for row in _rows(report, then, robots, source)]
    rows.sort(key=lambda row: row[0])
    columns = list(zip(*rows, strict=True)) or [()] * 7
    times, which = np.array(columns[0], np.float64), np.array(columns[1], np.int64)
    shapes = ((LEDS, 2), (LEDS, 3), (TILTS, 3, 3), (TILTS, 3), (3, 3))
    arrays = [np.array(c, np.float64).reshape(-1, *shape) for c, shape in zip(columns[2:], shapes, strict=True)]
    return Seen(rig, Views(times, which, *arrays), frames, (first_s, last_s), source)


def _rows(
    report: "pb.FrameReport", then: Rig, robots: Sequence[str], source: str
) -> "Iterable[tuple[int, Floats, Floats, Floats, Floats, Floats]]":
    ids = [robot.id for robot in then.robots]
    spots = report.spots
    columns = (spots.x, spots.y, spots.covariance_xx, spots.covariance_xy, spots.covariance_yy, spots.robot, spots.led)
    if [entry.id for entry in report.robots] != ids or len({len(column) for column in columns}) > 1:
        raise InputError(f"{source}: frame {report.sequence} does not fit the rig that the recording holds")
    whose, led = np.array(spots.robot, np.int64), np.array(spots.led, np.int64)
    numbers = np.array([column[:] for column in columns[:5]]).T
    T_parent_camera = then.T_world_camera or Pose.identity()
    if report.HasField("camera"):
        T_parent_camera = report_pose(report.camera.pose)
    for k, entry in enumerate(report.robots):
        mine = np.flatnonzero((whose == k) & (led >= 0) & (led < LEDS))
        if not entry.HasField("pose") or len(mine) < FEWEST_LEDS or entry.id not in robots:
            continue
        centres, covariances = np.full((LEDS, 2), np.nan), np.full((LEDS, 3), np.nan)
        centres[led[mine]], covariances[led[mine]] = numbers[mine, :2], numbers[mine, 2:]
        tilts = [entry.pose] + ([entry.alternative.pose] if entry.HasField("alternative") else [])
        poses = [T_parent_camera.inverse() @ report_pose(each) for each in tilts]
        rotations, ts = np.full((TILTS, 3, 3), np.nan), np.full((TILTS, 3), np.nan)
        for tilt, pose in enumerate(poses):
            rotations[tilt], ts[tilt] = pose.rotation, pose.position
        spread = _spread(entry, then, T_parent_camera, poses[0]) + TILT_VARIANCE * (len(poses) > 1) * np.eye(3)
        yield robots.index(entry.id), centres, covariances, rotations, ts, spread


def _spread(entry: "pb.RobotReport", then: Rig, T_parent_camera: Pose, pose: Pose) -> Floats:
    """Covariance (3, 3) of where the LEDs' mean is in the camera's frame."""
    turn = np.kron(np.eye(2), T_parent_camera.rotation.T)
    covariance = turn @ np.array(entry.covariance[:]).reshape(6, 6) @ turn.T
    x, y, z = pose.rotation @ then.robot(entry.id).leds.mean(axis=0)
    by = np.hstack([np.eye(3), [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]])
    return np.asarray(by @ covariance @ by.T, np.float64)
