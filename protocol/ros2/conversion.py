"""What Asterism publishes, as ROS 2 tells it: pure functions from decoded messages to values.

Poses are in `world` (z up, REP 103), or in the camera's frame where the rig has no world: x right, y down, z forward,
which REP 103 calls an optical frame. The child frame is the robot's id, a named point's is `<id>/<point>`. Stamps are
mid-exposure. A pose's covariance is about the fixed axes of the parent frame here as there.

A twist that nobody knows is zero with a variance of 1e6 on the diagonal, (km/s)^2: nav_msgs/Odometry has no sign for
"unknown", and of the habits around it this one harms nobody. The -1 that sensor_msgs/Imu agrees on is taken by
robot_localization for its absolute value, zeros for certainty.
"""

from collections.abc import Iterable

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import report_pose
from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.messages import RobotPose
from asterism.protocol.rig import Rig
from asterism.protocol.ros2.values import (
    ERROR,
    OK,
    WARN,
    DiagnosticArray,
    DiagnosticStatus,
    Header,
    Odometry,
    PoseWithCovarianceStamped,
    TFMessage,
    TransformStamped,
)

UNKNOWN_VARIANCE = 1e6  # (m/s)^2 and (rad/s)^2
_STILL = (0.0, 0.0, 0.0)
_UNKNOWN = tuple(UNKNOWN_VARIANCE if k % 7 == 0 else 0.0 for k in range(36))


def pose_with_covariance(told: RobotPose) -> PoseWithCovarianceStamped:
    """Where the robot is."""
    return PoseWithCovarianceStamped(Header(told.exposed_ns, told.frame_id), told.pose, _flat(told.covariance))


def odometry(told: RobotPose) -> Odometry:
    """Where the robot is and how it moves, which only a server that smooths knows."""
    linear, angular, covariance = _STILL, _STILL, _UNKNOWN
    if told.velocity is not None:
        linear, angular = _three(told.velocity.linear), _three(told.velocity.angular)
        covariance = _flat(told.velocity.covariance)
    header = Header(told.exposed_ns, told.frame_id)
    return Odometry(header, told.robot, told.pose, _flat(told.covariance), linear, angular, covariance)


def robot_transform(told: RobotPose) -> TransformStamped:
    """The robot's frame in that of its pose."""
    return TransformStamped(Header(told.exposed_ns, told.frame_id), told.robot, told.pose)


def camera_transform(report: "pb.FrameReport", camera: str) -> TransformStamped | None:
    """The camera in the world, as this frame has it: where the rig follows it, else None; `rig_transforms` has it then.

    Raises InputError for a pose that is none.
    """
    if not report.HasField("camera"):
        return None
    return TransformStamped(Header(report.exposed_ns, report.frame_id), camera, report_pose(report.camera.pose))


def rig_transforms(rig: Rig, stamp_ns: int) -> TFMessage:
    """What never moves: the camera in the world, unless it is followed; the points in the frame of who carries them."""
    told = []
    if rig.T_world_camera is not None and not rig.follows_world:
        told.append(TransformStamped(Header(stamp_ns, rig.parent_frame), rig.camera.name, rig.T_world_camera))
    for robot in rig.robots:
        for name, point in robot.points.items():
            place = Pose(point, Pose.identity().orientation)
            told.append(TransformStamped(Header(stamp_ns, robot.id), f"{robot.id}/{name}", place))
    return TFMessage(tuple(told))


def diagnostics(status: "pb.Status", camera: str) -> DiagnosticArray:
    """The server's health: ERROR where no frame came in the last second, WARN where there is a problem, else OK."""
    level = ERROR if status.rate_hz == 0 else WARN if status.problem else OK
    message = status.problem or (f"{status.rate_hz:.3g} frames a second" if status.rate_hz else "no frames")
    values = (
        ("source", status.source),
        *((name, str(getattr(status, name))) for name in _COUNTS),
        *((name, f"{getattr(status, name):.6g}") for name in _MEASURES),
        *_of_map("robots", status.robots.items()),
        *_of_map("rejected", status.rejected.items()),
    )
    told = DiagnosticStatus(level, f"asterism: {camera}", message, camera, values)
    return DiagnosticArray(Header(status.time_ns, ""), (told,))


_COUNTS = ("frames", "frames_dropped", "frames_unreadable", "frames_not_recorded", "messages_not_recorded")
_MEASURES = ("rate_hz", "solve_p50_s", "solve_p99_s", "latency_p50_s", "latency_p99_s")


def _of_map(name: str, pairs: Iterable[tuple[str, int]]) -> list[tuple[str, str]]:
    return [(f"{name} {key}", str(count)) for key, count in sorted(pairs)]


def _three(vector: Floats) -> tuple[float, float, float]:
    x, y, z = vector.tolist()
    return x, y, z


def _flat(matrix: Floats) -> tuple[float, ...]:
    return tuple(matrix.ravel().tolist())
