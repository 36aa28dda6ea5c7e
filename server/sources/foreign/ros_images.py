"""Images on a topic of ROS 2, from nodes with rmw_zenoh, and the calibration that their driver tells beside them."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from asterism.protocol.errors import InputError
from asterism.protocol.rig import Rig
from asterism.protocol.ros2 import names, types
from asterism.protocol.ros2.node import Node, RosSubscriber
from asterism.protocol.ros2.wire import Quality
from asterism.protocol.yaml_file import describe
from asterism.server.sources.foreign.arriving import ArrivingImages
from asterism.server.sources.foreign.ros_messages import (
    BadMessage,
    CameraInfoTold,
    CompressedTold,
    RawTold,
    read_camera_info,
    read_compressed,
    read_image,
)
from asterism.server.sources.source import Say

if TYPE_CHECKING:
    import zenoh

ROS_SCHEME = "ros2:"
_COMPRESSED = "/compressed"  # ends the topic of compressed images, by ROS's image_transport
_SENSOR = Quality(depth=5, best_effort=True)  # taken from publishers of any quality
_MOST_INFO_BYTES = 10_000

Compare = Callable[[CameraInfoTold], str | None]


def is_ros(text: str) -> bool:
    """Whether a source is a topic of ROS 2."""
    return text.startswith(ROS_SCHEME)


class RosImages(ArrivingImages):
    """Images on a topic: sensor_msgs/Image or CompressedImage, whichever it has.

    ``compare`` says what is to be said of a calibration on the topic `camera_info` beside, once for each that comes.
    """

    compare: Compare | None = None

    def __init__(self, topic: str, domain: int, rig: Rig | None, say: Say) -> None:
        """Raises InputError for what is no topic."""
        if problem := names.topic_problem(topic):
            raise InputError(f"{ROS_SCHEME}{describe(topic)} {problem}")
        super().__init__(f"{ROS_SCHEME}{topic}", rig, say)
        self._topic = names.clean_namespace(topic)
        self._place = names.RosPlace(domain, "")
        self._node_name = names.node_name("images" if rig is None else f"{rig.camera.name}_images")
        self._info = b""  # the newest calibration
        self._joined: list[RosSubscriber | Node] = []

    def join(self, session: "zenoh.Session", listens: bool) -> None:  # noqa: ARG002
        """Take what is published on the topic in that session; publishers are nodes with the same domain."""
        node = Node(session, self._place, self._node_name)
        expected = types.COMPRESSED_IMAGE if self._topic.endswith(_COMPRESSED) else types.IMAGE
        for kind in (types.IMAGE, types.COMPRESSED_IMAGE):
            take = self._taking(kind)
            self._joined.append(node.subscriber(self._topic, kind, _SENSOR, take, seen=kind is expected))
        self._joined.append(node.subscriber(info_topic(self._topic), types.CAMERA_INFO, _SENSOR, self._take_info))
        self._joined.append(node)
        # Nodes with another RMW are not heard, and those of another domain: without a word that is a long search.
        self._say(f"ROS 2, domain {self._place.domain}: images of {self._topic} from nodes with rmw_zenoh")

    def told(self, kind: str, payload: bytes) -> RawTold | CompressedTold:
        """What a message of that type says of its image. Raises BadMessage for one that is none."""
        return read_image(payload) if kind == types.IMAGE.ros else read_compressed(payload)

    def leave(self) -> None:
        """Take no more from the session."""
        while self._joined:
            self._joined.pop(0).close()

    def _taking(self, kind: types.RosType) -> "Callable[[zenoh.Sample], None]":
        return lambda sample: self.receive(kind.ros, sample)

    def _take_info(self, sample: "zenoh.Sample") -> None:
        """In zenoh's thread."""
        if self.compare is None or len(sample.payload) > _MOST_INFO_BYTES:
            return
        payload = sample.payload.to_bytes()
        told = calibration_in(payload)
        if told == self._info:
            return
        self._info = told
        where = f"{self.name}: {info_topic(self._topic)}"
        try:
            problem = self.compare(read_camera_info(payload))
        except (BadMessage, InputError) as error:
            problem = str(error)
        if problem:
            self._say(f"{where}: {problem}")


def info_topic(topic: str) -> str:
    """Where a driver tells the calibration of the images on a topic: `camera_info` beside it, by image_transport."""
    return f"{topic.removesuffix(_COMPRESSED).rpartition('/')[0]}/camera_info"


def calibration_in(payload: bytes) -> bytes:
    """What two messages have alike where they tell the same calibration: all behind the time."""
    return payload[12:]
