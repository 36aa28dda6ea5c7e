"""CDR byte for byte as rosbags writes it, whatever length of a name moves what stands behind it."""

import numpy as np
import pytest

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Pose
from asterism.protocol.ros2 import types
from asterism.protocol.ros2.cdr import encode
from asterism.protocol.ros2.values import (
    DiagnosticArray,
    DiagnosticStatus,
    Header,
    Odometry,
    PoseWithCovarianceStamped,
    RosMessage,
    TFMessage,
    TransformStamped,
)
from tests.protocol.ros2.ros_store import STORE, in_bytes, in_ros

LENGTHS = range(9)  # of a name: every place that 8 bytes can have
TYPES = [told for told in vars(types).values() if isinstance(told, types.RosType)]


def same_bytes(message: RosMessage) -> None:
    """What was written is read by rosbags, to the end, and written again byte for byte."""
    payload = encode(message)
    read = in_ros(payload, message.TYPE.ros)
    again = in_bytes(read)
    assert again == payload


def some_pose(rng: np.random.Generator) -> Pose:
    return Pose(rng.normal(size=3), rng.normal(size=4))


def some_numbers(rng: np.random.Generator, count: int) -> tuple[float, ...]:
    return tuple(rng.normal(size=count).tolist())


@pytest.mark.parametrize("told", TYPES, ids=lambda told: told.name)
def test_hashes_are_those_of_the_definitions(told: types.RosType) -> None:
    assert STORE.hash_rihs01(told.ros) == told.hash


@pytest.mark.parametrize("length", LENGTHS)
def test_a_pose(rng: np.random.Generator, length: int) -> None:
    message = PoseWithCovarianceStamped(
        Header(1_795_398_896_123_456_789, "w" * length), some_pose(rng), some_numbers(rng, 36)
    )
    same_bytes(message)
    read = in_ros(encode(message), message.TYPE.ros)
    assert (read.header.stamp.sec, read.header.stamp.nanosec) == (1_795_398_896, 123_456_789)
    assert read.header.frame_id == "w" * length
    q = read.pose.pose.orientation
    assert (q.x, q.y, q.z, q.w) == tuple(message.pose.orientation)
    np.testing.assert_array_equal(read.pose.covariance, message.covariance)


@pytest.mark.parametrize("length", LENGTHS)
@pytest.mark.parametrize("child", LENGTHS)
def test_odometry(rng: np.random.Generator, length: int, child: int) -> None:
    numbers = some_numbers(rng, 78)
    message = Odometry(
        Header(7, "w" * length),
        "c" * child,
        some_pose(rng),
        numbers[:36],
        (numbers[36], numbers[37], numbers[38]),
        (numbers[39], numbers[40], numbers[41]),
        numbers[42:],
    )
    same_bytes(message)
    read = in_ros(encode(message), message.TYPE.ros)
    assert (read.header.frame_id, read.child_frame_id) == ("w" * length, "c" * child)
    assert (read.twist.twist.linear.y, read.twist.twist.angular.z) == (message.linear[1], message.angular[2])
    np.testing.assert_array_equal(read.twist.covariance, message.twist_covariance)


@pytest.mark.parametrize("length", LENGTHS)
def test_transforms(rng: np.random.Generator, length: int) -> None:
    for count in range(4):
        message = TFMessage(
            tuple(TransformStamped(Header(k * 10**9 + k, "w" * length), "ab" * k, some_pose(rng)) for k in range(count))
        )
        same_bytes(message)
        read = in_ros(encode(message), message.TYPE.ros).transforms
        assert [told.child_frame_id for told in read] == ["ab" * k for k in range(count)]
        assert [told.transform.translation.z for told in read] == [told.pose.position[2] for told in message.transforms]


@pytest.mark.parametrize("length", LENGTHS)
def test_diagnostics(length: int) -> None:
    values = tuple(("k" * k, "v" * length) for k in range(length))
    status = DiagnosticStatus(1, "n" * length, "größer als 1 µs", "", values)
    for count in range(3):
        message = DiagnosticArray(Header(5, ""), (status,) * count)
        same_bytes(message)
        read = in_ros(encode(message), message.TYPE.ros).status
        assert [told.message for told in read] == ["größer als 1 µs"] * count
        assert all([(pair.key, pair.value) for pair in told.values] == list(values) for told in read)


@pytest.mark.parametrize("stamp_ns", [-1, 2**31 * 10**9])
def test_a_time_that_ros_has_none_for(stamp_ns: int) -> None:
    with pytest.raises(InputError, match="from 1970 to 2038"):
        encode(DiagnosticArray(Header(stamp_ns, ""), ()))
