"""What `serve --ros2` costs a frame, and what a node that nobody here wrote receives:
`python -m tests.measure.ros2 [FRAMES] [HZ]`.

The outlet of `serve --ros2` tells of FRAMES frames (default 1000) at HZ (default 100), of one robot and of five, while
a node of zenoh-ros2-sdk listens to poses, odometry and transforms in a process of its own. Printed: how many of the
messages it has, how many of them hold other numbers than were told, what telling took the chain's thread a frame,
median and 99 %, us, and all threads together, processor time; the same where nobody listens.
"""

import sys
import time
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from asterism.protocol.codec import decode_odometry, encode_odometry
from asterism.protocol.messages import Message, RobotPose
from asterism.protocol.rig import load_rig
from asterism.protocol.ros2 import conversion, types
from asterism.protocol.ros2.cdr import encode
from asterism.protocol.ros2.names import RosPlace
from asterism.protocol.ros2.values import RosMessage, TFMessage
from asterism.server.service.ros2.outlet import Ros2
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.protocol.ros2.ros_store import in_ros
from tests.service.ros2.independent import FIRST_NS, FRAME, SdkNode, frame_of, pose, telling, wait_until_it_listens
from tests.service.ros2.sdk_node import plain

PLACE = RosPlace(0, "")


def topics_of(robots: list[str]) -> dict[str, types.RosType]:
    """What the node listens to."""
    poses = {f"/{robot}/pose": types.POSE_WITH_COVARIANCE_STAMPED for robot in robots}
    return {**poses, **{f"/{robot}/odom": types.ODOMETRY for robot in robots}, "/tf": types.TF_MESSAGE}


def expected(told: list[list[RobotPose]], robots: list[str]) -> dict[str, list[Any]]:
    """What it should have of each topic, as rosbags reads what the messages were made of."""

    def read(message: RosMessage) -> Any:
        return plain(in_ros(encode(message), message.TYPE.ros))

    found: dict[str, list[Any]] = {"/tf": []}
    for frame in told:
        found["/tf"].append(read(TFMessage(tuple(map(conversion.robot_transform, frame)))))
        for one in frame:
            found.setdefault(f"/{one.robot}/pose", []).append(read(conversion.pose_with_covariance(one)))
            found.setdefault(f"/{one.robot}/odom", []).append(read(conversion.odometry(one)))
    assert len(found) == 2 * len(robots) + 1
    return found


def tell(outlet: Ros2, frames: list[list[Message]], rate_hz: float) -> tuple[np.ndarray, float]:
    """Tell of every frame at its time; what each took the caller, s, and this process in the mean, of a processor."""
    took, begin, used_s = [], time.perf_counter(), time.process_time()
    for number, messages in enumerate(frames):
        time.sleep(max(begin + number / rate_hz - time.perf_counter(), 0.0))
        at = time.perf_counter()
        outlet.write(messages, FRAME)
        took.append(time.perf_counter() - at)
    return np.array(took), (time.process_time() - used_s) / len(frames)


def run(count: int, rate_hz: float, robots: list[str], listened: bool) -> tuple[np.ndarray, float, str, str]:
    """Times, s, and processor time a frame; how much arrived, how much of it was wrong."""
    rng, rig = np.random.default_rng(0), load_rig(DEMO_RIG)
    told = [[pose(number, rng, robot) for robot in robots] for number in range(count)]
    with telling(PLACE, rig) as (endpoint, outlet, _):
        node = SdkNode(endpoint, PLACE.domain, topics_of(robots)) if listened else None
        if node is not None:
            wait_until_it_listens(node, outlet, [pose(-1, rng, robot) for robot in robots])
        took, used_s = tell(outlet, [frame_of(frame) for frame in told], rate_hz)
        if node is None:
            return took, used_s, "", ""
        time.sleep(1.0)
        received = {topic: list(filter(_is_told, got)) for topic, got in node.finish()["received"].items()}
    wanted = expected([list(map(_told_again, frame)) for frame in told], robots)
    arrived = {topic: len(messages) for topic, messages in received.items()}
    wrong = sum(one not in wanted[topic] for topic in wanted for one in received[topic])
    least, most = min(arrived.values()), max(arrived.values())
    each = f"{least}" if least == most else f"{least} to {most}"
    return took, used_s, f"{each} of {count} on each of {len(arrived)} topics", f"{wrong} of {sum(arrived.values())}"


def _told_again(told: RobotPose) -> RobotPose:
    """As the outlet decodes it."""
    return decode_odometry(encode_odometry(told))


def _is_told(message: Any) -> bool:
    """Whether it is of a frame that counts: those before told a time before the first."""
    header = message["transforms"][0]["header"] if "transforms" in message else message["header"]
    return bool(header["stamp"]["sec"] >= FIRST_NS // 10**9)


def main(count: int, rate_hz: float) -> None:
    """Measure and print."""
    table = Table(title=f"{count} frames at {rate_hz:g} Hz", box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("robots", "node", "arrived", "with other numbers", "chain us p50", "p99", "processor us"):
        table.add_column(heading)
    robots = [robot.id for robot in load_rig(DEMO_RIG).robots]
    for some in (robots[:1], robots):
        for listened in (True, False):
            took, used_s, arrived, wrong = run(count, rate_hz, some, listened)
            p50, p99 = np.percentile(1e6 * took, [50, 99])
            name = "listens" if listened else "none"
            table.add_row(f"{len(some)}", name, arrived, wrong, f"{p50:.0f}", f"{p99:.0f}", f"{1e6 * used_s:.0f}")
    Console(width=120).print(table)


if __name__ == "__main__":
    words = sys.argv[1:]
    main(int(words[0]) if words else 1000, float(words[1]) if len(words) > 1 else 100.0)
