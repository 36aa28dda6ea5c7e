"""The loop: for every frame of the source, localize, report, publish, record."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import NamedTuple

from asterism.protocol.messages import Message
from asterism.protocol.rig import Rig
from asterism.recordings.recorder import Recorder
from asterism.server.chain.frame import Frame
from asterism.server.chain.pipeline import localize
from asterism.server.chain.report import report
from asterism.server.chain.smooth import Motions, smooth
from asterism.server.pose.solve import PoseEstimate
from asterism.server.pose.track import Tracks
from asterism.server.service.adviser import Adviser
from asterism.server.service.disk import Disk
from asterism.server.service.health import Health
from asterism.server.service.live_line import Now
from asterism.server.service.publish import Publisher
from asterism.server.service.say import say
from asterism.server.service.threads import Feed, Ticker
from asterism.server.sources.camera import Camera
from asterism.server.sources.paced import paced
from asterism.server.sources.session_clock import SessionClock
from asterism.server.sources.source import Source

STATUS_EVERY_S = 1.0
SILENT_S = 0.5  # after that long without a frame no robot counts as visible

Sink = Callable[[list[Message], Frame], None]


class Outlets(NamedTuple):
    """Where every frame's messages go."""

    publisher: Publisher
    recorder: Recorder | None = None
    sinks: tuple[Sink, ...] = ()


class Stop:
    """Set by Ctrl-C, a signal, or whoever ends the run."""

    def __init__(self) -> None:
        self._event = threading.Event()
        self.interrupted = False  # by a person or a signal, before its time

    def interrupt(self) -> None:
        """End the run for a signal."""
        self.interrupted = True
        self.set()

    def set(self) -> None:
        """End the run after the frame in work."""
        self._event.set()

    def __call__(self) -> bool:
        return self._event.is_set()


@contextmanager
def stop_on_signals(stop: Stop) -> Iterator[None]:
    """Let Ctrl-C and SIGTERM end the run cleanly."""
    before = {number: signal.signal(number, lambda *_: stop.interrupt()) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class Run:
    """One run of the server: its source, where its messages go, how it is doing."""

    def __init__(self, rig: Rig, source: Source, outlets: Outlets, stop: Stop, clock: SessionClock) -> None:
        self.rig = rig
        self.clock = clock
        self.source = source
        self.outlets = outlets
        self.stop = stop
        self.health = Health(rig.camera.name, source.name, (robot.id for robot in rig.robots))
        self._adviser = Adviser(rig, self.health.tally, say)
        self._disk = None if outlets.recorder is None else Disk(outlets.recorder, say)

    def serve(self, rate_hz: float | None = None, smoothed: bool = False) -> None:
        """Localize, publish and record every frame until the source ends or ``stop`` is set.

        ``rate_hz`` plays images and videos at another rate than their own; ``smoothed`` publishes poses that `smooth`
        has joined to those before. Raises what the source raises; what was recorded by then is kept.
        """
        source = self.source
        frames = source.frames() if source.live else paced(source.frames(), rate_hz, self.stop, self.clock)
        with ExitStack() as stack:
            feed = Feed(frames, source.live)
            stack.callback(feed.close)
            if isinstance(source, Camera):
                stack.callback(source.close)
            stack.callback(self._count, feed)
            stack.callback(Ticker(lambda: self._tick(feed), STATUS_EVERY_S).close)
            self._loop(feed, smoothed)

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
        health.frames_dropped = feed.dropped
        health.frames_unreadable = self.source.unreadable
        if recorder is not None:
            health.frames_not_recorded = recorder.frames_left_out
            health.messages_not_recorded = recorder.messages_left_out
        waiting = self.source.problem if isinstance(self.source, Camera) else ""
        health.problem = waiting or (recorder.problem if recorder is not None else "")

    def _tick(self, feed: Feed) -> None:
        """Once a second: tell the status, say what is to be said."""
        self._count(feed)
        if (step_ns := self.clock.look()) is not None:
            say(f"this machine's clock was set by {step_ns * 1e-9:+.3f} s; a new session begins")
        now = self.clock.now_ns()
        status = self.outlets.publisher.publish([self.health.message(now, self.clock.session)])
        if self.outlets.recorder is not None:
            self.outlets.recorder.write(status, None, now, 0)
        if self._disk is not None:
            self._disk.look()
        self._adviser.look()

    def _loop(self, feed: Feed, smoothed: bool) -> None:
        rig, outlets = self.rig, self.outlets
        publisher, recorder = outlets.publisher, outlets.recorder
        tracks, motions = Tracks.none(), Motions.none()
        while not self.stop():
            frame = feed.next(SILENT_S)
            if frame is None:
                if feed.finished:
                    return
                publisher.show_visible(())
                continue
            result, tracks = localize(frame, rig, tracks)
            if smoothed:
                result, motions = smooth(result, motions)
            solved_ns = self.clock.now_ns(frame.session)
            messages = publisher.publish(report(frame, result, rig, solved_ns), frame.session)
            located = (robot for robot, answer in result.answers.items() if isinstance(answer, PoseEstimate))
            publisher.show_visible(located)
            self.health.add(frame, result, solved_ns, messages[-1].publish_ns)
            if recorder is not None:
                recorder.write(messages, frame.image, frame.exposed_ns, frame.index)
            for sink in outlets.sinks:
                sink(messages, frame)
