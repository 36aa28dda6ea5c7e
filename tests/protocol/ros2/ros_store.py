"""ROS's own definitions of its messages, as rosbags knows them."""

from typing import Any

from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)


def in_ros(payload: bytes, name: str) -> Any:
    """What ROS would read in the bytes."""
    return STORE.deserialize_cdr(payload, name)


def in_bytes(message: Any) -> bytes:
    """What ROS would write."""
    return bytes(STORE.serialize_cdr(message, message.__msgtype__))
