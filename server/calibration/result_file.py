"""Writing what a calibration found: nothing is overwritten unasked, and what was there is kept beside."""

from pathlib import Path

from asterism.server.output import check_file, new_file


def check_result_file(path: Path, force: bool) -> None:
    """Refuse, before any work is done, a path that holds something already or that cannot be written.

    Raises InputError, and WorldError when the disk is full.
    """
    check_file(path, force)


def write_result_file(path: Path, text: str, force: bool) -> Path | None:
    """Write ``text`` (UTF-8) to ``path``, whole or not at all; returns where the file that was
    there is kept, if one was.

    Raises InputError as `check_result_file` does, WorldError if the disk does not take it.
    """
    with new_file(path, force) as output:
        output.path.write_text(text, encoding="utf-8")
    return output.kept
