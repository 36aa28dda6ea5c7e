"""What programs that draw get beside the published messages: calibration, transforms, annotations.

Recordings hold them, and live views are told them.
"""

import numpy as np

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.annotations import encode_annotations
from asterism.protocol.codec import encode_calibration, encode_transforms, report_pose
from asterism.protocol.geometry import Pose
from asterism.protocol.messages import ANNOTATIONS, CALIBRATION, TRANSFORMS, Message
from asterism.protocol.rig import Rig

_UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])


def first_messages(rig: Rig, time_ns: int = 0) -> list[Message]:
    """What every poses file begins with: the calibration, and where the camera stands."""
    name, times = rig.camera.name, (time_ns, time_ns, 0)
    first = [Message(keys.calibration(name), CALIBRATION, encode_calibration(time_ns, rig.camera), *times)]
    if rig.T_world_camera is not None:
        payload = encode_transforms(time_ns, [("world", name, rig.T_world_camera)])
        first.append(Message(keys.TRANSFORMS, TRANSFORMS, payload, *times))
    return first


class Viewers:
    """Makes the transforms and annotations of the frame reports of one rig."""

    def __init__(self, rig: Rig) -> None:
        self._camera = rig.camera.name
        self._annotations = keys.annotations(rig.camera.name)
        self._points = {
            robot.id: [(robot.id, f"{robot.id}/{name}", Pose(point, _UPRIGHT)) for name, point in robot.points.items()]
            for robot in rig.robots
        }

    def messages(self, message: Message, report: "pb.FrameReport") -> list[Message]:
        """Of a frame report, which ``message`` carried."""
        transforms: list[tuple[str, str, Pose]] = []
        if report.HasField("camera"):
            transforms.append((report.frame_id, self._camera, report_pose(report.camera.pose)))
        for robot in report.robots:
            if robot.HasField("pose"):
                transforms.append((report.frame_id, robot.id, report_pose(robot.pose)))
                transforms += self._points.get(robot.id, ())
        times = (message.log_ns, message.publish_ns, message.sequence)
        annotations = encode_annotations(message.log_ns, report)
        return [
            Message(keys.TRANSFORMS, TRANSFORMS, encode_transforms(message.log_ns, transforms), *times),
            Message(self._annotations, ANNOTATIONS, annotations, *times),
        ]
