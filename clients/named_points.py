"""Named points that a robot carries, such as a tool: where they are, and how sure that is."""

from dataclasses import dataclass

import numpy as np

from asterism.protocol.geometry import Floats, Pose


@dataclass(frozen=True, slots=True, eq=False)
class NamedPoint:
    """``position`` (3,) m in the frame of the robot's pose, ``covariance`` (3, 3) m^2."""

    name: str
    position: Floats
    covariance: Floats


def carried(name: str, lever: Floats, pose: Pose, covariance: Floats) -> NamedPoint:
    """The point at ``lever`` (3,) m of the robot's frame, for a pose with its covariance (6, 6).

    A small turn w of the robot about the parent's axes moves it by w x (R lever). How far off the rig has the point is
    not in it.
    """
    x, y, z = pose.rotation @ lever
    turned = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])  # w -> w x arm
    jacobian = np.hstack([np.eye(3), turned])
    return NamedPoint(name, pose.map(lever), jacobian @ covariance @ jacobian.T)
