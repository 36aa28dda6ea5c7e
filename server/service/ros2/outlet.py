"""Poses, transforms and health for nodes of ROS 2.

`<ns>/<robot>/pose` and `<ns>/<robot>/odom` of every robot of the rig, `/tf`, `/tf_static`, `/diagnostics`. What is told
of a frame goes out from a thread of its own, at once; decoding and encoding it would take the chain some 0.1 ms.
"""

import threading
from typing import NamedTuple, Protocol

from asterism.protocol.codec import decode_frame_report, decode_odometry, decode_status
from asterism.protocol.messages import FRAME_REPORT, ODOMETRY, STATUS, Message, RobotPose
from asterism.protocol.rig import Rig
from asterism.protocol.ros2 import conversion, names, types
from asterism.protocol.ros2.values import RosMessage, TFMessage
from asterism.protocol.ros2.wire import Quality
from asterism.server.chain.frame import Frame
from asterism.server.service.publish import Clock
from asterism.server.service.say import complain, say
from asterism.server.service.threads import Newest

_WAITING = 8  # frames that are not told yet; then the oldest goes
_TF = Quality(depth=100)  # as tf2's own broadcasters have it
_TF_STATIC = Quality(depth=1, transient_local=True)


class RosPublisher(Protocol):
    """Publishes the messages of one topic: `protocol.ros2.node.RosPublisher`, or DDS's."""

    def put(self, message: RosMessage) -> None:
        """Publish a message."""

    def close(self) -> None:
        """Take the topic back."""


class RosNode(Protocol):
    """Who publishes: `protocol.ros2.node.Node`, or DDS's."""

    def publisher(self, topic: str, kind: types.RosType, quality: Quality, newest_only: bool = False) -> RosPublisher:
        """Publish on a topic."""

    def close(self) -> None:
        """Be seen no longer."""


class _Robot(NamedTuple):
    pose: RosPublisher
    odom: RosPublisher

    def close(self) -> None:
        self.pose.close()
        self.odom.close()


class Ros2:
    """An outlet, by a node among those at ``place``, which is closed with it; ``clock`` stamps what never moves, and
    sentences begin with what it is ``called``.
    """

    def __init__(self, node: RosNode, rig: Rig, place: names.RosPlace, clock: Clock, called: str = "ROS 2") -> None:
        self._node, self._rig, self.place, self._clock, self._called = node, rig, place, clock, called
        self._robots = {robot.id: self._publishers_of(robot.id) for robot in rig.robots}
        self._tf = self._node.publisher(names.TF, types.TF_MESSAGE, _TF, newest_only=True)
        self._tf_static = self._node.publisher(names.TF_STATIC, types.TF_MESSAGE, _TF_STATIC)
        self._diagnostics = self._node.publisher(names.DIAGNOSTICS, types.DIAGNOSTIC_ARRAY, Quality())
        self._lock = threading.Lock()  # of all but the node and what is told of the health
        self._telling = Newest(self._tell_frame, "ros2", waiting=_WAITING)
        self._tell_what_never_moves()

    def write(self, messages: list[Message], frame: Frame) -> None:  # noqa: ARG002
        """Poses of the robots that were located; those that were not have no transform of this frame."""
        self._telling.give(messages)

    def between(self, messages: list[Message]) -> None:
        """The server's health."""
        for message in messages:
            if message.kind is STATUS:
                told = decode_status(message.payload)
                self._diagnostics.put(conversion.diagnostics(told, self._rig.camera.name))

    def take_rig(self, rig: Rig) -> None:
        """Another rig is in force for the frames from now on: its robots have topics, those that it lacks have none."""
        with self._lock:
            self._rig = rig
            wanted = [robot.id for robot in rig.robots]
            for robot in self._robots.keys() - set(wanted):
                self._robots.pop(robot).close()
            for robot in wanted:
                if robot not in self._robots and (problem := names.part_problem(robot)):
                    complain(
                        f"{self._called}: the robot's id {robot!r} {problem}; it has no topics there, only a transform"
                    )
                elif robot not in self._robots:
                    self._robots[robot] = self._publishers_of(robot)
            self._tell_what_never_moves()

    def close(self) -> None:
        """Nothing more comes."""
        self._telling.close(rest=True)
        if self._telling.dropped:
            say(f"{self._called}: {self._telling.dropped} frames were not told, it did not keep up")
        for robot in self._robots.values():
            robot.close()
        for publisher in (self._tf, self._tf_static, self._diagnostics):
            publisher.close()
        self._node.close()

    def _tell_frame(self, messages: list[Message]) -> None:
        with self._lock:
            poses = [decode_odometry(message.payload) for message in messages if message.kind is ODOMETRY]
            transforms = [conversion.robot_transform(told) for told in poses]
            if self._rig.follows_world:
                reports = (decode_frame_report(message.payload) for message in messages if message.kind is FRAME_REPORT)
                found = (conversion.camera_transform(report, self._rig.camera.name) for report in reports)
                transforms += [camera for camera in found if camera is not None]
            if transforms:
                self._tf.put(TFMessage(tuple(transforms)))
            for told in poses:
                self._tell(told)

    def _tell(self, told: RobotPose) -> None:
        robot = self._robots.get(told.robot)
        if robot is None:
            return
        robot.pose.put(conversion.pose_with_covariance(told))
        robot.odom.put(conversion.odometry(told))

    def _tell_what_never_moves(self) -> None:
        self._tf_static.put(conversion.rig_transforms(self._rig, self._clock.now_ns()))

    def _publishers_of(self, robot: str) -> _Robot:
        def publisher(topic: str, kind: types.RosType) -> RosPublisher:
            return self._node.publisher(topic, kind, Quality(), newest_only=True)

        return _Robot(
            publisher(names.pose_topic(self.place.namespace, robot), types.POSE_WITH_COVARIANCE_STAMPED),
            publisher(names.odom_topic(self.place.namespace, robot), types.ODOMETRY),
        )
