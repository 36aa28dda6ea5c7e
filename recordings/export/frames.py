"""What every exported file is made of: frames, each with what it tells of its robots.

They come from a recording (`frames_of`), from lines of `asterism locate` (`lines`), or from whatever made others of
these. Numbers are kept as they were recorded, to the last bit.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import report_pose
from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.messages import FRAME_REPORT, ODOMETRY, Message, RobotPose, State, Velocity
from asterism.protocol.rig import Rig
from asterism.protocol.standing import standing_name
from asterism.recordings.decodable import read_odometry, read_report

Numbers = tuple[float, ...]
Point = tuple[float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Alternative:
    """The other tilt that explains the spots: position m, quaternion x y z w, and how many times less likely it is."""

    position: Numbers
    orientation: Numbers
    odds: float


@dataclass(frozen=True, slots=True, eq=False)
class ExportedSurface:
    """How a robot stands on the surface, as `OnSurface` of asterism.proto; numbers are None where there is no surface
    to measure from. ``without``: position m, quaternion x y z w and covariance (36 numbers) by light alone, None where
    the surface was not used.
    """

    standing: str
    reason: str = ""
    off_m: float | None = None
    off_sigma_m: float | None = None
    tilt_off_rad: float | None = None
    tilt_off_sigma_rad: float | None = None
    without: tuple[Numbers, Numbers, Numbers] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ExportedRobot:
    """One robot in one frame. ``position`` (3 numbers, m) and ``orientation`` (x y z w) are T_<frame_id>_<robot>, None
    where it was not located, and then ``reason`` says why.

    ``covariance`` are 36 numbers, row-major, m and rad: x, y, z, rotation about x, y, z of the parent frame.
    ``residuals_px`` are observed minus predicted, by LED; ``points`` named points in the frame of the pose, m.
    ``spots_px2`` is the mean variance of a coordinate of its spots, None where none is told; ``misfit_m`` how far off
    the rig has its LEDs, as frames before told, 0 where they told nothing; ``cameras`` those that the pose rests on,
    where several are joined. ``surface`` is there where the robot by the rig stands on one.
    """

    id: str
    state: str
    reason: str = ""
    position: Numbers | None = None
    orientation: Numbers | None = None
    covariance: Numbers | None = None
    leds: int | None = None
    rms_px: float | None = None
    residuals_px: dict[int, tuple[float, float]] = field(default_factory=dict)
    points: dict[str, Point] = field(default_factory=dict)
    velocity: Velocity | None = None
    alternative: Alternative | None = None
    smoothed_by: str = ""
    extrapolated: bool = False
    spots_px2: float | None = None
    misfit_m: float = 0.0
    cameras: tuple[str, ...] = ()
    surface: ExportedSurface | None = None

    @property
    def pose(self) -> Pose | None:
        """T_<frame_id>_<robot>; None where it was not located."""
        if self.position is None or self.orientation is None:
            return None
        return Pose(self.position, self.orientation)  # type: ignore[arg-type]

    def moved(self, pose: Pose, covariance: Floats, velocity: Velocity | None, smoothed_by: str) -> "ExportedRobot":
        """The robot at another pose, its named points with it: what smoothing makes of one that was located."""
        assert self.pose is not None
        there = pose @ self.pose.inverse()
        points = {name: _point(there.map(point)) for name, point in self.points.items()}  # type: ignore[arg-type]
        return replace(
            self,
            position=tuple(pose.position.tolist()),
            orientation=tuple(pose.orientation.tolist()),
            covariance=tuple(covariance.ravel().tolist()),
            points=points,
            velocity=velocity,
            smoothed_by=smoothed_by,
        )


@dataclass(frozen=True, slots=True, eq=False)
class ExportedFrame:
    """One frame: its name and number, mid-exposure in ns since the Unix epoch, the server's session (0: none is known),
    the parent frame of its poses, and the robots of the rig that was in force.

    ``T_world_camera`` is there where the rig follows its camera's place, with its covariance, 36 numbers.
    """

    name: str
    sequence: int
    exposed_ns: int
    session: int
    frame_id: str
    robots: tuple[ExportedRobot, ...]
    T_world_camera: Pose | None = None
    camera_covariance: Numbers = ()


def points_of(rigs: Iterable[Rig]) -> dict[str, list[str]]:
    """The robots of all rigs that were in force, in their order, with the names of their points."""
    found: dict[str, list[str]] = {}
    for rig in rigs:
        for robot in rig.robots:
            names = found.setdefault(robot.id, [])
            names += [name for name in robot.points if name not in names]
    return found


def frames_of(messages: Iterable[Message], where: Path) -> Iterator[ExportedFrame]:
    """The frames that a recording's messages tell of, in their order. A frame whose report was lost, as damage does,
    is made of its odometry messages alone: who is not in them is not told of.

    Raises InputError for a message that no server of Asterism makes; ``where`` is the recording.
    """
    told: dict[str, RobotPose] = {}  # of the frame whose report is still to come
    for message in messages:
        if message.kind.schema == ODOMETRY.schema:
            pose = read_odometry(message.payload, where)
            if any(not _together(pose, other) for other in told.values()):
                yield _of_odometry(told)
                told = {}
            told[pose.robot] = pose
        elif message.kind.schema == FRAME_REPORT.schema:
            report = read_report(message.payload, where)
            if any((p.session, p.sequence) != (report.session, report.sequence) for p in told.values()):
                yield _of_odometry(told)
                told = {}
            yield _of_report(report, told)
            told = {}
    if told:
        yield _of_odometry(told)


def _together(a: RobotPose, b: RobotPose) -> bool:
    return (a.session, a.sequence) == (b.session, b.sequence)


def _of_odometry(told: dict[str, RobotPose]) -> ExportedFrame:
    first = next(iter(told.values()))
    robots = tuple(
        ExportedRobot(
            pose.robot,
            pose.state,
            position=tuple(pose.position.tolist()),
            orientation=tuple(pose.orientation.tolist()),
            covariance=tuple(pose.covariance.ravel().tolist()),
            leds=pose.leds,
            rms_px=pose.rms_px,
            velocity=pose.velocity,
            smoothed_by=pose.smoothed_by,
            extrapolated=pose.extrapolated,
            cameras=pose.cameras,
            surface=ExportedSurface(pose.standing) if pose.standing else None,
        )
        for pose in told.values()
    )
    number = first.sequence
    return ExportedFrame(str(number), number, first.exposed_ns, first.session, first.frame_id, robots)


def _of_report(report: "pb.FrameReport", told: dict[str, RobotPose]) -> ExportedFrame:
    misfits = [*report.learned.led_misfit, *[0.0] * (len(report.robots) - len(report.learned.led_misfit))]
    robots = tuple(
        replace(_robot(robot, told.get(robot.id)), misfit_m=misfits[k], spots_px2=_spots_px2(report, robot))
        for k, robot in enumerate(report.robots)
    )
    place = report_pose(report.camera.pose) if report.HasField("camera") else None
    spread = tuple(report.camera.covariance)
    number = report.sequence
    return ExportedFrame(str(number), number, report.exposed_ns, report.session, report.frame_id, robots, place, spread)


def _robot(robot: "pb.RobotReport", told: RobotPose | None) -> ExportedRobot:
    """``told`` is its odometry message: only that knows a velocity."""
    state = State.Name(robot.state)
    if not robot.HasField("pose"):
        return ExportedRobot(robot.id, state, robot.reason)
    p, q = robot.pose.position, robot.pose.orientation
    covariance = tuple(robot.covariance)
    return ExportedRobot(
        robot.id,
        state,
        position=(p.x, p.y, p.z),
        orientation=(q.x, q.y, q.z, q.w),
        covariance=covariance if len(covariance) == 36 else None,
        leds=robot.leds,
        rms_px=robot.rms_px,
        residuals_px=dict(zip(robot.led, zip(robot.residual_x, robot.residual_y, strict=True), strict=True)),
        points={name: (point.x, point.y, point.z) for name, point in robot.points.items()},
        velocity=told.velocity if told is not None else None,
        alternative=_alternative(robot),
        smoothed_by=robot.smoothed_by,
        extrapolated=robot.extrapolated,
        cameras=tuple(robot.cameras),
        surface=_surface(robot.surface) if robot.HasField("surface") else None,
    )


def _surface(told: "pb.OnSurface") -> ExportedSurface:
    without = None
    if told.HasField("without") and len(told.without_covariance) == 36:
        p, q = told.without.position, told.without.orientation
        without = (p.x, p.y, p.z), (q.x, q.y, q.z, q.w), tuple(told.without_covariance)
    off, off_sigma, tilt, tilt_sigma = (
        value if math.isfinite(value) else None
        for value in (told.off_m, told.off_sigma_m, told.tilt_off_rad, told.tilt_off_sigma_rad)
    )
    return ExportedSurface(standing_name(told.standing), told.reason, off, off_sigma, tilt, tilt_sigma, without)


def _spots_px2(report: "pb.FrameReport", robot: "pb.RobotReport") -> float | None:
    xx, yy = report.spots.covariance_xx, report.spots.covariance_yy
    own = [0.5 * (xx[k] + yy[k]) for k in robot.spot if 0 <= k < min(len(xx), len(yy))]
    return sum(own) / len(own) if own else None


def _alternative(robot: "pb.RobotReport") -> Alternative | None:
    if not robot.HasField("alternative"):
        return None
    p, q = robot.alternative.pose.position, robot.alternative.pose.orientation
    return Alternative((p.x, p.y, p.z), (q.x, q.y, q.z, q.w), robot.alternative.odds)


def _point(values: Floats) -> Point:
    x, y, z = values.tolist()
    return x, y, z
