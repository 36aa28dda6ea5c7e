"""ROS 2 bags: a folder with one MCAP file and its metadata.yaml, as rosbag2 records them.

Needs rosbags, which the extra `ros` brings.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.messages import RobotPose
from asterism.protocol.rig import Rig
from asterism.protocol.ros2 import cdr, conversion, names
from asterism.protocol.ros2.types import CAMERA_INFO, IMAGE
from asterism.protocol.ros2.values import Header, RosMessage, TFMessage, TransformStamped
from asterism.recordings.export.bag_names import RosNames
from asterism.recordings.export.bag_writer import BagWriter, camera_info, image_message
from asterism.recordings.export.frames import ExportedFrame, ExportedRobot
from asterism.recordings.export.written import Written

if TYPE_CHECKING:
    Images = Iterator[tuple[NDArray[np.uint8], int, int]]  # (h, w), mid-exposure ns, number


def write_bag(
    frames: Iterable[ExportedFrame], folder: Path, name: str, rigs: Sequence[tuple[int, Rig]], images: Images | None
) -> Written:
    """Write the bag <folder>/<name>.mcap with <folder>/metadata.yaml: of every located robot ``/<robot>/pose`` and
    ``/<robot>/odom``, ``/tf``, ``/tf_static``, and with ``images`` ``/<camera>/image_raw`` and ``camera_info``.

    ``rigs`` are those that were in force, each with the number of the first frame it holds for. Messages are stamped
    and logged at mid-exposure. Raises ModuleNotFoundError without rosbags, InputError for names that ROS cannot tell
    apart and times before 1970 or after 2038, OSError where the disk does not take it.
    """
    written = Written()
    ids = [robot.id for _, rig in rigs for robot in rig.robots]
    with BagWriter(folder, name) as writer:
        bag = _Bag(writer, RosNames(ids), rigs, images)
        for frame in written.counted(frames):
            bag.frame(frame)
        bag.images_until(None)
    written.files, written.renamed = [f"{name}.mcap"], bag.names.renamed
    return written


class _Bag:
    """Puts frame after frame into a bag."""

    def __init__(
        self, writer: BagWriter, ros_names: RosNames, rigs: Sequence[tuple[int, Rig]], images: Images | None
    ) -> None:
        self._writer = writer
        self.names = ros_names
        self._coming = list(rigs)
        self._rig = rigs[0][1]
        self._images = images if images is not None else iter(())
        self._image = next(self._images, None)

    def frame(self, frame: ExportedFrame) -> None:
        """What it tells, behind its image."""
        while self._coming and frame.sequence >= self._coming[0][0]:
            self._rig = self._coming.pop(0)[1]
            still = conversion.rig_transforms(self._rig, frame.exposed_ns)
            if still.transforms:
                self._put(names.TF_STATIC, still, frame.exposed_ns)
        self.images_until(frame.sequence)
        transforms = []
        if frame.T_world_camera is not None:
            header = Header(frame.exposed_ns, frame.frame_id)
            transforms.append(TransformStamped(header, self._rig.camera.name, frame.T_world_camera))
        for told in filter(None, (_told(frame, robot) for robot in frame.robots)):
            topic = self.names.of(told.robot)
            self._put(names.pose_topic("", topic), conversion.pose_with_covariance(told), frame.exposed_ns)
            self._put(names.odom_topic("", topic), conversion.odometry(told), frame.exposed_ns)
            transforms.append(conversion.robot_transform(told))
        if transforms:
            self._put(names.TF, TFMessage(tuple(transforms)), frame.exposed_ns)

    def images_until(self, sequence: int | None) -> None:
        """The images up to that number; None: all that are left."""
        while self._image is not None and (sequence is None or self._image[2] <= sequence):
            pixels, time_ns, _ = self._image
            camera, store = self._rig.camera, self._writer.store
            topic = f"/{self.names.of(camera.name)}"
            info = camera_info(store, time_ns, camera)
            self._writer.put(f"{topic}/image_raw", IMAGE, time_ns, image_message(store, time_ns, camera.name, pixels))
            self._writer.put(f"{topic}/camera_info", CAMERA_INFO, time_ns, info)
            self._image = next(self._images, None)

    def _put(self, topic: str, message: RosMessage, time_ns: int) -> None:
        self._writer.put(topic, message.TYPE, time_ns, cdr.encode(message))


def _told(frame: ExportedFrame, robot: ExportedRobot) -> RobotPose | None:
    """The robot as its odometry message told it; None where it was not located."""
    pose = robot.pose
    if pose is None or robot.covariance is None:
        return None
    return RobotPose(
        robot=robot.id,
        frame_id=frame.frame_id,
        pose=pose,
        covariance=np.array(robot.covariance).reshape(6, 6),
        state=robot.state,
        leds=robot.leds or 0,
        rms_px=robot.rms_px or 0.0,
        sequence=frame.sequence,
        exposed_ns=frame.exposed_ns,
        published_ns=0,
        session=frame.session,
        velocity=robot.velocity,
    )
