"""Writing what a calibration found: nothing is overwritten unasked, and what was there is kept beside."""

from pathlib import Path

from asterism.protocol.errors import InputError, WorldError
from asterism.protocol.text_file import MOST_BYTES, read_bytes
from asterism.server.output import check_file, free_name, new_file
from asterism.server.simulation.measured_rig import TRUTH_MARK


def check_result_file(path: Path, force: bool) -> None:
    """Refuse, before any work is done, a path that holds something already or that cannot be written.

    Raises InputError, and WorldError when the disk is full.
    """
    if holds_truth(path):
        raise InputError(
            f"{path}: holds the truth of a simulation, which nothing measured may replace, not with --force either; "
            "choose another name"
        )
    check_file(path, force)


def holds_truth(path: Path) -> bool:
    """Whether a file says of itself that it is a simulation's truth, as those of `asterism example` do.

    Only a regular file of a text's size is read: a pipe would hang, and /dev/full has no end.
    """
    try:
        data = read_bytes(path, "a rig", MOST_BYTES)
    except (OSError, InputError):  # none there, or nothing that can be read: whatever it is, others refuse it
        return False
    return TRUTH_MARK.encode() in data.splitlines()


def write_result_file(path: Path, text: str, force: bool) -> Path | None:
    """Write ``text`` (UTF-8) to ``path``, whole or not at all; returns where the file that was
    there is kept, if one was. What was made from a simulation's truth is no truth any more, and loses its mark.

    Raises InputError as `check_result_file` does, WorldError if the disk does not take it.
    """
    check_result_file(path, force)
    with new_file(path, force) as output:
        output.path.write_text(text.replace(f"{TRUTH_MARK}\n", ""), encoding="utf-8")
    return output.kept


def set_aside(path: Path) -> Path | None:
    """Give the file at ``path``, if there is one, the name under which an old one is kept; returns that.

    Raises WorldError if the disk does not take it.
    """
    if not path.exists():
        return None
    kept = free_name(path)
    try:
        path.rename(kept)
    except OSError as error:
        raise WorldError(f"{path}: cannot be renamed ({error.strerror})") from None
    return kept
