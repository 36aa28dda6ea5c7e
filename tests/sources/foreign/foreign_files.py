"""Files of other programs, made by their own writers: `mcap` and `rosbags`, which know nothing of Asterism."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore

Messages = Sequence[tuple[str, int, Any]]  # topic, when written, ns, and the message

ROS2 = get_typestore(Stores.ROS2_HUMBLE)
ROS1 = get_typestore(Stores.ROS1_NOETIC)


def raw(image: NDArray[Any], stamp_ns: int, encoding: str = "mono8", pad: int = 0) -> RawImage:
    """A foxglove.RawImage, its rows padded by so many bytes."""
    rows = image.reshape(len(image), -1).view(np.uint8)
    rows = np.pad(rows, ((0, 0), (0, pad)), constant_values=255)
    message = RawImage(width=image.shape[1], height=len(image), step=rows.shape[1], encoding=encoding)
    message.timestamp.FromNanoseconds(stamp_ns)
    message.data = rows.tobytes()
    return message


def compressed(data: bytes, stamp_ns: int, kind: str = "png") -> CompressedImage:
    """A foxglove.CompressedImage."""
    message = CompressedImage(data=data, format=kind)
    message.timestamp.FromNanoseconds(stamp_ns)
    return message


def _header(store: Any, stamp_ns: int) -> Any:
    time = store.types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
    header = store.types["std_msgs/msg/Header"]
    return header(stamp=time, frame_id="cam") if store is ROS2 else header(seq=7, stamp=time, frame_id="cam")


def ros_image(image: NDArray[Any], stamp_ns: int, encoding: str = "mono8", store: Any = ROS2) -> Any:
    """A sensor_msgs/Image."""
    rows = image.reshape(len(image), -1).view(np.uint8)
    return store.types["sensor_msgs/msg/Image"](
        header=_header(store, stamp_ns),
        height=len(image),
        width=image.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=rows.shape[1],
        data=rows.ravel(),
    )


def ros_compressed(data: bytes, stamp_ns: int, kind: str = "jpeg", store: Any = ROS2) -> Any:
    """A sensor_msgs/CompressedImage."""
    return store.types["sensor_msgs/msg/CompressedImage"](
        header=_header(store, stamp_ns), format=kind, data=np.frombuffer(data, np.uint8)
    )


def ros_text(text: str, store: Any = ROS2) -> Any:
    """A std_msgs/String."""
    return store.types["std_msgs/msg/String"](data=text)


def camera_info(matrix: Sequence[float], distortion: Sequence[float], size: tuple[int, int], **more: Any) -> Any:
    """A sensor_msgs/CameraInfo; ``more``: model, binning, region."""
    roi = ROS2.types["sensor_msgs/msg/RegionOfInterest"]
    x, y, width, height = more.get("region", (0, 0, 0, 0))
    binning = more.get("binning", (0, 0))
    return ROS2.types["sensor_msgs/msg/CameraInfo"](
        header=_header(ROS2, 1),
        height=size[1],
        width=size[0],
        distortion_model=more.get("model", "plumb_bob"),
        d=np.array(distortion, np.float64),
        k=np.array(matrix, np.float64),
        r=np.eye(3).ravel(),
        p=np.zeros(12),
        binning_x=binning[0],
        binning_y=binning[1],
        roi=roi(x_offset=x, y_offset=y, height=height, width=width, do_rectify=False),
    )


def write_mcap(path: Path, messages: Messages, **options: Any) -> Path:
    """One MCAP file by `mcap`'s writer: protobuf for Foxglove's messages, CDR for ROS'."""
    with path.open("wb") as stream:
        writer = Writer(stream, **{"compression": CompressionType.ZSTD, **options})
        writer.start()
        channels: dict[str, int] = {}
        for topic, log_ns, message in messages:
            if topic not in channels:
                channels[topic] = _channel(writer, topic, message)
            if hasattr(message, "SerializeToString"):
                data = message.SerializeToString()
            else:
                data = bytes(ROS2.serialize_cdr(message, message.__msgtype__))
            writer.add_message(channels[topic], log_ns, data, log_ns)
        writer.finish()
    return path


def _channel(writer: Writer, topic: str, message: Any) -> int:
    if hasattr(message, "SerializeToString"):
        files = FileDescriptorSet()
        message.DESCRIPTOR.file.CopyToProto(files.file.add())
        schema = writer.register_schema(message.DESCRIPTOR.full_name, "protobuf", files.SerializeToString())
        return writer.register_channel(topic, "protobuf", schema)
    text, _ = ROS2.generate_msgdef(message.__msgtype__, ros_version=2)
    return writer.register_channel(topic, "cdr", writer.register_schema(message.__msgtype__, "ros2msg", text.encode()))


def write_bag2(path: Path, messages: Messages, storage: str = "sqlite3", packed: str | None = None) -> Path:
    """A rosbag2 folder by `rosbags`' writer; ``packed``: `message` or `file`."""
    bag = rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin[storage.upper()])
    if packed is not None:
        bag.set_compression(rosbag2.CompressionMode[packed.upper()], rosbag2.CompressionFormat.ZSTD)
    with bag:
        connections: dict[str, Any] = {}
        for topic, written_ns, message in messages:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=ROS2)
            bag.write(connections[topic], written_ns, ROS2.serialize_cdr(message, kind))
    return path


def write_bag1(path: Path, messages: Messages, packed: str | None = None) -> Path:
    """A ROS 1 bag by `rosbags`' writer; ``packed``: `bz2` or `lz4`."""
    bag = rosbag1.Writer(path)
    if packed is not None:
        bag.set_compression(rosbag1.Writer.CompressionFormat[packed.upper()])
    with bag:
        connections: dict[str, Any] = {}
        for topic, written_ns, message in messages:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=ROS1)
            bag.write(connections[topic], written_ns, ROS1.serialize_ros1(message, kind))
    return path
