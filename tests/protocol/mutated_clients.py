"""What clients make of bytes from the network: poses through PoseClient's own feed, all else into state and table."""

import logging
import math
import threading
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from asterism.clients import feed
from asterism.clients.age import SessionAge
from asterism.clients.event_feed import EventReader
from asterism.clients.json_lines import JsonLines
from asterism.clients.link_state import Link, LinkState
from asterism.clients.received_pose import ReceivedPose, clock_ns
from asterism.clients.robot_event import RobotEvent
from asterism.clients.robot_feed import RobotFeed
from asterism.clients.server_state import ServerState
from asterism.clients.servers import Servers
from asterism.clients.watched import RobotTable
from asterism.protocol.codec import decode_beat, decode_event, decode_rig, decode_status, encode_odometry
from asterism.protocol.errors import InputError
from tests.protocol import make_golden

LIVE = Link(LinkState.LIVE, "alive")
_HALF = np.random.default_rng(1).normal(size=(6, 6)) * np.array([1e-5, 1e-5, 1e-4, 1e-3, 1e-3, 1e-4])[:, None]
CORRELATED = _HALF @ _HALF.T  # most changes of one number leave no covariance


class _Answering(ServerState):
    """A server that answers at once, so that nobody waits for it."""

    def wait_known(self, session: int, timeout_s: float) -> SessionAge:  # noqa: ARG002
        return self.age(session)


def _server() -> ServerState:
    server, now_ns = _Answering("cam", threading.Event()), clock_ns()
    report = make_golden.rig_report()
    report.time_ns = make_golden.EXPOSED_NS + 10_000_000
    server.shows(True, now_ns)
    server.answers(report, now_ns - 1_000_000, now_ns)
    return server


def pose(payload: bytes) -> ReceivedPose:
    """Given to a robot's feed as it arrives: what is handed on is a pose, all else is counted. Raises InputError."""
    taken = RobotFeed("alpha", lambda: LIVE)
    logger, told = feed._LOG, _Told()
    logger.addHandler(told)
    try:
        taken._take(payload, "asterism/cam/robot/alpha/odometry", "alpha", _server())
    finally:
        logger.removeHandler(told)
    found = taken.latest(math.inf)
    assert (found is None) == (taken.refused == 1)
    if found is None:
        raise InputError(told.sentence)
    _look_at(found)
    return found


class _Told(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        self.sentence = record.getMessage()


def _look_at(found: ReceivedPose) -> None:
    """Whether a robot can be driven by it: nothing here asks what the client asked."""
    numbers = [*found.position, *found.orientation, *found.covariance.ravel(), found.rms_px]
    if found.velocity is not None:
        numbers += [*found.velocity.linear, *found.velocity.angular, *found.velocity.covariance.ravel()]
    assert np.isfinite(np.array(numbers)).all()
    assert abs(np.linalg.norm(found.orientation) - 1.0) < 1e-2
    assert found.robot == "alpha"
    assert found.state in ("TRACKED", "TILT_AMBIGUOUS")
    assert 4 <= found.leds <= 6
    assert 0 <= found.published_ns - found.exposed_ns <= 600e9
    assert (np.diag(found.covariance) > 0.0).all()
    assert not math.isnan(found.age_s)
    point = found.point("tool")
    assert np.isfinite(point.position).all()
    try:
        ahead = found.predicted(0.1)
    except InputError:
        return
    assert np.isfinite(ahead.position).all()


def poses() -> tuple[bytes, ...]:
    """Good ones, smoothed and not."""
    both = (make_golden.ROBOT_POSE, make_golden.SMOOTHED_POSE)
    return tuple(encode_odometry(replace(one, covariance=CORRELATED)) for one in both)


def _sample(payload: bytes, key: str) -> Any:
    return SimpleNamespace(key_expr=key, payload=SimpleNamespace(to_bytes=lambda: payload))


def _shown(table: RobotTable, width: int) -> None:
    """Whatever arrived, a terminal is shown text and nothing that steers it. Raises InputError for what was refused."""
    for text in (table.draw(width).plain, *table.lines()):
        assert all(char.isprintable() or char == "\n" for char in text), text
    if table._refused:
        raise InputError(table._refused)


def report(payload: bytes) -> None:
    """A frame's report into the live table, and as a line of JSON."""
    sample = _sample(payload, "asterism/cam/frame")
    table = RobotTable()
    lines = JsonLines((), "", table.servers)
    lines._frame(sample)
    line = lines.next(0.0)
    assert line is not None
    assert line.isprintable()
    table._frame(sample)
    _shown(table, 79)


def status(payload: bytes) -> None:
    """A server's health into the live table."""
    table = RobotTable()
    table._health(_sample(payload, "asterism/cam/status"))
    decode_status(payload)
    _shown(table, 100)


def event(payload: bytes) -> None:
    """What happened, to a client and as a line of JSON. Raises InputError for what is no event."""
    servers, taken = Servers(""), list[RobotEvent]()
    reader, lines = EventReader(servers, taken.append), JsonLines((), "", servers)
    reader.read(payload, "cam")
    for one in taken:
        assert not math.isnan(one.age_s)
        assert one.lasted_s >= 0.0
        assert one.sentence
    lines._event(_sample(payload, "asterism/cam/event"))
    line = lines.next(0.0)
    assert line is not None
    assert line.isprintable()
    assert len(taken) == 1 - reader.refused
    decode_event(payload)


def beat(payload: bytes) -> None:
    """A sign of life to what a client knows of its server."""
    server, told, now_ns = _server(), decode_beat(payload), clock_ns()
    server.beats(told, now_ns)
    assert not math.isnan(server.age(make_golden.SESSION).age_s(now_ns, make_golden.EXPOSED_NS))
    assert server.link(now_ns).sentence
    table = RobotTable()
    table._beat(_sample(payload, "asterism/cam/beat"))
    _shown(table, 80)


def rig_report(payload: bytes) -> None:
    """A reply to what a client knows of its server, and to the live table."""
    server, told, now_ns = _server(), decode_rig(payload), clock_ns()
    server.answers(told, now_ns - 1_000_000, now_ns)
    assert all(np.isfinite(point).all() for points in server.points.values() for point in points.values())
    assert server.link(now_ns).sentence
    assert server.newer
    table = RobotTable(["alfa"])
    table.servers["cam"].answers(told, now_ns - 1_000_000, now_ns)
    _shown(table, 80)
