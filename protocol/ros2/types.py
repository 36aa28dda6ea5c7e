"""Types of ROS 2's messages: their names, and the hashes that its nodes know them by.

A hash is RIHS01 of REP 2016: SHA-256 of the type's description. Those of these types are the same in every release.
"""

from typing import NamedTuple


class RosType(NamedTuple):
    """``package`` and ``name`` as in ``nav_msgs/msg/Odometry``; ``sha256`` of its description."""

    package: str
    name: str
    sha256: str

    @property
    def ros(self) -> str:
        """As ROS's tools and bags name it: ``nav_msgs/msg/Odometry``."""
        return f"{self.package}/msg/{self.name}"

    @property
    def dds(self) -> str:
        """As it is named on the wire, of DDS and of zenoh: ``nav_msgs::msg::dds_::Odometry_``."""
        return f"{self.package}::msg::dds_::{self.name}_"

    @property
    def hash(self) -> str:
        """``RIHS01_`` and the SHA-256."""
        return f"RIHS01_{self.sha256}"


ODOMETRY = RosType("nav_msgs", "Odometry", "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0")
POSE_WITH_COVARIANCE_STAMPED = RosType(
    "geometry_msgs", "PoseWithCovarianceStamped", "26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e"
)
TF_MESSAGE = RosType("tf2_msgs", "TFMessage", "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087")
DIAGNOSTIC_ARRAY = RosType(
    "diagnostic_msgs", "DiagnosticArray", "5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e"
)
IMAGE = RosType("sensor_msgs", "Image", "d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47")
COMPRESSED_IMAGE = RosType(
    "sensor_msgs", "CompressedImage", "15640771531571185e2efc8a100baf923961a4d15d5569652e6cb6691e8e371a"
)
CAMERA_INFO = RosType("sensor_msgs", "CameraInfo", "b3dfd68ff46c9d56c80fd3bd4ed22c7a4ddce8c8348f2f59c299e73118e7e275")
