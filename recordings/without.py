"""The pose that light alone gives, beside the one that rests on the surface as well."""

import rerun as rr

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import report_pose
from asterism.protocol.geometry import Floats

_FAINT = ((200, 130, 130, 130), (130, 190, 130, 130), (140, 160, 210, 130))  # axes x, y, z
_AXIS = 1.0  # of a robot's extent: a little longer than those of the pose that is told


def axes_without(robot: "pb.RobotReport", extent: float) -> rr.LineStrips3D:
    """Its axes, fainter than those of the pose that is told."""
    place = report_pose(robot.surface.without)
    ends: Floats = place.position + _AXIS * extent * place.rotation.T
    return rr.LineStrips3D(
        [[place.position, end] for end in ends],
        colors=_FAINT,
        radii=rr.Radius.ui_points(0.7),
        labels=[f"{robot.id} by light alone: {1e3 * robot.surface.off_m:+.3f} mm from the surface"] * 3,
        show_labels=False,
    )
