"""Poses of one robot, or of all: the newest, one after another, by callback or in asyncio."""

import logging
import math
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import fields
from typing import NamedTuple

from asterism.clients.accept import problem
from asterism.clients.callbacks import Callbacks
from asterism.clients.event_feed import EventFeed
from asterism.clients.received_pose import ReceivedPose, clock_ns
from asterism.clients.robot_event import RobotEvent
from asterism.clients.server_state import FUTURE_S, LATE_S, ServerState
from asterism.clients.stream import stream
from asterism.protocol.codec import decode_odometry
from asterism.protocol.errors import InputError
from asterism.protocol.messages import RobotPose

MOST = 1024  # pairs of camera and robot that are remembered
LOG_EVERY_S = 1.0
KNOWN_WITHIN_S = 0.3  # a pose waits so long for its server to tell its clock, once a session
LONG_NS = 50_000_000  # of callbacks
IDLE_NS = 2_000_000  # between two poses: none waited
_FIELDS = tuple(field.name for field in fields(RobotPose))
_LOG = logging.getLogger(__name__)


class _Held(NamedTuple):
    number: int  # of all that arrived
    pose: ReceivedPose


class Feed:
    """What poses have in common that arrive together. Safe to use from any thread."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._held: dict[tuple[str, str], _Held] = {}  # by camera and robot, the newest last
        self._count = 0
        self._callbacks: Callbacks[ReceivedPose] = Callbacks()
        self._wakers: Callbacks[None] = Callbacks()
        self._events = EventFeed()
        self._closed = False
        self.refused = 0  # messages that were no poses
        self.late = 0  # poses that arrived more than 0.3 s after they went out
        self._said_s = -math.inf
        self._free_ns = 0  # when the last pose was done with
        self._behind = False  # a callback took long: poses wait for it, not on their way

    def wait(self, timeout_s: float) -> ReceivedPose | None:
        """The next pose that arrives, or None after that time."""
        with self._changed:
            return self._next(self._count, timeout_s)

    def __iter__(self) -> Iterator[ReceivedPose]:
        """Every new pose from now on; one that is replaced before it is asked for is skipped. Ends when the client is
        closed.
        """
        return self.poses()

    def poses(self, timeout_s: float | None = None) -> Iterator[ReceivedPose]:
        """The same; ends as well when there is none for that time."""
        return self._poses(self._count, timeout_s)

    def _poses(self, seen: int, timeout_s: float | None) -> Iterator[ReceivedPose]:
        while True:
            with self._changed:
                pose = self._next(seen, timeout_s)
                if pose is None or self._closed:
                    return
                seen = self._held[pose.camera, pose.robot].number
            yield pose

    def stream(self, timeout_s: float | None = None) -> AsyncIterator[ReceivedPose]:
        """The same for asyncio: ``async for pose in feed.stream()``."""
        return stream(self._wakers, self._after, self._count, timeout_s)

    def on_pose(self, callback: Callable[[ReceivedPose], object]) -> Callable[[], None]:
        """Have every pose handed to ``callback``, on the feed's own thread; what is returned takes it back.

        While it is at work, up to 256 poses wait for it, and the newest are not handed on. One that raises is logged
        once and called again.
        """
        return self._callbacks.add(callback)

    def off_pose(self, callback: Callable[[ReceivedPose], object]) -> None:
        """Take a callback back."""
        self._callbacks.remove(callback)

    def on_event(self, callback: Callable[[RobotEvent], object]) -> Callable[[], None]:
        """Have every event handed to ``callback``, on the thread of the client's events: the robot was lost or found,
        frames stopped or came again, another rig is in force. What is returned takes it back.
        """
        return self._events.callbacks.add(callback)

    def off_event(self, callback: Callable[[RobotEvent], object]) -> None:
        """Take a callback back."""
        self._events.callbacks.remove(callback)

    def events(self, timeout_s: float | None = None) -> Iterator[RobotEvent]:
        """Every event from now on, none skipped (up to 256 wait). Ends when the client is closed, or when there is none
        for that time.
        """
        return self._events.after_now(timeout_s)

    @property
    def event(self) -> RobotEvent | None:
        """The newest event, or None: none has arrived since the client began."""
        return self._events.newest

    def _next(self, seen: int, timeout_s: float | None) -> ReceivedPose | None:
        """The pose that follows the first ``seen``, waited for; called under the lock."""
        self._changed.wait_for(lambda: self._count > seen or self._closed, timeout_s)
        later = [held for held in self._held.values() if held.number > seen]
        return min(later).pose if later else None

    def _after(self, seen: int) -> tuple[int, ReceivedPose | None, bool]:
        """The pose that follows the first ``seen`` with its number, if there is one; whether the client is closed."""
        with self._changed:
            pose = self._next(seen, 0.0)
            number = seen if pose is None else self._held[pose.camera, pose.robot].number
            return number, pose, self._closed

    def _take(self, payload: bytes, key: str, robot: str, server: ServerState) -> None:
        """A message arrived under ``key``: hand it on if it is a pose of ``robot``."""
        try:
            pose = self._accepted(payload, robot, server)
        except InputError as error:
            self._refuse(key, str(error))
            return
        with self._changed:
            self._count += 1
            self._held.pop((pose.camera, robot), None)
            self._held[pose.camera, robot] = _Held(self._count, pose)
            if len(self._held) > MOST:
                del self._held[next(iter(self._held))]
            self._changed.notify_all()
        self._wakers.call(None)
        self._callbacks.call(pose)
        self._free_ns = clock_ns()
        self._behind = self._behind or self._free_ns - pose.received_ns > LONG_NS

    def _accepted(self, payload: bytes, robot: str, server: ServerState) -> ReceivedPose:
        now_ns = clock_ns()
        if now_ns - self._free_ns > IDLE_NS:
            self._behind = False
        pose = decode_odometry(payload)
        if told := problem(pose, robot):
            raise InputError(f"the pose {told}")
        clock = server.age(pose.session)
        if not clock.known and not clock.waited:
            clock = server.wait_known(pose.session, KNOWN_WITHIN_S)
            clock.waited = True
        if server.answered and not clock.known:
            raise InputError("the pose is of a session that its server does not know")
        late_s = server.arrived(clock, pose.published_ns, now_ns, self._behind)
        if late_s < -FUTURE_S:
            raise InputError(f"the pose was published {-late_s:.1f} s from now")
        self.late += late_s > LATE_S and not self._behind
        points = server.points.get(robot, {})
        return ReceivedPose(
            **{name: getattr(pose, name) for name in _FIELDS},
            camera=server.camera,
            received_ns=now_ns,
            clock=clock,
            points=points,
        )

    def _refuse(self, key: str, why: str) -> None:
        """Count what is no pose, and say so once a second at most."""
        self.refused += 1
        now_s = time.monotonic()
        if now_s - self._said_s >= LOG_EVERY_S:
            self._said_s = now_s
            shown = "".join(char if char.isprintable() else "?" for char in f"{key}: {why}")
            _LOG.warning("%s; ignored (%d so far)", shown[:400], self.refused)

    def _close(self) -> None:
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._wakers.call(None)
        self._events.close()
