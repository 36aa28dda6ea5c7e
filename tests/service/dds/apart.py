"""A server's outlet for DDS and rosless_node.py, alone in a network of their own: test_outlet.py runs it there.

Arguments: domain, how many frames. Prints one line of JSON: `received`, messages by topic, and `heard_at`, where this
process' UDP sockets are bound.
"""

import json
import subprocess
import sys
from typing import Any

import numpy as np

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import to_bytes
from asterism.protocol.messages import STATUS, Message, RobotPose
from asterism.protocol.ros2.names import RosPlace
from asterism.server.service.dds.node import DdsNode, DdsPublisher
from asterism.server.service.ros2.outlet import Ros2
from asterism.server.sources.session_clock import SessionClock
from tests.clients.serving import until
from tests.protocol.make_golden import RIG
from tests.service.ros2.independent import FRAME, frame_of, pose
from tests.service.ros2.received import DYNAMIC, TOPICS

NAMESPACE = "/lab"
TOGETHER = 5  # frames without a pause: fewer than a topic keeps
HEALTH = pb.Status(time_ns=5, rate_hz=60.0, problem="the disk is full")


def poses(count: int) -> list[RobotPose]:
    """What is told of `alpha`, the same in every process."""
    rng = np.random.default_rng(13)
    return [pose(number, rng) for number in range(count)]


class RoslessNode:
    """rosless_node.py, in a process of its own."""

    def __init__(self, domain: int) -> None:
        asked = [(topic, kind.ros, topic == "/tf_static") for topic, kind in TOPICS.items()]
        command = [sys.executable, "-m", "tests.service.dds.rosless_node", str(domain), json.dumps(asked)]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        assert self.process.stdout.readline().strip() == "ready"

    def counts(self) -> dict[str, int]:
        """How many messages it has of each topic."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write("how many?\n")
        self.process.stdin.flush()
        told: dict[str, int] = json.loads(self.process.stdout.readline())
        return told

    def finish(self) -> dict[str, list[Any]]:
        """What it received."""
        out, _ = self.process.communicate(timeout=60.0)
        told: dict[str, list[Any]] = json.loads(out)
        return told


def main() -> None:
    domain, count = int(sys.argv[1]), int(sys.argv[2])
    outlet = Ros2(DdsNode(domain), RIG, RosPlace(domain, NAMESPACE), SessionClock())
    listener = RoslessNode(domain)
    told_by = [*outlet._robots["alpha"], outlet._tf, outlet._tf_static, outlet._diagnostics]
    until(lambda: all(isinstance(one, DdsPublisher) and one._writer.get_matched_subscriptions() for one in told_by))
    for sent, told in enumerate(poses(count), start=1):
        outlet.write(frame_of([told]), FRAME)
        if sent % TOGETHER == 0 or sent == count:
            until(lambda at_least=sent: min(listener.counts()[topic] for topic in DYNAMIC) >= at_least)
    outlet.between([Message("asterism/cam/status", STATUS, to_bytes(HEALTH), 5, 5, 0)])
    until(lambda: min(listener.counts().values()) > 0)
    print(json.dumps({"received": listener.finish(), "heard_at": heard_at()}))
    outlet.close()


def heard_at() -> list[str]:
    """Address and device of this process' UDP sockets, such as `0.0.0.0%lo`."""
    import os

    lines = subprocess.run(["ss", "-lnup"], capture_output=True, text=True, check=True).stdout.splitlines()
    return [line.split()[3].rpartition(":")[0] for line in lines if f"pid={os.getpid()}," in line]


if __name__ == "__main__":
    main()
