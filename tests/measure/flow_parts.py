"""The parts of `tests.measure.flow`: routers, cameras that publish, subscribers. Each is one process with as many zenoh
sessions as it is asked for; the first line that it reads is one JSON object, which says for how many.
"""

import contextlib
import json
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import zenoh

from asterism.protocol import keys
from asterism.protocol.messages import FRAME_REPORT, ODOMETRY
from asterism.protocol.network import ODOMETRY_PRIORITY, client_config, router_config, server_config, short_of_buffer

TRIES = 20
STAMP = 8  # bytes of a payload: when it was put, monotonic ns of the host


class Part:
    """A part that runs, ended when its standard input is closed."""

    def __init__(self, name: str, **asked: Any) -> None:
        code = f"from tests.measure.flow_parts import {name}; {name}()"
        self._process = subprocess.Popen(
            [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.pid = self._process.pid
        self.ask(json.dumps(asked))

    def _read(self) -> str:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        assert line, "a part ended early"
        return line

    def ask(self, word: str) -> Any:
        """One line to it, and the JSON of the line that it answers with."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{word}\n")
        self._process.stdin.flush()
        return json.loads(self._read())

    def close(self) -> None:
        """End it."""
        self._process.communicate(timeout=60)


def _serve(answer: Callable[[str], Any]) -> None:
    print("null", flush=True)  # ready
    for line in sys.stdin:
        print(json.dumps(answer(line.strip())), flush=True)


def router() -> None:
    """`asterism router` without its words: ``listen``, ``connect``."""
    asked = json.loads(sys.stdin.readline())
    with _open(router_config(asked["listen"], asked["connect"])):
        _serve(lambda _: None)


def cameras() -> None:
    """``cameras``: [endpoint, name, robots' ids] of each; ``rate`` Hz; ``bytes`` of a frame report and an odometry.

    Asked for a number of seconds it publishes so long, and tells how many messages and how long it really took.
    """
    asked = json.loads(sys.stdin.readline())
    puts, sessions = [], []
    for endpoint, name, robots in asked["cameras"]:
        session = _open(server_config(connect=short_of_buffer(endpoint)))
        sessions.append(session)
        poses = [_publisher(session, keys.odometry(name, robot), ODOMETRY.encoding, False) for robot in robots]
        puts.append((poses, _publisher(session, keys.frame(name), FRAME_REPORT.encoding, True)))
    report, pose = (bytes(np.random.default_rng(0).bytes(size - STAMP)) for size in asked["bytes"])

    def publish(seconds: float) -> dict[str, float]:
        period = 1.0 / asked["rate"] / len(puts)
        began, count = time.monotonic(), 0
        while (now := time.monotonic() - began) < seconds:
            due = count * period
            if due > now:
                time.sleep(due - now)
            poses, frame = puts[count % len(puts)]
            for each in poses:
                each.put(_stamp() + pose)
            frame.put(_stamp() + report)
            count += 1
        return {"frames": count, "seconds": time.monotonic() - began}

    _serve(lambda word: publish(float(word)))
    for session in sessions:
        session.close()


def _open(config: zenoh.Config) -> zenoh.Session:
    """Without memory shared between sessions of one host: robots are on hosts of their own, and zenoh 1.10 shares with
    some 350 sessions, no more. On a busy machine a router may not answer in time, so it is asked again.
    """
    config.insert_json5("transport/shared_memory/enabled", "false")
    for _ in range(TRIES):
        with contextlib.suppress(zenoh.ZError):
            return zenoh.open(config)
        time.sleep(1.0)
    return zenoh.open(config)


def _publisher(session: zenoh.Session, key: str, encoding: str, whole: bool) -> zenoh.Publisher:
    """As `server.service.publish` declares it."""
    priority = zenoh.Priority.DATA if whole else getattr(zenoh.Priority, ODOMETRY_PRIORITY)
    drop = zenoh.CongestionControl.DROP
    return session.declare_publisher(key, encoding=zenoh.Encoding(encoding), congestion_control=drop, priority=priority)


def _stamp() -> bytes:
    return time.monotonic_ns().to_bytes(STAMP, "little")


def subscribers() -> None:
    """``subscribers``: [endpoint, key expressions] of each, a session each.

    Asked for anything it tells how many messages came since it was asked last, their bytes without zenoh's own, and the
    percentiles 50 and 99 of their ages, ms.
    """
    asked = json.loads(sys.stdin.readline())
    ages: list[float] = []
    total = [0]

    def hear(sample: zenoh.Sample) -> None:
        payload = sample.payload.to_bytes()
        ages.append((time.monotonic_ns() - int.from_bytes(payload[:STAMP], "little")) * 1e-6)
        total[0] += len(payload)

    sessions = [_open(client_config(endpoint)) for endpoint, _ in asked["subscribers"]]
    held = [
        session.declare_subscriber(key, hear)
        for session, (_, expressions) in zip(sessions, asked["subscribers"], strict=True)
        for key in expressions
    ]

    def tell(_: str) -> dict[str, float]:
        heard = np.array(ages)
        told = {"messages": len(heard), "bytes": total[0]}
        if len(heard):
            told |= {f"p{p}": float(np.percentile(heard, p)) for p in (50, 99)}
        ages.clear()
        total[0] = 0
        return told

    _serve(tell)
    for each in held:
        each.undeclare()
    for session in sessions:
        session.close()
