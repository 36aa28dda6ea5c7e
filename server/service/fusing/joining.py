"""The loop of `asterism fuse`: reports in the order of their exposures, joined, published."""

import gc
import re
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import NamedTuple

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import stamped, to_bytes
from asterism.protocol.messages import Message
from asterism.server.fusing.fleet import Fleet
from asterism.server.fusing.fuse import solved
from asterism.server.fusing.fused import Fused, FusedPose
from asterism.server.fusing.memory import Joint
from asterism.server.fusing.places import Places
from asterism.server.fusing.report import Told, report, rig_report
from asterism.server.fusing.sighting import Sighting
from asterism.server.service.events import Answer, Events
from asterism.server.service.fusing.cameras import Cameras
from asterism.server.service.fusing.ears import Answers, Ears, Heard
from asterism.server.service.fusing.health import FusedHealth
from asterism.server.service.fusing.host_clocks import HostClocks, told_apart
from asterism.server.service.fusing.inbox import Inbox
from asterism.server.service.fusing.order import Order, Waiting
from asterism.server.service.fusing.ways import Ways, told_of_times
from asterism.server.service.live_line import Now
from asterism.server.service.publish import Publisher
from asterism.server.service.say import say
from asterism.server.service.stop import Stop
from asterism.server.service.systemd import Systemd
from asterism.server.service.threads import Ticker
from asterism.server.sources.session_clock import SessionClock

STATUS_EVERY_S = 1.0
LOOK_EVERY_S = 0.1
SILENT_S = 0.5  # after that long without an exposure no robot counts as visible
NOBODY_S = 5.0  # without a camera that is said
SAY_AGAIN_S = 60.0  # what is wrong
BEHIND = 3  # frames: of what waits longer, because joining takes too long, the oldest is passed over
USUAL_NS = 16_666_667  # frame period, before one is known


class _Report(NamedTuple):
    sighting: Sighting
    clock: "pb.Clock"


@dataclass(frozen=True, slots=True)
class _Seen:
    exposed_ns: int
    index: int
    answers: Mapping[str, Answer]


class Joining:
    """Joins what ``hear`` puts into its queue. ``places`` is where cameras are looked for, for sentences."""

    def __init__(
        self, publisher: Publisher, clock: SessionClock, stop: Stop, cameras: Sequence[str], places: str
    ) -> None:
        self.health = FusedHealth()
        self.cameras = Cameras(cameras, say, self._begin_anew)
        self._publisher = publisher
        self._clock = clock
        self._stop = stop
        self._places = places
        self._inbox = Inbox()
        self._order: Order[_Report] = Order()
        self._joint = Joint.none()
        self._clocks = HostClocks()
        self._ways = Ways()
        self._astray: set[str] = set()
        self._events = Events("fused")
        self._systemd = Systemd()
        self._sequence = 0
        self._running = False
        self._said_nobody = False
        self._said_s: dict[str, float] = {}
        self._began_s = self._newest_s = time.monotonic()
        self._answer_for_rig()

    def hear(self, heard: Heard | Answers) -> None:
        """Something came; from any thread. Frames before `run` are not waited with."""
        if self._running or not (isinstance(heard, Heard) and heard.word == "frame"):
            self._inbox.put(heard)

    def run(self, ears: Ears) -> None:
        """Join and publish until ``stop`` is set."""
        with ExitStack() as stack:
            stack.callback(Ticker(self._tick, STATUS_EVERY_S).close)
            stack.callback(self._systemd.stopping)
            self._systemd.ready()
            self._running = True
            gc.freeze()
            stack.callback(gc.unfreeze)
            until_ns: int | None = None
            while not self._stop():
                self._hear_all(until_ns)
                for camera in self.cameras.asks(time.monotonic_ns()):
                    ears.ask(camera.ear, camera.name, camera.texts)
                ready, until_ns = self._order.due(time.monotonic_ns())
                for reports in self._not_behind(ready):
                    self._join(reports)
                self._look_for_silence()

    def now(self) -> Now:
        """How it is doing, for the live line."""
        notes = [f"{len(self.cameras.fleet.views)} cameras"]
        if self.health.late:
            notes.append(f"{self.health.late} late")
        health = self.health
        return Now(health.exposures, None, health.rate_hz(), health.newest(), notes, health.problem)

    def summary(self) -> list[str]:
        """What it did: a line for the exposures, one for every camera that was late or lost, one for every robot."""
        health, told = self.health, "stopped after " if self._stop.interrupted else ""
        passed = health.behind + self._inbox.lost
        lines = [f"{told}{health.exposures} exposures, {health.late} reports late, {passed} passed over"]
        for name in sorted(self._order.late.keys() | self._order.missed.keys()):
            late, missed = self._order.late[name], self._order.missed[name]
            lines.append(f"camera '{name}': {late} reports late, {missed} times waited for in vain")
        return [*lines, *health.lines()]

    def _hear_all(self, until_ns: int | None) -> None:
        """Wait for what comes, up to then, and take all that has come."""
        wait_s = LOOK_EVERY_S if until_ns is None else min((until_ns - time.monotonic_ns()) * 1e-9, LOOK_EVERY_S)
        for heard in self._inbox.taken(wait_s):
            self._take(heard)

    def _take(self, heard: Heard | Answers) -> None:
        if isinstance(heard, Answers):
            if self.cameras.answered(heard.camera, heard.answers):
                self._answer_for_rig()
        elif heard.payload is None:
            self.cameras.token(heard.camera, heard.ear, heard.there, heard.arrived_ns)
        elif heard.word == "event":
            self.cameras.event(heard.camera, heard.ear, heard.payload, heard.arrived_ns)
        elif (told := self.cameras.report(heard.camera, heard.ear, heard.payload, heard.arrived_ns)) is not None:
            self._wait(heard, *told)

    def _wait(self, heard: Heard, sighting: Sighting, told: "pb.FrameReport") -> None:
        self._clocks.add(heard.camera, told.published_ns, self._clock.at_ns(heard.arrived_ns))
        astray = set(self._clocks.astray())
        if astray != self._astray:  # whose stamps were gone by must not be what others are compared with
            self._astray = astray
            self._order.begin_anew()
        if heard.camera in astray:
            return
        self._ways.add(heard.camera, told)
        report = _Report(sighting, told.clock)
        if not self._order.add(heard.camera, Waiting(told.exposed_ns, heard.arrived_ns, report)):
            self.health.late += 1

    def _not_behind(self, ready: list[list[Waiting[_Report]]]) -> list[list[Waiting[_Report]]]:
        """Without those that newer ones have overtaken by too much: where joining is too slow, the newest counts."""
        if len(ready) <= BEHIND:
            return ready
        oldest_ns = ready[-1][0].exposed_ns - BEHIND * self._period_ns()
        kept = [reports for reports in ready if reports[0].exposed_ns >= oldest_ns]
        self.health.behind += len(ready) - len(kept)
        return kept

    def _join(self, reports: list[Waiting[_Report]]) -> None:
        """One exposure: its poses, out at once, then all else."""
        fleet, clock = self.cameras.fleet, self._clock
        session, exposed_ns = clock.session, reports[0].exposed_ns
        line = solved([waiting.report.sighting for waiting in reports], fleet, self._joint)
        fused = line.fused
        solved_ns = clock.now_ns(session)
        arrived_ns = clock.at_ns(max(waiting.arrived_ns for waiting in reports), session)
        clocks = {waiting.report.clock for waiting in reports}
        stamp = clocks.pop() if len(clocks) == 1 else pb.CLOCK_UNSPECIFIED
        told = Told(self._sequence, session, arrived_ns, solved_ns, stamp)
        out_ns = self._put(fused, fleet, told)
        self._joint = line.memory()
        self.health.add(fused, (solved_ns - arrived_ns) * 1e-9, (out_ns - exposed_ns) * 1e-9)
        located = [robot for robot, answer in fused.answers.items() if isinstance(answer, FusedPose)]
        self._publisher.show_visible(located)
        seen = _Seen(exposed_ns, self._sequence, fused.answers)
        self._publisher.publish(self._events.add(seen, session), session)
        self._sequence += 1
        self._newest_s = time.monotonic()
        self._systemd.alive()

    def _put(self, fused: Fused, fleet: Fleet, told: Told) -> int:
        """Publish the messages of an exposure; returns when the first went out."""
        first_ns = 0
        for message in report(fused, fleet, told):
            # A camera's clock may be a little ahead of this machine's: nothing goes out before it was exposed.
            out = stamped(message, max(self._clock.now_ns(told.session), fused.exposed_ns))
            self._publisher.put(out)
            first_ns = first_ns or out.publish_ns
        return first_ns

    def _look_for_silence(self) -> None:
        now_s = time.monotonic()
        silent_s = now_s - self._newest_s
        if silent_s > SILENT_S:
            self._publisher.show_visible(())
            self._tell(self._events.silent(silent_s, f"no camera has told of a frame for {silent_s:.1f} s"))
            self._systemd.alive()
        if not self._said_nobody and not self.cameras.fleet.views and now_s - self._began_s > NOBODY_S:
            self._said_nobody = True
            say(f"no camera is heard at {self._places} yet; waiting for one ...")

    def _tell(self, events: list[Message]) -> None:
        self._publisher.publish(events)

    def _begin_anew(self, camera: str) -> None:
        """What was remembered of that camera is of another session, or another rig."""
        self._order.forget(camera)
        self._clocks.forget(camera)
        self._ways.forget(camera)
        paces = {name: pace for name, pace in self._joint.paces.items() if name != camera}
        self._joint = replace(self._joint, paces=paces, places=Places())

    def _answer_for_rig(self) -> None:
        self._publisher.rig_payload = to_bytes(rig_report(self.cameras.fleet))

    def _tick(self) -> None:
        """Once a second: say what is wrong, tell the status."""
        if (step_ns := self._clock.look()) is not None:
            say(f"this machine's clock was set by {step_ns * 1e-9:+.3f} s; a new session begins")
        problems = self.cameras.problems(time.monotonic_ns())
        if not self.cameras.fleet.views and not problems:
            problems = [f"no camera is heard at {self._places}"]
        self._ways.look(time.monotonic_ns())
        period_ns = self._period_ns()
        facts = told_apart(self._clocks, period_ns) or told_of_times(self._ways, 1e-9 * period_ns)
        facts += self.health.contradictions()
        self._log(facts)
        self.health.problem = "; ".join([*problems, *facts])
        now_ns, source = self._clock.now_ns(), ", ".join(self.cameras.fleet.views) or "no camera"
        self._publisher.publish([self.health.message(source, now_ns, self._clock.session)])

    def _log(self, facts: list[str]) -> None:
        """Say what was not said in the last minute, with whatever numbers."""
        now_s = time.monotonic()
        for fact in facts:
            kind = re.sub(r"\d[\d.e+-]*", "", fact)
            if now_s - self._said_s.get(kind, -SAY_AGAIN_S) >= SAY_AGAIN_S:
                self._said_s[kind] = now_s
                say(fact)

    def _period_ns(self) -> int:
        """The least of the cameras'."""
        paces = [self._order.pace(camera) for camera in list(self.cameras.fleet.views)]
        return min((pace.period_ns for pace in paces if pace is not None and pace.known), default=USUAL_NS)
