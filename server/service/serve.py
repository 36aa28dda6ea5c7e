"""The loop: for every frame of the source, localize, report, publish, record."""

import gc
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import NamedTuple

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import encode_rig, to_bytes
from asterism.protocol.messages import Message
from asterism.protocol.rig import Rig
from asterism.recordings.recorder import Recorder
from asterism.server.chain.frame import Frame, FrameResult
from asterism.server.chain.pipeline import localize
from asterism.server.chain.report import report
from asterism.server.chain.smooth import Motions, smooth
from asterism.server.pose.solve import PoseEstimate
from asterism.server.pose.track import Tracks
from asterism.server.service.adviser import Adviser
from asterism.server.service.carry import carried, carried_motions
from asterism.server.service.disk import Disk
from asterism.server.service.drift import Drift
from asterism.server.service.events import Events
from asterism.server.service.health import Health
from asterism.server.service.live_line import Now
from asterism.server.service.outlets import Outlet
from asterism.server.service.publish import Publisher
from asterism.server.service.reload import Outcome, Reloader, settings_left
from asterism.server.service.say import complain, say, say_warnings
from asterism.server.service.stop import Stop
from asterism.server.service.surface_watch import SurfaceWatch
from asterism.server.service.systemd import Systemd
from asterism.server.service.threads import Feed, Newest, Ticker
from asterism.server.sources.paced import paced
from asterism.server.sources.session_clock import SessionClock
from asterism.server.sources.simulated import Simulated
from asterism.server.sources.source import LiveSource, Source

STATUS_EVERY_S = 1.0
BREATH_S = 0.001  # of the thread that looks at drift: frames do not wait for it to be done
WATCHED = 40  # frames that may wait for the thread that looks at the surface
SILENT_S = 0.5  # after that long without a frame no robot counts as visible


class Outlets(NamedTuple):
    """Where every frame's messages go."""

    publisher: Publisher
    recorder: Recorder | None = None
    others: tuple[Outlet, ...] = ()
    begun: Callable[[], None] | None = None  # called with every frame: there is one


def _teller(outlets: Outlets) -> Callable[[list[Message], int | None], None]:
    """What tells events that come between frames everywhere; they are stamped in the session given."""

    def tell(events: list[Message], session: int | None) -> None:
        for told in outlets.publisher.publish(events, session):
            if outlets.recorder is not None:
                outlets.recorder.write([told], None, told.log_ns, told.sequence)
            for outlet in outlets.others:
                outlet.between([told])

    return tell


class Run:
    """One run of the server: its source, where its messages go, how it is doing.

    ``rig_path`` is where its rig is read again from when `reloader` is asked to; without it the rig stays.
    """

    def __init__(
        self,
        rig: Rig,
        source: Source,
        outlets: Outlets,
        stop: Stop,
        clock: SessionClock,
        rig_path: str | None = None,
    ) -> None:
        self.rig = rig
        self.clock = clock
        self.source = source
        self.outlets = outlets
        self.stop = stop
        self.health = Health(rig.camera.name, source.name, (robot.id for robot in rig.robots))
        self._adviser = Adviser(rig, self.health.tally, say)
        self._drift = Drift(rig, say)
        self._surface = SurfaceWatch(rig, say)
        self._disk = None if outlets.recorder is None else Disk(outlets.recorder, say)
        self._systemd = Systemd()
        self._events = Events(rig.camera.name)
        self._tell = _teller(outlets)
        self._reloads = pb.Reloads()
        self.reloader: Reloader | None = None
        if rig_path is not None:
            self.reloader = Reloader(rig_path, rig, lambda: self.health.tally.frame, self._systemd)
            self._answer_for_rig()

    def serve(self, rate_hz: float | None = None, smoothed: bool = False) -> None:
        """Localize, publish and record every frame until the source ends or ``stop`` is set.

        ``rate_hz`` plays images and videos at another rate than their own; ``smoothed`` publishes poses that `smooth`
        has joined to those before. Raises what the source raises; what was recorded by then is kept.
        """
        source = self.source
        if isinstance(source, Simulated) and source.common:
            frames = source.by_the_clock(rate_hz, self.stop, self.clock)
        else:
            frames = source.frames() if source.live else paced(source.frames(), rate_hz, self.stop, self.clock)
        with ExitStack() as stack:
            feed = Feed(frames, source.live)
            stack.callback(feed.close)
            if isinstance(source, LiveSource):
                stack.callback(source.close)
            stack.callback(self._count, feed)
            stack.callback(Ticker(lambda: self._tick(feed), STATUS_EVERY_S).close)
            stack.callback(self._systemd.stopping)
            # In a thread of its own, frame by frame: what is wrong is to be said within ten of them.
            watched = Newest(self._watch_surface, "surface", WATCHED)
            stack.callback(watched.close)
            if self.reloader is not None:
                stack.callback(self.reloader.close)
            self._systemd.ready()
            # A hundred thousand objects, kernels' above all, stay to the end: looking at them again takes 40 ms.
            gc.freeze()
            stack.callback(gc.unfreeze)
            self._loop(feed, smoothed, watched)

    def now(self) -> Now:
        """How it is doing, for the live line."""
        health = self.health
        notes = [] if self._disk is None else [self._disk.text]
        for count, what in (
            (health.frames_dropped, "dropped"),
            (health.frames_unreadable, "unreadable"),
            (health.frames_not_recorded, "not recorded"),
        ):
            if count:
                notes.append(f"{count} {what}")
        tally = health.tally
        return Now(tally.frames, self.source.length, tally.rate_hz(), tally.newest(), notes, health.problem)

    def summary(self) -> list[str]:
        """What it did: a line for the frames, one for every robot, and what can be done for those never found."""
        health, recorder = self.health, self.outlets.recorder
        told = "stopped after " if self.stop.interrupted else ""
        told += f"{health.tally.frames} frames, {health.frames_dropped} dropped, {health.frames_unreadable} unreadable"
        if recorder is not None:
            told += f", {recorder.frames_left_out} not recorded"
            if recorder.messages_left_out:
                told += f" (nor {recorder.messages_left_out} messages)"
        return [told, *self._adviser.summary()]

    def ending(self) -> dict[str, str]:
        """What a recording's last metadata say of the run."""
        return {"frames": str(self.health.tally.frames), "dropped": str(self.health.frames_dropped)}

    def _count(self, feed: Feed) -> None:
        """Bring the numbers up to date that others count."""
        recorder, health = self.outlets.recorder, self.health
        health.frames_dropped = feed.dropped + (self.source.missed if isinstance(self.source, LiveSource) else 0)
        health.frames_unreadable = self.source.unreadable
        if recorder is not None:
            health.frames_not_recorded = recorder.frames_left_out
            health.messages_not_recorded = recorder.messages_left_out
        drift = self._drift.problem
        recording, surface = "" if recorder is None else recorder.problem, self._surface.problem
        problems = (self._waiting(), recording, self._reloads.problem, drift, surface)
        health.problem = "; ".join(filter(None, problems))

    def _waiting(self) -> str:
        """Why there are no frames, where the source itself says so."""
        return self.source.problem if isinstance(self.source, LiveSource) else ""

    def _tick(self, feed: Feed) -> None:
        """Once a second: tell the status, say what is to be said."""
        self._count(feed)
        if (step_ns := self.clock.look()) is not None:
            say(f"this machine's clock was set by {step_ns * 1e-9:+.3f} s; a new session begins")
        now = self.clock.now_ns()
        status = self.outlets.publisher.publish([self.health.message(now, self.clock.session)])
        if self.outlets.recorder is not None:
            self.outlets.recorder.write(status, None, now, 0)
        for outlet in self.outlets.others:
            outlet.between(status)
        if self._disk is not None:
            self._disk.look()
        self._adviser.look()
        self._drift.look(lambda: time.sleep(BREATH_S))

    def _watch_surface(self, result: FrameResult) -> None:
        """By the rig in force: it may be another by now."""
        self._surface.add(result)

    def _loop(self, feed: Feed, smoothed: bool, watched: Newest[FrameResult]) -> None:
        publisher, recorder = self.outlets.publisher, self.outlets.recorder
        tracks, motions, silent_s = Tracks.none(), Motions.none(), 0.0
        while not self.stop():
            frame = feed.next(SILENT_S)
            if self.reloader is not None and (outcome := self.reloader.take()) is not None:
                tracks, motions = self._reloaded(outcome, tracks, motions)
                self._tell_rig(outcome, frame)
            if frame is None:
                if feed.finished:
                    return
                publisher.show_visible(())
                silent_s += SILENT_S
                why = self._waiting() or f"no frame has come for {silent_s:g} s"
                self._tell(self._events.silent(silent_s, why), None)
                # A camera that hangs says nothing: then nothing is said of us either, and systemd starts us anew.
                if self._waiting() or not self.source.live:
                    self._systemd.alive()
                continue
            silent_s = 0.0
            result, tracks = localize(frame, self.rig, tracks)
            if smoothed:
                result, motions = smooth(result, motions, self.rig)
            solved_ns = self.clock.now_ns(frame.session)
            messages = publisher.publish(report(frame, result, self.rig, solved_ns), frame.session)
            located = (robot for robot, answer in result.answers.items() if isinstance(answer, PoseEstimate))
            publisher.show_visible(located)
            self.health.add(frame, result, solved_ns, messages[-1].publish_ns)
            self._drift.add(result)
            if self._surface.watches:
                watched.give(result)
            messages += publisher.publish(self._events.add(result, frame.session), frame.session)
            if recorder is not None:
                recorder.write(messages, frame.image, frame.exposed_ns, frame.index)
            for outlet in self.outlets.others:
                outlet.write(messages, frame)
            if self.outlets.begun is not None:
                self.outlets.begun()
            self._systemd.alive()

    def _tell_rig(self, outcome: Outcome, frame: Frame | None) -> None:
        """Before the first frame that another rig solves: that it is in force, or why it is not."""
        session = self.clock.session if frame is None else frame.session
        first = None if frame is None else (frame.exposed_ns, frame.index)
        self._tell(self._events.rig_read(outcome.problem, first, self.clock.now_ns(session), session), session)

    def _reloaded(self, outcome: Outcome, tracks: Tracks, motions: Motions) -> tuple[Tracks, Motions]:
        """Between two frames: take another rig, or say why not. Returns what is remembered for the next frame."""
        before, rig = self.rig, outcome.rig
        self._reloads = pb.Reloads(count=self._reloads.count + 1, problem=outcome.problem)
        if rig is not None:
            self._take(rig)
            tracks, motions = carried(tracks, before, rig), carried_motions(motions, before, rig)
            took_s = time.monotonic() - outcome.asked_s
            say(f"the rig was read again; it is in force, {took_s:.2f} s after it was asked for")
            say_warnings(rig)
            if left := settings_left(before, rig):
                say(left)
        else:
            complain(outcome.problem)
        self._answer_for_rig()
        self._systemd.ready()
        return tracks, motions

    def _take(self, rig: Rig) -> None:
        """From the next frame on this rig is in force."""
        self.rig = rig
        self.health.tally.change_robots(robot.id for robot in rig.robots)
        self._adviser = Adviser(rig, self.health.tally, say)
        self._drift = self._drift.with_rig(rig)
        self._surface = SurfaceWatch(rig, say)
        if self.outlets.recorder is not None:
            self.outlets.recorder.take_rig(rig)
        for outlet in self.outlets.others:
            outlet.take_rig(rig)

    def _answer_for_rig(self) -> None:
        """What the `rig` queryable tells: the rig in force, and how reading it again went."""
        told = to_bytes(pb.RigReport(reloads=self._reloads))
        self.outlets.publisher.rig_payload = encode_rig(self.rig) + told
