"""Whether a robot is out of sight, its server frozen, or gone; and how programs end."""

import os
import signal
import subprocess
import sys
import threading

import pytest

from asterism.clients import LinkState, PoseClient
from asterism.clients.server_state import ServerState
from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import to_bytes
from asterism.protocol.network import open_server
from tests.clients.serving import Server, until
from tests.helpers import REPOSITORY
from tests.protocol.make_golden import RIG
from tests.servers import free_endpoint


def test_no_pose_and_a_newer_server_are_told(endpoint: str, server: Server, caplog: pytest.LogCaptureFixture) -> None:
    with PoseClient(endpoint) as robots:
        feed = robots["alpha"]
        until(lambda: robots.link.state is LinkState.LIVE)
        assert feed.link.state is LinkState.NO_POSE
        assert feed.link.sentence == "robot 'alpha': no pose yet; camera 'cam': the server is alive"
        until(lambda: server.tell() or feed.link.state is LinkState.LIVE)
        until(lambda: feed.link.state is LinkState.NO_POSE)
        assert "robot 'alpha': no pose for " in feed.link.sentence
        there = ", ".join(sorted(robot.id for robot in RIG.robots))
        until(lambda: "no pose yet" not in robots["alhpa"].link.sentence)  # until the rig is known
        assert robots["alhpa"].link.sentence.startswith(
            f"robot 'alhpa': no rig here has it, there are: {there}; camera"
        )
    state = ServerState("cam", threading.Event())
    state.answers(pb.RigReport(protocol=2, session=5, time_ns=10**18, rate=1.0), 0, 1000)
    assert not state.is_newer
    # Of a server that speaks a newer protocol one sentence is logged, however often it answers.
    rig = pb.RigReport(protocol=3, session=5, time_ns=10**18, rate=1.0)
    newer = open_server(other := free_endpoint())
    queryable = newer.declare_queryable(
        "asterism/new/rig", lambda query: query.reply("asterism/new/rig", to_bytes(rig))
    )
    with PoseClient(other) as robots:
        until(lambda: robots.links)
        until(lambda: caplog.messages)
    queryable.undeclare()
    newer.close()
    (told,) = caplog.messages
    assert told.startswith("camera 'new': the server speaks protocol 3, this program knows 2; ")


FROZEN = """
import sys, time
from tests.clients.serving import Server
server = Server(sys.argv[1])
while True:
    server.tell()
    time.sleep(0.01)
"""


def test_a_frozen_server_a_dead_one_and_a_robot_out_of_sight_are_told_apart(endpoint: str) -> None:
    process = subprocess.Popen([sys.executable, "-c", FROZEN, endpoint], cwd=REPOSITORY)
    try:
        with PoseClient(endpoint) as robots:
            feed = robots["alpha"]
            until(lambda: feed.link.state is LinkState.LIVE)
            assert robots["bravo"].link.state is LinkState.NO_POSE
            os.kill(process.pid, signal.SIGSTOP)
            until(lambda: robots.link.state is LinkState.SILENT)
            assert "has stopped answering, for " in robots.link.sentence
            assert not robots.alive
            os.kill(process.pid, signal.SIGCONT)
            until(lambda: feed.link.state is LinkState.LIVE)
            process.kill()
            until(lambda: robots.link.state is LinkState.GONE)
            assert robots.link.sentence == "camera 'cam': the server is gone"
    finally:
        process.kill()
        process.wait()


PROGRAM = """
import sys
from asterism.clients import PoseClient
client = PoseClient(sys.argv[1])
feed, everyone = client["alpha"], client.all()
taken = []
feed.on_pose(taken.append)
print("ready", flush=True)
for pose in feed:
    if len(taken) > 4:
        break
if sys.argv[2] == "raise":
    raise SystemExit(3)
if sys.argv[2] == "close":
    client.close()
"""


def test_programs_older_than_their_server_end_as_they_should(endpoint: str) -> None:
    ways = {"leave": 0, "close": 0, "raise": 3}
    programs = {
        how: subprocess.Popen(
            [sys.executable, *(["-O"] if how == "leave" else []), "-c", PROGRAM, endpoint, how],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=REPOSITORY,
        )
        for how in ways
    }
    for program in programs.values():
        assert program.stdout is not None
        assert program.stdout.readline() == "ready\n"
    server = Server(endpoint)
    until(lambda: server.tell() or all(program.poll() is not None for program in programs.values()))
    server.close()
    ends = {how: (program.returncode, program.communicate()[1]) for how, program in programs.items()}
    assert ends == {how: (code, "") for how, code in ways.items()}
