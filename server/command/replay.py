"""asterism replay: publish a recording again with its original timing."""

import argparse
import time
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import decode_frame_report, encode_rig, in_session
from asterism.protocol.errors import InputError
from asterism.protocol.messages import FRAME_REPORT, UNNUMBERED, Message
from asterism.protocol.program import typed
from asterism.protocol.rig import Rig, load_rig
from asterism.recordings.reader import Recording
from asterism.server.command.number_arguments import positive
from asterism.server.command.shared_arguments import add_recording, add_server, client_words
from asterism.server.service.on_air import Place, on_air
from asterism.server.service.play_clock import PlayClock
from asterism.server.service.publish import Publisher
from asterism.server.service.say import say
from asterism.server.service.stop import Stop, stop_on_signals
from asterism.server.sources.paced import LONGEST_GAP_NS

EXAMPLES = (
    "asterism replay RECORDING\n"
    "asterism replay RECORDING --speed 0.5 --loop\n"
    "asterism replay RECORDING --solve rig.yaml\n"
)

BACK_NS = 100_000_000  # what threads publish side by side may be out of order by less
LOCATED = (pb.TRACKED, pb.TILT_AMBIGUOUS)


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add_recording(part)
    part.add_argument("--speed", metavar="X", type=positive, default=1.0, help="times faster (default: 1)")
    part.add_argument("--loop", action="store_true", help="again and again, until Ctrl-C")
    part.add_argument("--solve", metavar="RIG", help="solve the recorded frames again, with this rig")
    part.add_argument(
        "--as-live", action="store_true", help="under the original keys; refused while that camera's server is alive"
    )
    add_server(part)


def run(options: argparse.Namespace) -> int:
    """Replay once, or with --loop until Ctrl-C."""
    recording = Recording(options.recording)
    rig = recording.rig()
    if options.solve is not None:
        rig = load_rig(options.solve)
        if not recording.count_frames():
            raise InputError(
                f"{options.recording}: holds no frames; record with --record-frames all to solve them again"
            )
    stop = Stop()
    with ExitStack() as last, ExitStack() as stack:
        prefix = "" if options.as_live else keys.REPLAY
        clock, place = PlayClock(options.speed), Place(options.listen, options.connect, options.zenoh)
        air = stack.enter_context(on_air(place, rig, clock, stop.interrupt, prefix))
        if options.solve is not None:
            from asterism.server.chain.warm_up import localizing, warm_up

            warm_up(*localizing(rig))
        last.enter_context(stop_on_signals(stop))
        say(f"replaying {options.recording} at {place} under {prefix}asterism/{rig.camera.name}")
        prefixed = ["--prefix", prefix] if prefix else []
        say(f"watch it in another terminal: {typed('watch', *prefixed, *client_words(options))}")
        published = 0
        while not stop():
            source = _solved(recording, rig) if options.solve is not None else _answering(recording, air.publisher)
            published += _play(_wire(source), air.publisher, clock, stop)
            if not options.loop:
                break
    if air.rivals.sentence:
        raise InputError(air.rivals.sentence)
    say(f"{'stopped after ' if stop() else ''}{published} messages published")
    return 0


def _wire(messages: Iterator[Message]) -> Iterator[Message]:
    return (message for message in messages if message.kind.on_wire)


def _answering(recording: Recording, publisher: Publisher) -> Iterator[Message]:
    """Its messages; the publisher answers with the rig that was in force at each."""
    rigs = deque(recording.rigs())
    for message in recording.messages():
        while rigs and message.kind.schema not in UNNUMBERED and message.sequence >= rigs[0][0]:
            publisher.rig_payload = encode_rig(rigs.popleft()[1])
        yield message


def _solved(recording: Recording, rig: Rig) -> Iterator[Message]:
    """The messages that the recorded frames make with this rig, at the frames' own times."""
    from asterism.protocol.camera import check_image_size
    from asterism.server.chain.frame import Frame
    from asterism.server.chain.pipeline import localize
    from asterism.server.command.recorded_film import film_messages
    from asterism.server.pose.track import Tracks
    from asterism.server.service.events import Events

    tracks, events = Tracks.none(), Events(rig.camera.name)
    for image, exposed_ns, index in recording.frames():
        check_image_size(rig.camera, image.shape[1], image.shape[0], f"{recording.path}, frame {index}")
        frame = Frame(image, exposed_ns, index, f"{index:06d}", exposed_ns)
        result, tracks = localize(frame, rig, tracks)
        yield from film_messages(frame, result, rig, events)


def _step(step_ns: int) -> str:
    if step_ns < 0:
        return f"the recording's clock was set back by {-step_ns * 1e-9:.1f} s here"
    return f"for {step_ns * 1e-9:.1f} s nothing was recorded here, or the clock was set"


def _play(messages: Iterator[Message], publisher: Publisher, clock: PlayClock, stop: Stop) -> int:
    """Publish messages, spaced as their publish times are, in a session of this play; returns how many.

    Where the recording's clock was set, or nothing was recorded, the play goes on at once, in a session of its own.
    """
    count, before_ns = 0, 0
    for message in messages:
        step_ns = message.publish_ns - before_ns
        if not count or step_ns < -BACK_NS or step_ns > LONGEST_GAP_NS:
            if count:
                say(f"{_step(step_ns)}; the replay goes on at once")
            clock.begin(message.publish_ns)
        before_ns = message.publish_ns
        while (left_ns := message.publish_ns - clock.now_ns()) > 0 and not stop():
            time.sleep(min(left_ns * 1e-9 / clock.rate, 0.05))
        if stop():
            break
        publisher.put(in_session(message, clock.session))
        count += 1
        if message.kind.schema == FRAME_REPORT.schema:
            report = decode_frame_report(message.payload)
            publisher.show_visible(robot.id for robot in report.robots if robot.state in LOCATED)
    publisher.show_visible(())
    return count
