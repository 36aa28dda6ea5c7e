"""Writes messages into a ROS 2 bag by rosbags, and those of cameras as ROS has them."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.camera import Camera
from asterism.protocol.ros2.names import TF_STATIC
from asterism.protocol.ros2.types import RosType

if TYPE_CHECKING:
    from rosbags.interfaces import Connection, Qos
    from rosbags.typesys.store import Typestore

VERSION = 9  # of rosbag2's metadata: Iron and later; earlier ROS reads the MCAP file itself
SECOND_NS = 1_000_000_000


class BagWriter:
    """A bag <folder>/<name>.mcap with <folder>/metadata.yaml, whole when the block ends without an error."""

    def __init__(self, folder: Path, name: str) -> None:
        from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore

        self.store: Typestore = get_typestore(Stores.ROS2_JAZZY)
        self._folder = folder
        # rosbags names the file after the folder that it makes; its files are moved up when they are whole.
        self._made = folder / ".bag" / name
        self._writer = Writer(self._made, version=VERSION, storage_plugin=StoragePlugin.MCAP)
        self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        self._topics: dict[str, Connection] = {}

    def __enter__(self) -> BagWriter:
        self._writer.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._writer.__exit__(kind, error, traceback)
        if kind is None:
            for file in self._made.iterdir():
                file.rename(self._folder / file.name)
            self._made.rmdir()
            self._made.parent.rmdir()

    def put(self, topic: str, of: RosType, time_ns: int, payload: bytes | memoryview) -> None:
        """Append a message, CDR, logged at ``time_ns``. Raises OSError where the disk does not take it."""
        if topic not in self._topics:
            definition, _ = self.store.generate_msgdef(of.ros, ros_version=2)
            self._topics[topic] = self._writer.add_connection(
                topic, of.ros, msgdef=definition, rihs01=of.hash, offered_qos_profiles=_qos(topic)
            )
        self._writer.write(self._topics[topic], time_ns, payload)


def image_message(store: Typestore, time_ns: int, frame_id: str, pixels: NDArray[np.uint8]) -> memoryview:
    """sensor_msgs/Image, mono8, of an (h, w) image."""
    height, width = pixels.shape
    made = store.types["sensor_msgs/msg/Image"]
    message = made(_header(store, time_ns, frame_id), height, width, "mono8", 0, width, pixels.reshape(-1))
    data: memoryview = store.serialize_cdr(message, made.__msgtype__)
    return data


def camera_info(store: Typestore, time_ns: int, camera: Camera) -> memoryview:
    """sensor_msgs/CameraInfo of images as they come, not rectified: R is the identity, P is K."""
    made, region = store.types["sensor_msgs/msg/CameraInfo"], store.types["sensor_msgs/msg/RegionOfInterest"]
    message = made(
        header=_header(store, time_ns, camera.name),
        height=camera.height,
        width=camera.width,
        distortion_model=camera.model,
        d=camera.distortion,
        k=camera.matrix.ravel(),
        r=np.eye(3).ravel(),
        p=np.column_stack([camera.matrix, np.zeros(3)]).ravel(),
        binning_x=0,
        binning_y=0,
        roi=region(0, 0, 0, 0, False),
    )
    data: memoryview = store.serialize_cdr(message, made.__msgtype__)
    return data


def _header(store: Typestore, time_ns: int, frame_id: str) -> Any:
    stamp = store.types["builtin_interfaces/msg/Time"](*divmod(time_ns, SECOND_NS))
    return store.types["std_msgs/msg/Header"](stamp, frame_id)


def _qos(topic: str) -> list[Qos]:
    """Static transforms are for those too who come later; all else is as ROS has it by default."""
    if topic != TF_STATIC:
        return []
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    ever = QosTime(0, 0)
    return [
        Qos(
            QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL, ever, ever,
            QosLiveliness.AUTOMATIC, ever, False,
        )
    ]  # fmt: skip
