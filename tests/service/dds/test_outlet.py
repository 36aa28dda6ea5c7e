"""What nodes of ROS 2 get over DDS, by a client that nobody here wrote, in a network that nothing leaves."""

import importlib.util
import json
import shutil
import subprocess
import sys
from dataclasses import replace
from typing import Any

import pytest

pytest.importorskip("cyclonedds", reason="cyclonedds is not installed (pip install '.[dds]')")

from asterism.protocol.ros2.names import RosPlace
from asterism.server.service.dds.node import DdsNode
from asterism.server.service.dds.participant import USERS_OWN
from asterism.server.service.ros2.outlet import Ros2
from asterism.server.sources.session_clock import SessionClock
from tests.helpers import REPOSITORY
from tests.protocol.make_golden import RIG
from tests.servers import TIMEOUT_S
from tests.service.dds.apart import poses
from tests.service.ros2.received import DYNAMIC, TOPICS, check_received

COUNT = 50  # 1000: python -m tests.service.dds.apart 0 1000, in such a network
DOMAIN = 11
# A network of its own has loopback alone, without multicast as it begins.
ALONE = "ip link set lo up multicast on && ip route add 224.0.0.0/4 dev lo && exec"


def test_a_node_receives_everything_and_nothing_but_loopback_is_heard() -> None:
    found = run_apart(COUNT)
    received = found["received"]
    assert set(found["heard_at"]) == {"0.0.0.0%lo", "127.0.0.1"}
    counts = {topic: COUNT if topic in DYNAMIC else 1 for topic in TOPICS}
    assert {topic: len(messages) for topic, messages in received.items()} == counts
    check_received(received, poses(COUNT))


def test_robots_come_and_go_with_the_rig(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(USERS_OWN, raising=False)
    (alpha,) = RIG.robots
    outlet = Ros2(DdsNode(DOMAIN), RIG, RosPlace(DOMAIN, ""), SessionClock())
    try:
        for robots in ((replace(alpha, id="bravo"),), (), (alpha,)):
            outlet.take_rig(replace(RIG, robots=robots))
            found = {robot.odom._writer.topic.name for robot in outlet._robots.values()}  # type: ignore[attr-defined]
            assert found == {f"rt/{robot.id}/odom" for robot in robots}
    finally:
        outlet.close()


def run_apart(count: int) -> dict[str, Any]:
    """apart.py in a network of its own; the test is skipped where there can be none."""
    if importlib.util.find_spec("rosless") is None:
        pytest.skip("rosless is not installed (pip install '.[dev]')")
    for program in ("unshare", "ip", "ss"):
        if shutil.which(program) is None:
            pytest.skip(f"there is no `{program}` here: it is in the packages util-linux and iproute2")
    if subprocess.run(["unshare", "-rn", "sh", "-c", f"{ALONE} true"], capture_output=True, check=False).returncode:
        pytest.skip("this machine does not let a user make a network of his own (`unshare -rn`)")
    script = f'{ALONE} "$0" -m tests.service.dds.apart {DOMAIN} {count}'
    done = subprocess.run(
        ["unshare", "-rn", "sh", "-c", script, sys.executable],
        stdout=subprocess.PIPE,
        text=True,
        timeout=TIMEOUT_S,
        check=True,
        cwd=REPOSITORY,
    )
    told: dict[str, Any] = json.loads(done.stdout)
    return told
