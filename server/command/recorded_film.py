"""A recording of a film that is localized as fast as it goes: with the film's own times, the same in every run."""

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from asterism.protocol.codec import stamped
from asterism.protocol.errors import WorldError
from asterism.protocol.messages import Message
from asterism.protocol.program import typed
from asterism.protocol.rig import Rig
from asterism.recordings.recorder import Recorder
from asterism.server.chain.frame import Frame, FrameResult
from asterism.server.chain.report import report
from asterism.server.service.events import Events
from asterism.server.service.say import say
from asterism.server.sources.source import Source


def film_messages(frame: Frame, result: FrameResult, rig: Rig, events: Events) -> list[Message]:
    """What a server would publish of a frame. A film's frame has no times of its own beyond its exposure."""
    at = frame.exposed_ns
    return [
        stamped(message, at)
        for messages in (report(frame, result, rig, at), events.add(result, frame.session))
        for message in messages
    ]


@contextmanager
def film_recorder(
    options: argparse.Namespace, rig: Rig, source: Source
) -> Iterator[Callable[[Frame, FrameResult], None] | None]:
    """What records every frame that it is given, None where no --record asks for it; at the end it says where.

    Raises WorldError where not all could be written; what was is kept.
    """
    if options.record is None:
        yield None
        return
    recorder = Recorder(options.record, rig, source.name, options.record_frames, wait=True, timed=False)
    events, count = Events(rig.camera.name), 0

    def record(frame: Frame, result: FrameResult) -> None:
        nonlocal count
        image = frame.image if frame.image.size else None
        recorder.write(film_messages(frame, result, rig, events), image, frame.exposed_ns, frame.index)
        count += 1

    try:
        yield record
    finally:
        recorder.close({"frames": str(count), "dropped": "0"})
        images = "" if options.record_frames.every else " (poses, no images: they are in the film)"
        say(f"recorded in {recorder.folder}{images}; look at it with")
        say(f"  {typed('review', recorder.folder)}")
    if recorder.problem:
        raise WorldError(recorder.problem)
