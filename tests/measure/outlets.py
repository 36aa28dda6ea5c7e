"""What `serve --dds`, `--mavlink` and `--natnet` cost a frame, and what reaches who listens:
`python -m tests.measure.outlets [FRAMES] [HZ]`.

Each tells of FRAMES frames (default 1000) of five robots at HZ (default 60), with a client that nobody here wrote
listening in a process of its own (rosless, pymavlink, natnet), with that client stopped (SIGSTOP), and with none.
Printed, per robot and frame, us: what telling took the chain's thread, median and 99 %, and the processor time of the
whole process; and what arrived. All in a network of its own that nothing leaves (`unshare -rn`), without other load.
"""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from asterism.protocol.messages import Message
from asterism.protocol.rig import load_rig
from asterism.protocol.ros2.names import RosPlace
from asterism.server.service.dds.node import DdsNode
from asterism.server.service.mavlink.endpoint import Endpoint
from asterism.server.service.mavlink.outlet import Mavlink
from asterism.server.service.natnet.outlet import NatNet
from asterism.server.service.outlets import Outlet
from asterism.server.service.ros2.outlet import Ros2
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.sources.session_clock import SessionClock
from tests.service.ros2.independent import FRAME, frame_of, pose

ALONE = 'ip link set lo up multicast on && ip route add 224.0.0.0/4 dev lo && exec "$0" -m tests.measure.outlets "$@"'
RIG = load_rig(DEMO_RIG)
ROBOTS = [robot.id for robot in RIG.robots]
HOST, PORT, DOMAIN = "127.0.0.1", 14_550, 3
JOINING_S, LEFT_S = 2.0, 1.0
DEEP = 5000  # messages that a reader of DDS keeps until they are read


def outlet_of(name: str) -> Outlet:
    """As `serve` opens it."""
    if name == "dds":
        return Ros2(DdsNode(DOMAIN), RIG, RosPlace(DOMAIN, ""), SessionClock())
    if name == "mavlink":
        return Mavlink(RIG, [Endpoint(robot, HOST, PORT + k) for k, robot in enumerate(ROBOTS)], SessionClock())
    return NatNet(RIG, HOST, PORT)


def heard(name: str) -> Iterator[str]:
    """What comes in, one name after another, an empty one at least every 50 ms; by clients that nobody here wrote."""
    if name == "dds":
        import rosless

        node = rosless.Node(DOMAIN)
        wanted = {"/tf": "tf2_msgs/msg/TFMessage"}
        wanted |= {f"/{robot}/odom": "nav_msgs/msg/Odometry" for robot in ROBOTS}
        wanted |= {f"/{robot}/pose": "geometry_msgs/msg/PoseWithCovarianceStamped" for robot in ROBOTS}
        readers = {one: node.subscribe(one, kind, reliability="reliable", depth=DEEP) for one, kind in wanted.items()}
        while True:
            for topic, reader in readers.items():
                while reader.read(timeout=0.0) is not None:
                    yield topic
            time.sleep(0.002)
            yield ""
    if name == "mavlink":
        from pymavlink import mavutil

        links = [mavutil.mavlink_connection(f"udpin:{HOST}:{PORT + k}", dialect="common") for k in range(len(ROBOTS))]
        while True:
            for robot, link in zip(ROBOTS, links, strict=True):
                while link.recv_match(type="ODOMETRY") is not None:
                    yield robot
            time.sleep(0.002)
            yield ""
    from natnet import NatNetClient

    got: list[object] = []
    with NatNetClient(HOST, HOST, command_port=PORT, use_multicast=False) as client:
        client.on_data_frame_received_event.handlers.append(got.append)
        while True:
            client.update_sync()
            yield from ["frame"] * len(got)
            got.clear()
            time.sleep(0.002)
            yield ""


def listen(name: str) -> None:
    """Say that it listens; count until SIGTERM, then print the counts."""
    counts: dict[str, int] = {}
    ended: list[int] = []
    ready = False
    signal.signal(signal.SIGTERM, lambda *_: ended.append(1))
    for what in heard(name):
        if what:
            counts[what] = counts.get(what, 0) + 1
        elif ended:
            break
        elif not ready:
            ready = True
            print("ready", flush=True)
    print(json.dumps(counts))


def run(name: str, listener: str, frames: list[list[Message]], rate_hz: float) -> tuple[float, float, float, str]:
    """Median and 99 % in the chain's thread and processor time, us; what arrived."""
    outlet = outlet_of(name)
    process = None
    if listener != "none":
        words = [sys.executable, "-m", "tests.measure.outlets", "listen", name]
        process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        time.sleep(JOINING_S)
    if process is not None and listener == "stopped":
        process.send_signal(signal.SIGSTOP)
    took, used = [], time.process_time()
    for messages in frames:
        time.sleep(1.0 / rate_hz)  # not by the clock: no camera makes up for frames that came late
        at = time.perf_counter()
        outlet.write(messages, FRAME)
        took.append(time.perf_counter() - at)
    time.sleep(LEFT_S)
    used = time.process_time() - used
    arrived = ""
    if process is not None:
        process.send_signal(signal.SIGCONT)
        process.send_signal(signal.SIGTERM)
        counts = json.loads(process.communicate()[0])
        if listener == "listens":
            arrived = f"{min(counts.values())} of {len(frames)} on each of {len(counts)}"
    outlet.close()
    p50, p99 = np.percentile(took, [50, 99]) * 1e6 / len(ROBOTS)
    return p50, p99, used * 1e6 / len(frames) / len(ROBOTS), arrived


def main(count: int, rate_hz: float) -> None:
    """Measure and print."""
    rng = np.random.default_rng(0)
    frames = [frame_of([pose(number, rng, robot) for robot in ROBOTS]) for number in range(count)]
    table = Table(title=f"{count} frames at {rate_hz:g} Hz", box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("outlet", "client", "chain's thread, p50", "p99", "processor", "arrived"):
        table.add_column(heading, justify="left" if heading in ("outlet", "client", "arrived") else "right")
    for name in ("dds", "mavlink", "natnet"):
        for listener in ("listens", "stopped", "none"):
            p50, p99, used, arrived = run(name, listener, frames, rate_hz)
            table.add_row(name, listener, f"{p50:.1f}", f"{p99:.1f}", f"{used:.0f}", arrived)
    Console(width=110).print(table)


def alone() -> bool:
    """Whether there is no network but loopback here."""
    return [name for _, name in socket.if_nameindex()] == ["lo"]


if __name__ == "__main__":
    words = sys.argv[1:]
    if words[:1] == ["listen"]:
        os.environ["MAVLINK20"] = "1"
        listen(words[1])
    elif not alone():
        os.execvp("unshare", ["unshare", "-rn", "sh", "-c", ALONE, sys.executable, *words])
    else:
        main(int(words[0]) if words else 1000, float(words[1]) if len(words) > 1 else 60.0)
