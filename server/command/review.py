"""asterism review: recordings in the rerun viewer, with views laid out."""

import argparse
import contextlib
import os
import subprocess
import sys
import tempfile
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from asterism.protocol.codec import decode_image
from asterism.protocol.errors import InputError
from asterism.protocol.keys import FUSED
from asterism.protocol.messages import EVENT, FRAME_REPORT, IMAGE
from asterism.protocol.rig import Rig
from asterism.recordings.decodable import read_event, read_report
from asterism.recordings.drawing import APPLICATION, Drawing
from asterism.recordings.entities import JOINED, Entities, beside_joined, by_itself
from asterism.recordings.layout import review_blueprint
from asterism.recordings.layout_several import several_blueprint
from asterism.recordings.reader import Recording
from asterism.recordings.tape import Tape, recordings_in, tapes_of
from asterism.server.command.progress import progress
from asterism.server.command.shared_arguments import add_out
from asterism.server.output import check_file, new_file

EXAMPLES = (
    "asterism review RECORDING\n"
    "asterism review RECORDING -o recording.rrd\n"
    "asterism review recordings/left recordings/right recordings/fused\n"
)


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    part.add_argument(
        "recordings",
        metavar="RECORDING",
        nargs="+",
        type=Path,
        help="a recording's folder; of several cameras: theirs, and what asterism fuse --record made of them",
    )
    add_out(part, "FILE.rrd", "write it instead of opening the viewer", required=False)


def run(options: argparse.Namespace) -> int:
    """Write the rerun recording to -o, or to a temporary file that the viewer opens."""
    if options.out is not None:
        if options.out.suffix != ".rrd":
            raise InputError(f"{options.out}: expected a file name ending in .rrd")
        check_file(options.out, options.force)
    write = _writing(options.recordings)
    if options.out is not None:
        with new_file(options.out, options.force) as output:
            write(output.path)
        print(f"{options.out}: open it with: rerun {options.out}{output.note}")
        return 0
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise InputError("there is no display for the viewer; write a file instead: -o FILE.rrd")
    with tempfile.TemporaryDirectory(prefix="asterism-review-") as folder:
        file = Path(folder) / f"{options.recordings[0].resolve().name}.rrd"
        write(file)
        # The viewer would otherwise listen on every network interface.
        return subprocess.run([sys.executable, "-m", "rerun", "--bind", "127.0.0.1", str(file)], check=False).returncode


def _writing(paths: Sequence[Path]) -> Callable[[Path], None]:
    """What writes the rerun file of these recordings. Raises InputError for what is none."""
    folders = [folder for path in paths for folder in recordings_in(path)]
    if len(folders) == 1 and (recording := Recording(folders[0])).rig().camera.name != FUSED:
        return partial(write_rrd, recording)
    return partial(write_several, tapes_of(folders))


def write_rrd(recording: Recording, out: Path, views: Callable[[Rig], rrb.Blueprint] = review_blueprint) -> None:
    """Draw a whole recording into a rerun file, its ``views`` laid out for the rig that was in force last."""
    with _stream(recording.path.name, out, views(recording.rigs()[-1][1])) as stream:
        _draw(recording, None, partial(Drawing, stream))


def write_several(tapes: Sequence[Tape], out: Path) -> None:
    """Draw the recordings of several cameras into one rerun file, each camera in its place in the world.

    Raises InputError for a rig that places no camera.
    """
    cameras = [(tape, tape.parts[-1].recording.rigs()[-1][1], entities) for tape, entities in _placed(tapes)]
    for tape, rig, _ in cameras:
        if rig.T_world_camera is None:
            raise InputError(
                f"{tape.parts[-1].recording.path}: its rig has no `world`, expected where its camera stands, to "
                "show it beside others"
            )
    layout = several_blueprint([(rig, entities) for _, rig, entities in cameras])
    with _stream("+".join(tape.camera for tape in tapes), out, layout) as stream:
        for tape, _, entities in cameras:
            drawing: Drawing | None = None
            for part in tape.parts:
                drawing = _draw(part.recording, drawing, partial(Drawing, stream, entities=entities))


def _placed(tapes: Sequence[Tape]) -> list[tuple[Tape, Entities]]:
    """Robots are drawn as what is joined tells of them, where that is among them, else as each camera does."""
    if any(tape.camera == FUSED for tape in tapes):
        return [(tape, JOINED if tape.camera == FUSED else beside_joined(tape.camera)) for tape in tapes]
    return [(tape, by_itself(tape.camera, storey)) for storey, tape in enumerate(tapes)]


@contextlib.contextmanager
def _stream(name: str, out: Path, layout: rrb.Blueprint) -> Iterator[rr.RecordingStream]:
    stream = rr.RecordingStream(APPLICATION, recording_id=name)
    stream.save(out, default_blueprint=layout)
    yield stream
    stream.flush()
    stream.disconnect()


def _draw(recording: Recording, drawing: Drawing | None, begin: Callable[[Rig], Drawing]) -> Drawing:
    """Draw a recording; ``drawing`` is that of the same camera's recording before."""
    rigs = deque(recording.rigs())
    first = rigs.popleft()[1]
    drawing = begin(first) if drawing is None else drawing.replaced_by(first)
    total = recording.count_messages() + recording.count_frames()
    for message in progress(recording.messages_and_images(), total, f"drawing {first.camera.name}"):
        if rigs and message.kind.schema in (IMAGE.schema, FRAME_REPORT.schema) and message.sequence >= rigs[0][0]:
            drawing = drawing.replaced_by(rigs.popleft()[1])
        if message.kind.schema == IMAGE.schema:
            drawing.image(decode_image(message.payload), message.log_ns, message.sequence)
        elif message.kind.schema == FRAME_REPORT.schema:
            drawing.report(read_report(message.payload, recording.path))
        elif message.kind.schema == EVENT.schema:
            drawing.event(read_event(message.payload, recording.path))
    return drawing
