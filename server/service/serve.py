"""The loop: for every frame of the source, localize, report, publish, record."""

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from asterism.protocol.messages import Message
from asterism.protocol.rig import Rig
from asterism.recordings.recorder import Recorder
from asterism.server.chain.frame import Frame
from asterism.server.chain.pipeline import localize
from asterism.server.chain.report import report
from asterism.server.chain.smooth import Motions, smooth
from asterism.server.pose.solve import PoseEstimate
from asterism.server.pose.track import Tracks
from asterism.server.service.health import Health
from asterism.server.service.publish import Publisher
from asterism.server.service.threads import Feed, Ticker
from asterism.server.sources.camera import Camera
from asterism.server.sources.paced import paced
from asterism.server.sources.source import Source

STATUS_EVERY_S = 1.0
SILENT_S = 0.5  # after that long without a frame no robot counts as visible

Sink = Callable[[list[Message], Frame], None]


@dataclass(frozen=True, slots=True)
class Summary:
    """What a run did."""

    frames: int
    dropped: int
    unreadable: int
    left_out: int  # frames that the recorder left out
    problem: str  # why the recording ended early


class Stop:
    """Set by Ctrl-C, a signal, or whoever ends the run."""

    def __init__(self) -> None:
        self._event = threading.Event()

    def set(self) -> None:
        """End the run after the frame in work."""
        self._event.set()

    def __call__(self) -> bool:
        return self._event.is_set()


@contextmanager
def stop_on_signals(stop: Stop) -> Iterator[None]:
    """Let Ctrl-C and SIGTERM end the run cleanly."""
    before = {number: signal.signal(number, lambda *_: stop.set()) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def serve(
    rig: Rig,
    source: Source,
    publisher: Publisher,
    recorder: Recorder | None,
    stop: Stop,
    rate_hz: float | None = None,
    sinks: tuple[Sink, ...] = (),
    smoothed: bool = False,
) -> Summary:
    """Localize, publish and record every frame until the source ends or ``stop`` is set.

    ``rate_hz`` plays images and videos at another rate than their own; ``smoothed`` publishes poses that `smooth` has
    joined to those before. Raises what the source raises; what was
    recorded by then is kept.
    """
    health = Health(rig.camera.name, source.name)
    frames = source.frames() if source.live else paced(source.frames(), rate_hz, stop)
    with ExitStack() as stack:
        feed = Feed(frames, source.live)
        stack.callback(feed.close)
        if isinstance(source, Camera):
            stack.callback(source.close)

        def tell_status() -> None:
            health.frames_dropped = feed.dropped
            health.frames_unreadable = source.unreadable
            if recorder is not None:
                health.frames_not_recorded = recorder.frames_left_out
            waiting = source.problem if isinstance(source, Camera) else ""
            health.problem = waiting or (recorder.problem if recorder is not None else "")
            now = time.time_ns()
            status = [health.message(now)]
            publisher.publish(status)
            if recorder is not None:
                recorder.write(status, None, now, 0)

        ticker = Ticker(tell_status, STATUS_EVERY_S)
        stack.callback(ticker.close)
        _loop(rig, feed, publisher, recorder, stop, health, sinks, smoothed)
        dropped = feed.dropped
    return Summary(
        health.frames,
        dropped,
        source.unreadable,
        recorder.frames_left_out if recorder is not None else 0,
        recorder.problem if recorder is not None else "",
    )


def _loop(
    rig: Rig,
    feed: Feed,
    publisher: Publisher,
    recorder: Recorder | None,
    stop: Stop,
    health: Health,
    sinks: tuple[Sink, ...],
    smoothed: bool,
) -> None:
    tracks, motions = Tracks.none(), Motions.none()
    while not stop():
        frame = feed.next(SILENT_S)
        if frame is None:
            if feed.finished:
                return
            publisher.show_visible(())
            continue
        result, tracks = localize(frame, rig, tracks)
        if smoothed:
            result, motions = smooth(result, motions)
        solved_ns = time.time_ns()
        messages = report(frame, result, rig, solved_ns, time.time_ns())
        publisher.publish(messages)
        publisher.show_visible(robot for robot, answer in result.answers.items() if isinstance(answer, PoseEstimate))
        health.add(result, frame.arrived_ns, solved_ns, messages[-1].publish_ns)
        if recorder is not None:
            recorder.write(messages, frame.image, frame.exposed_ns, frame.index)
        for sink in sinks:
            sink(messages, frame)
