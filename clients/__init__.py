"""What runs on robots and desks. Imports neither OpenCV, scipy, numba nor rerun."""

from asterism.clients.client import PoseClient, ReceivedPose, RobotFeed

__all__ = ["PoseClient", "ReceivedPose", "RobotFeed"]
