"""asterism review: a recording in the rerun viewer, with views laid out."""

import argparse
import os
import subprocess
import sys
import tempfile
from collections import deque
from collections.abc import Callable
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from asterism.protocol.codec import decode_image
from asterism.protocol.errors import InputError
from asterism.protocol.messages import EVENT, FRAME_REPORT, IMAGE
from asterism.protocol.rig import Rig
from asterism.recordings.decodable import read_event, read_report
from asterism.recordings.drawing import APPLICATION, Drawing
from asterism.recordings.layout import review_blueprint
from asterism.recordings.reader import Recording
from asterism.server.command.progress import progress
from asterism.server.command.shared_arguments import add_out, add_recording
from asterism.server.output import check_file, new_file

EXAMPLES = "asterism review RECORDING\nasterism review RECORDING -o recording.rrd\n"


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add_recording(part)
    add_out(part, "FILE.rrd", "write it instead of opening the viewer", required=False)


def run(options: argparse.Namespace) -> int:
    """Write the rerun recording to -o, or to a temporary file that the viewer opens."""
    if options.out is not None:
        if options.out.suffix != ".rrd":
            raise InputError(f"{options.out}: expected a file name ending in .rrd")
        check_file(options.out, options.force)
    recording = Recording(options.recording)
    if options.out is not None:
        with new_file(options.out, options.force) as output:
            write_rrd(recording, output.path)
        print(f"{options.out}: open it with: rerun {options.out}{output.note}")
        return 0
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise InputError("there is no display for the viewer; write a file instead: -o FILE.rrd")
    with tempfile.TemporaryDirectory(prefix="asterism-review-") as folder:
        file = Path(folder) / f"{options.recording.name}.rrd"
        write_rrd(recording, file)
        # The viewer would otherwise listen on every network interface.
        return subprocess.run([sys.executable, "-m", "rerun", "--bind", "127.0.0.1", str(file)], check=False).returncode


def write_rrd(recording: Recording, out: Path, views: Callable[[Rig], rrb.Blueprint] = review_blueprint) -> None:
    """Draw a whole recording into a rerun file, its ``views`` laid out for the rig that was in force last."""
    rigs = deque(recording.rigs())
    layout = views(rigs[-1][1])
    stream = rr.RecordingStream(APPLICATION, recording_id=recording.path.name)
    stream.save(out, default_blueprint=layout)
    drawing = Drawing(stream, rigs.popleft()[1])
    total = recording.count_messages() + recording.count_frames()
    for message in progress(recording.messages_and_images(), total, "drawing"):
        if rigs and message.kind.schema in (IMAGE.schema, FRAME_REPORT.schema) and message.sequence >= rigs[0][0]:
            drawing = drawing.replaced_by(rigs.popleft()[1])
        if message.kind.schema == IMAGE.schema:
            drawing.image(decode_image(message.payload), message.log_ns, message.sequence)
        elif message.kind.schema == FRAME_REPORT.schema:
            drawing.report(read_report(message.payload, recording.path))
        elif message.kind.schema == EVENT.schema:
            drawing.event(read_event(message.payload, recording.path))
    stream.flush()
    stream.disconnect()
