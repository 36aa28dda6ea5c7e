"""asterism recover: rebuild the index of a recording that was cut off."""

import argparse

from asterism.protocol.errors import InputError, WorldError
from asterism.recordings.held import held_for_recovery
from asterism.recordings.index import begins_as_mcap, is_complete, rebuild_index
from asterism.recordings.reader import recording_files
from asterism.recordings.recorder import RESERVE
from asterism.server.command.shared_arguments import add_recording

EXAMPLES = "asterism recover RECORDING\n"


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add_recording(part)


def run(options: argparse.Namespace) -> int:
    """Recover what is cut off; what is whole is left alone, what another process writes is refused."""
    with held_for_recovery(options.recording):
        return _recover(options)


def _recover(options: argparse.Namespace) -> int:
    poses, frames = recording_files(options.recording)
    for file in poses + frames:
        if not begins_as_mcap(file):
            raise InputError(f"{file}: is no MCAP file, expected what asterism recorded")
    for file in poses + frames:
        if is_complete(file):
            print(f"{file.name}: whole")
            continue
        try:
            rebuilt = rebuild_index(file)
        except OSError as error:
            raise WorldError(f"{file}: cannot be written ({error.strerror})") from None
        damaged = f", {rebuilt.damaged_chunks} damaged chunks left out" if rebuilt.damaged_chunks else ""
        seconds = (rebuilt.last_ns - rebuilt.first_ns) * 1e-9
        print(
            f"{file.name}: {rebuilt.messages} messages over {seconds:.2f} s kept, "
            f"{rebuilt.cut_bytes} bytes cut off{damaged}"
        )
    (options.recording / RESERVE).unlink(missing_ok=True)
    return 0
