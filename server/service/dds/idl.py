"""ROS 2's types as DDS's discovery tells them: both ends compare them, by the names of fields too, where both tell any.

Only that: no message is made of them.
"""

from typing import Any

from cyclonedds.idl import IdlStruct, make_idl_struct
from cyclonedds.idl.types import array, float64, int32, sequence, uint8, uint32

from asterism.protocol.ros2 import types
from asterism.protocol.ros2.types import RosType


def _struct(package: str, name: str, /, **fields: Any) -> type[IdlStruct]:
    """A struct as rosidl makes it of a .msg: final, its fields in their order."""
    made: type[IdlStruct] = make_idl_struct(f"{name}_", f"{package}::msg::dds_::{name}_", fields)
    return made


_TIME = _struct("builtin_interfaces", "Time", sec=int32, nanosec=uint32)
_HEADER = _struct("std_msgs", "Header", stamp=_TIME, frame_id=str)
_POINT = _struct("geometry_msgs", "Point", x=float64, y=float64, z=float64)
_VECTOR = _struct("geometry_msgs", "Vector3", x=float64, y=float64, z=float64)
_QUATERNION = _struct("geometry_msgs", "Quaternion", x=float64, y=float64, z=float64, w=float64)
_POSE = _struct("geometry_msgs", "Pose", position=_POINT, orientation=_QUATERNION)
_POSE_MEANT = _struct("geometry_msgs", "PoseWithCovariance", pose=_POSE, covariance=array[float64, 36])
_TWIST = _struct("geometry_msgs", "Twist", linear=_VECTOR, angular=_VECTOR)
_TWIST_MEANT = _struct("geometry_msgs", "TwistWithCovariance", twist=_TWIST, covariance=array[float64, 36])
_TRANSFORM = _struct("geometry_msgs", "Transform", translation=_VECTOR, rotation=_QUATERNION)
_STAMPED = _struct("geometry_msgs", "TransformStamped", header=_HEADER, child_frame_id=str, transform=_TRANSFORM)
_PAIR = _struct("diagnostic_msgs", "KeyValue", key=str, value=str)
# Its level is a `byte` in the .msg, of which both of ROS's own middlewares tell uint8.
_STATUS = _struct(
    "diagnostic_msgs", "DiagnosticStatus", level=uint8, name=str, message=str, hardware_id=str, values=sequence[_PAIR]
)


def _of(kind: RosType, /, **fields: Any) -> type[IdlStruct]:
    return _struct(kind.package, kind.name, **fields)


TYPES = {
    types.ODOMETRY: _of(types.ODOMETRY, header=_HEADER, child_frame_id=str, pose=_POSE_MEANT, twist=_TWIST_MEANT),
    types.POSE_WITH_COVARIANCE_STAMPED: _of(types.POSE_WITH_COVARIANCE_STAMPED, header=_HEADER, pose=_POSE_MEANT),
    types.TF_MESSAGE: _of(types.TF_MESSAGE, transforms=sequence[_STAMPED]),
    types.DIAGNOSTIC_ARRAY: _of(types.DIAGNOSTIC_ARRAY, header=_HEADER, status=sequence[_STATUS]),
}
