"""The faults that `tests.measure.faults` does: each returns how long after its end poses were there again, s."""

import contextlib
import errno
import math
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import zenoh
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry

from asterism.protocol import keys
from asterism.protocol.codec import encode_odometry
from asterism.protocol.network import client_config
from tests.measure.fault_place import CAMERA, ROBOT, ROUTER, SUBSCRIBER, Client, Place, Setting, start
from tests.protocol.make_golden import ROBOT_POSE
from tests.servers import asterism

FROZEN_S = 3.0
STALLED_S = 5.0
SLOW_BYTES_S = 60_000
GONE_S = 30.0
STEPS_S = (3600, -3600, 600, 0)
TOLD_S = 1.3  # that its server stopped answering: asked for is 1 s, and looking takes time
HELD_UP_S = 0.5  # without a pose, by what is none of the client's business


def killed(place: Place) -> float:
    """kill -9, and started again at once."""
    return _killed(place, 0.0)


def gone(place: Place) -> float:
    """kill -9, and started again after half a minute."""
    return _killed(place, GONE_S)


def _killed(place: Place, seconds: float) -> float:
    session = place.client.session()
    place.server.kill()
    time.sleep(seconds)
    moment = time.monotonic()
    place.server.start()
    return place.client.pose_after(moment, session) - moment


def interrupted_twice(place: Place) -> float:
    """Ctrl-C twice, and started again."""
    session = place.client.session()
    for _ in range(2):
        place.server.process.send_signal(signal.SIGINT)
    assert place.server.process.wait(60) == 0
    assert not list(place.folder.rglob(".reserve"))
    moment = time.monotonic()
    place.server.start()
    return place.client.pose_after(moment, session) - moment


def frozen(place: Place) -> float:
    """The server stands still for 3 s (SIGSTOP): the client says so within a second."""
    place.server.process.send_signal(signal.SIGSTOP)
    _told_silent(place, FROZEN_S)
    place.server.process.send_signal(signal.SIGCONT)
    return _back(place)


def client_frozen(place: Place) -> float:
    """The client's program stands still for 3 s: what waited for it is not handed out as fresh."""
    place.client.process.send_signal(signal.SIGSTOP)
    time.sleep(FROZEN_S)
    place.client.process.send_signal(signal.SIGCONT)
    return _back(place)


def subscriber_frozen(place: Place) -> float:
    """A subscriber of everything stands still for 5 s: that is nothing to the client."""
    began = time.monotonic()
    other = start(SUBSCRIBER, place.endpoint)
    other.send_signal(signal.SIGSTOP)
    time.sleep(STALLED_S)
    other.send_signal(signal.SIGCONT)
    back = _back(place)
    assert int(other.communicate()[0]) > 0
    return max(back, _held_up(place, began))


def link_stalled(place: Place) -> float:
    """The client's link stands still for 5 s."""
    assert place.link is not None
    place.link.flows.clear()
    _told_silent(place, STALLED_S)
    place.link.flows.set()
    return _back(place)


def link_slow(place: Place) -> float:
    """The client's link carries 60 kB/s for 5 s."""
    assert place.link is not None
    before, place.link.rate = place.link.rate, SLOW_BYTES_S
    time.sleep(STALLED_S)
    place.link.rate = before
    return _back(place)


def router_killed(place: Place) -> float:
    """The router between server and client is killed, and started again after a second."""
    assert place.router is not None
    place.router.kill()
    place.router.communicate()
    time.sleep(1.0)
    moment = time.monotonic()
    place.router = start(ROUTER, place.endpoint)
    return place.client.pose_after(moment) - moment


def forged(place: Place) -> float:
    """Another client puts poses and answers for the rig under the server's keys for a second."""
    with zenoh.open(client_config(place.endpoint)) as session:
        session.liveliness().declare_token(keys.alive("another"))
        session.declare_queryable(keys.rig(CAMERA), lambda query: query.reply(keys.rig(CAMERA), b""))
        _put_for_a_second(session, encode_odometry(ROBOT_POSE))
    return _back(place)


def nonsense(place: Place) -> float:
    """Through a router, which lets everybody speak, come poses that are none; `watch` looks on."""
    watch = subprocess.Popen(
        [sys.executable, "-m", "asterism.server", "watch", "--connect", place.endpoint],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    with zenoh.open(client_config(place.endpoint)) as session:
        for payload in _nonsense():
            _put_for_a_second(session, payload, 0.2)
            session.put(keys.frame(CAMERA), payload)
            session.put(keys.status(CAMERA), payload)
            session.put(keys.beat(CAMERA), payload)
    back = _back(place)
    assert watch.poll() is None, "watch ended"
    watch.terminate()
    place.errors.append(watch.communicate(timeout=30)[1])
    return back


def _nonsense() -> list[bytes]:
    """No rotation, no place, the name of another that no terminal should see; half a message, and none."""
    whole = encode_odometry(ROBOT_POSE)
    told = [Odometry.FromString(whole) for _ in range(3)]
    told[0].pose.orientation.Clear()
    told[1].pose.position.x = math.nan
    told[2].body_frame_id = "\x1b]0;nobody\x07"
    return [*(one.SerializeToString() for one in told), whole[:40], os.urandom(200)]


def flooded(place: Place) -> float:
    """Two seconds of as many messages as go, under keys that are nobody's."""
    began = time.monotonic()
    with zenoh.open(client_config(place.endpoint)) as session:
        while time.monotonic() < began + 2.0:
            for number in range(100):
                session.put(f"other/{number}", b"x" * 1000)
    return max(_back(place), _held_up(place, began))


def silent_connections(place: Place) -> float:
    """300 connections that say nothing: how long until a new client has a pose."""
    host, port = place.endpoint.removeprefix("tcp/").split(":")
    with ExitStack() as stack:
        for _ in range(300):
            stack.enter_context(socket.create_connection((host, int(port))))
        moment = time.monotonic()
        client = Client(place.endpoint)
        back = client.pose_after(moment) - client.up()
        place.errors.append(client.end())
    return back


def taken_name(place: Place) -> float:
    """A second server of the camera is refused, at the same place and at a router."""
    where = "--listen" if place.router is None else "--connect"
    done = asterism("serve", place.server.rig, "sim", where, place.endpoint)
    assert done.returncode == 2, done.stderr
    place.errors.append(done.stderr)
    return _back(place)


def reloaded(place: Place) -> float:
    """SIGHUP: the rig is read again."""
    said = len(place.server.said())
    place.server.process.send_signal(signal.SIGHUP)
    back = _back(place)
    place.server.until_said("the rig was read again", said)
    return back


def reload_refused(place: Place) -> float:
    """SIGHUP while the rig's file is half written: it is refused whole."""
    said, rig = len(place.server.said()), place.server.rig
    text = rig.read_text()
    rig.write_text(text[: len(text) // 2])
    place.server.process.send_signal(signal.SIGHUP)
    back = _back(place)
    place.server.until_said(rig.name, said)
    rig.write_text(text)
    return back


def disk_full(place: Place) -> float:
    """The recordings' disk is full, and has room again after 3 s; that everything is recorded again is waited for."""
    began, said = time.monotonic(), len(place.server.said())
    filler = place.folder / "filler"
    with filler.open("wb", buffering=0) as file:
        while "is recorded at the moment" not in place.server.said()[said:] or time.monotonic() < began + FROZEN_S:
            assert time.monotonic() < began + 60.0, "that the disk is full was never said"
            with contextlib.suppress(OSError):
                while file.write(b"\0" * 65_536):
                    pass
            time.sleep(0.01)
    held_up = _held_up(place, began)
    said = len(place.server.said())
    for old in sorted(place.folder.glob("*/frames-*.mcap"))[:-1]:
        old.unlink()
    filler.unlink()
    moment = time.monotonic()
    place.server.until_said("everything is recorded again", said)
    return max(held_up, time.monotonic() - moment)


def log_full(place: Place) -> float:
    """What the server says finds no room (/dev/full)."""
    return _says_more(place)


def log_unread(place: Place) -> float:
    """The reader of what the server says has ended."""
    session = place.client.session()
    place.server.end()
    fifo = place.folder.parent / "pipe"
    with contextlib.suppress(FileExistsError):
        os.mkfifo(fifo)
    reader = os.open(fifo, os.O_RDONLY | os.O_NONBLOCK)
    place.server.log = fifo
    place.server.start()
    moment = time.monotonic()
    place.client.pose_after(moment, session)
    with contextlib.suppress(BlockingIOError):
        place.errors.append(os.read(reader, 1 << 20).decode())
    os.close(reader)
    return _says_more(place)


def clock_stepped(place: Place) -> float:
    """The server's wall clock is an hour ahead, an hour behind, ten minutes ahead, right again."""
    assert place.clock is not None
    worst = 0.0
    for step_s in STEPS_S:
        began = time.monotonic()
        place.clock.set(step_s)
        time.sleep(2.0)
        worst = max(worst, _back(place), _held_up(place, began))
    return worst


def _says_more(place: Place) -> float:
    """The server has something to say, and goes on."""
    began = time.monotonic()
    for _ in range(3):
        place.server.process.send_signal(signal.SIGHUP)
        time.sleep(0.3)
    assert place.server.process.poll() is None, "the server ended"
    return max(_back(place), _held_up(place, began))


def _put_for_a_second(session: zenoh.Session, payload: bytes, seconds: float = 1.0) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        session.put(keys.odometry(CAMERA, ROBOT), payload)
        time.sleep(0.005)


def _told_silent(place: Place, seconds: float) -> None:
    """For so long nothing comes from the server: that is told in time."""
    moment = time.monotonic()
    told = place.client.state_after(moment, "SILENT") - moment
    assert told < TOLD_S, f"told after {told:.2f} s"
    time.sleep(max(seconds - told, 0.0))


def _back(place: Place) -> float:
    moment = time.monotonic()
    return place.client.pose_after(moment) - moment


def _held_up(place: Place, since: float) -> float:
    """The longest time without a pose, where there should have been poses all the time: 0 where it is nothing."""
    gap = place.client.longest_gap_s(since)
    return gap if gap > HELD_UP_S else 0.0


class Kind(NamedTuple):
    """A fault, and what it needs. ``short``: a round takes seconds."""

    do: Callable[[Place], float]
    setting: Setting = Setting()
    short: bool = True


FAULTS = {
    kind.do.__name__: kind
    for kind in (
        Kind(killed),
        Kind(gone, short=False),
        Kind(interrupted_twice),
        Kind(frozen),
        Kind(client_frozen),
        Kind(subscriber_frozen, short=False),
        Kind(link_stalled, Setting(link=True), short=False),
        Kind(link_slow, Setting(link=True), short=False),
        Kind(router_killed, Setting(router=True)),
        Kind(forged),
        Kind(nonsense, Setting(router=True)),
        Kind(flooded),
        Kind(silent_connections),
        Kind(taken_name),
        Kind(reloaded),
        Kind(reload_refused),
        Kind(disk_full, Setting(small_disk=True)),
        Kind(log_full, Setting(log="/dev/full")),
        Kind(log_unread),
        Kind(clock_stepped, Setting(clock=True), short=False),
    )
}


def problem(kind: Kind) -> str:
    """Why it cannot be done on this machine, if so."""
    if kind.setting.small_disk and os.geteuid() != 0:
        return "a disk of its own needs root"
    if kind.setting.log and not Path(kind.setting.log).exists():
        return os.strerror(errno.ENOENT)
    if kind.setting.clock:
        try:
            subprocess.run(["cc", "--version"], check=True, stdout=subprocess.DEVNULL)
        except OSError:
            return "a clock that can be stepped needs a C compiler (cc)"
    return ""
