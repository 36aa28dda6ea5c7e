"""What runs on robots and desks. Imports neither OpenCV, scipy, numba nor rerun."""

from asterism.clients.client import PoseClient
from asterism.clients.link_state import Link, LinkState
from asterism.clients.named_points import NamedPoint
from asterism.clients.prediction import PredictedPose
from asterism.clients.received_pose import ReceivedPose
from asterism.clients.robot_event import RobotEvent
from asterism.clients.robot_feed import AllRobots, RobotFeed

__all__ = [
    "AllRobots",
    "Link",
    "LinkState",
    "NamedPoint",
    "PoseClient",
    "PredictedPose",
    "ReceivedPose",
    "RobotEvent",
    "RobotFeed",
]
