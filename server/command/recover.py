"""asterism recover: make a recording whole that was cut off or damaged."""

import argparse
import contextlib

from asterism.recordings.held import held_for_recovery
from asterism.recordings.mend import UNFINISHED, mend
from asterism.recordings.reader import recording_files
from asterism.recordings.room import RESERVE
from asterism.server.command.shared_arguments import add_recording

EXAMPLES = "asterism recover RECORDING\n"


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add_recording(part)


def run(options: argparse.Namespace) -> int:
    """Mend what is damaged, say what is lost; what is whole is left alone, what another process writes is refused."""
    with held_for_recovery(options.recording):
        return _recover(options)


def _recover(options: argparse.Namespace) -> int:
    poses, frames = recording_files(options.recording)
    for mended in mend(poses + frames):
        print(mended)
    # What a server that was killed, or a recover, left behind.
    for left in (options.recording / RESERVE, *options.recording.glob(f"*.mcap{UNFINISHED}")):
        with contextlib.suppress(OSError):
            left.unlink()
    return 0
