"""Messages of ROS 2 as plain values: what is written as CDR, into bags, or handed to DDS.

Frames and units are those of REP 103: m, rad, s; quaternions x y z w. Covariances are (36,) row-major of x, y, z,
rotation about the fixed axes x, y, z of the frame that is named.
"""

from dataclasses import dataclass
from typing import ClassVar

from asterism.protocol.geometry import Pose
from asterism.protocol.ros2 import types
from asterism.protocol.ros2.types import RosType


@dataclass(frozen=True, slots=True)
class Header:
    """std_msgs/Header: ns since the Unix epoch, and the frame that what follows is told in."""

    stamp_ns: int
    frame_id: str


@dataclass(frozen=True, slots=True)
class PoseWithCovarianceStamped:
    """geometry_msgs/PoseWithCovarianceStamped; ``covariance`` about the axes of the header's frame."""

    TYPE: ClassVar[RosType] = types.POSE_WITH_COVARIANCE_STAMPED
    header: Header
    pose: Pose
    covariance: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Odometry:
    """nav_msgs/Odometry. ``linear`` m/s, ``angular`` rad/s and their covariance are in the child's own frame."""

    TYPE: ClassVar[RosType] = types.ODOMETRY
    header: Header
    child_frame_id: str
    pose: Pose
    covariance: tuple[float, ...]
    linear: tuple[float, float, float]
    angular: tuple[float, float, float]
    twist_covariance: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class TransformStamped:
    """geometry_msgs/TransformStamped: ``pose`` maps points of the child frame into the header's."""

    header: Header
    child_frame_id: str
    pose: Pose


@dataclass(frozen=True, slots=True)
class TFMessage:
    """tf2_msgs/TFMessage."""

    TYPE: ClassVar[RosType] = types.TF_MESSAGE
    transforms: tuple[TransformStamped, ...]


@dataclass(frozen=True, slots=True)
class DiagnosticStatus:
    """diagnostic_msgs/DiagnosticStatus; ``level`` is one of `OK`, `WARN`, `ERROR`; ``values`` are keys with theirs."""

    level: int
    name: str
    message: str
    hardware_id: str
    values: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class DiagnosticArray:
    """diagnostic_msgs/DiagnosticArray."""

    TYPE: ClassVar[RosType] = types.DIAGNOSTIC_ARRAY
    header: Header
    status: tuple[DiagnosticStatus, ...]


OK, WARN, ERROR = 0, 1, 2  # levels of a DiagnosticStatus

RosMessage = PoseWithCovarianceStamped | Odometry | TFMessage | DiagnosticArray
