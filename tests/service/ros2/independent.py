"""sdk_node.py in a process of its own, and a server's outlet for it to listen to."""

import contextlib
import importlib.util
import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import encode_odometry, set_report_pose, to_bytes
from asterism.protocol.geometry import Pose
from asterism.protocol.messages import FRAME_REPORT, ODOMETRY, Message, RobotPose
from asterism.protocol.rig import Rig
from asterism.protocol.ros2.names import RosPlace
from asterism.protocol.ros2.types import RosType
from asterism.protocol.ros2.wire import owned_keys
from asterism.server.chain.frame import Frame
from asterism.server.service.on_air import OnAir, Place, on_air
from asterism.server.service.ros2.outlet import Ros2
from asterism.server.sources.session_clock import SessionClock
from tests.clients.serving import until
from tests.protocol.make_golden import RIG, SMOOTHED_POSE
from tests.protocol.ros2.ros_store import STORE
from tests.servers import TIMEOUT_S, free_endpoint

FIRST_NS = 10**18  # of frame 0
FRAME = Frame(np.zeros((4, 4), np.uint8), 0, 0)


def need_sdk() -> None:
    """Skip where the client that nobody here wrote is not installed."""
    if importlib.util.find_spec("zenoh_ros2_sdk") is None:
        pytest.skip("zenoh-ros2-sdk is not installed; pip install '.[dev]'")


@contextlib.contextmanager
def telling(place: RosPlace, rig: Rig = RIG, router: str | None = None) -> Iterator[tuple[str, Ros2, OnAir]]:
    """A server on the air that tells ROS, itself a router or a client of ``router``: its endpoint, its outlet."""
    endpoint = router or free_endpoint()
    ros_keys = tuple(owned_keys(place, (robot.id for robot in rig.robots)))
    where = Place(None if router else endpoint, router, None, ros_keys)
    with on_air(where, rig, SessionClock(), lambda: None) as air:
        outlet = Ros2(air.session, rig, place, air.publisher.clock)
        try:
            yield endpoint, outlet, air
        finally:
            outlet.close()


class SdkNode:
    """Subscribes to topics; ``late`` ones as transient-local."""

    def __init__(self, endpoint: str, domain: int, topics: dict[str, RosType], late: tuple[str, ...] = ()) -> None:
        asked = [
            (topic, kind.ros, kind.hash, STORE.generate_msgdef(kind.ros, ros_version=2)[0], topic in late)
            for topic, kind in topics.items()
        ]
        arguments = [endpoint.rpartition(":")[2], str(domain), json.dumps(asked)]
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.service.ros2.sdk_node", *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._process.stdout is not None
        assert self._process.stdout.readline().strip() == "ready"

    def counts(self) -> dict[str, int]:
        """How many messages it has of each topic."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write("how many?\n")
        self._process.stdin.flush()
        told: dict[str, int] = json.loads(self._process.stdout.readline())
        return told

    def finish(self) -> dict[str, Any]:
        """What it received and what it sees."""
        out, _ = self._process.communicate(timeout=TIMEOUT_S)
        told: dict[str, Any] = json.loads(out)
        return told


def wait_until_it_listens(node: SdkNode, outlet: Ros2, poses: list[RobotPose]) -> None:
    """Tell of the same frame until the node has it: what is told before its subscriptions are known does not come."""
    topics = ["/tf", *(f"{outlet.place.namespace}/{one.robot}/odom" for one in poses)]

    def has_it() -> bool:
        outlet.write(frame_of(poses), FRAME)
        return min(node.counts()[topic] for topic in topics) > 0

    until(has_it, TIMEOUT_S)


def pose(number: int, rng: np.random.Generator, robot: str = "alpha") -> RobotPose:
    """A smoothed pose of frame ``number``, with random numbers in it."""
    where = replace(SMOOTHED_POSE.pose, position=rng.normal(size=3), orientation=rng.normal(size=4))
    return replace(
        SMOOTHED_POSE, robot=robot, pose=where, sequence=max(number, 0), exposed_ns=FIRST_NS + number * 10**7
    )


def frame_of(poses: list[RobotPose], camera: Pose | None = None) -> list[Message]:
    """What the server publishes of a frame with these poses; ``camera`` is where it is, if it is followed."""
    told = poses[0]
    report = pb.FrameReport(sequence=told.sequence, exposed_ns=told.exposed_ns, frame_id=told.frame_id)
    if camera is not None:
        set_report_pose(report.camera.pose, camera)
    odometry = [
        Message(keys.odometry("cam", one.robot), ODOMETRY, encode_odometry(one), one.exposed_ns, 0, one.sequence)
        for one in poses
    ]
    return [*odometry, Message(keys.frame("cam"), FRAME_REPORT, to_bytes(report), told.exposed_ns, 0, told.sequence)]
