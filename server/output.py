"""What commands write: nothing is overwritten unasked, and nothing half-written stands under its final name.

One rule for files and folders. What is not there is made, but the folder around it must be there. What is there is
refused, an empty folder is not; with --force the new takes its place as soon as it is whole, and the old one is kept
beside as NAME.old-1 (-2, ...). Until then a file is NAME.partial, and a folder's contents lie in NAME/.partial, which
the next run replaces. Everything that can be known before the work is checked before it.
"""

import contextlib
import errno
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from asterism.protocol.errors import InputError, WorldError

PARTIAL = ".partial"
NOTHING = "nothing was written"


@dataclass(slots=True)
class Output:
    """A file or folder in the making: ``path`` is where to write it; ``kept`` is where the old one is, in the end."""

    path: Path
    kept: Path | None = None

    @property
    def note(self) -> str:
        """What to add to the sentence that says what was written."""
        return f"; the old one is kept as {self.kept}" if self.kept else ""


def check_file(path: Path, force: bool) -> None:
    """Refuse a file that cannot or must not be written.

    Raises InputError for one that exists (unless ``force``), a folder, a missing or unwritable folder around it;
    WorldError when the disk is full.
    """
    if str(path) == "-":
        raise InputError("-: is the terminal, expected the name of a file")
    mode = _mode(path)
    if mode is not None and stat.S_ISDIR(mode):
        raise InputError(f"{path}: is a folder, expected the name of a file")
    if mode is not None and not stat.S_ISREG(mode):
        return  # /dev/null, a pipe
    if mode is not None and not force:
        raise InputError(f"{path}: exists; choose another name, or --force to replace it (the old one is kept beside)")
    _check_around(path)


def check_folder(path: Path, force: bool) -> None:
    """Refuse a folder that cannot or must not be filled; raises as `check_file` does. An empty one is welcome."""
    if _folder_mode(path) is None:
        _check_around(path)
    elif not _holds_something(path):
        _try_to_write(path, path)
    elif not force:
        raise InputError(
            f"{path}: exists already, expected a new or empty folder, or --force to replace it (the old one is kept "
            "beside)"
        )
    elif Path.cwd().is_relative_to(path.resolve()):
        raise InputError(f"{path}: is the folder you are in, or holds it; --force does not replace that")
    else:
        _check_around(path)


def check_folder_of_many(path: Path) -> None:
    """Refuse a folder in which new ones cannot be made, as recordings are; raises as `check_file` does."""
    if _folder_mode(path) is None:
        _check_around(path)
    else:
        _try_to_write(path, path)


@contextlib.contextmanager
def new_file(path: Path, force: bool, keep: bool = False) -> Iterator[Output]:
    """The file ``path`` in the making; what the block has written takes its name when the block ends.

    When the block fails or is interrupted, what is there is removed, or with ``keep`` (half of it is of use) kept as
    NAME.partial; a note in the exception says which. Raises as `check_file` does, WorldError when it cannot be written.
    """
    check_file(path, force)
    real = path.resolve()
    if real.exists() and not real.is_file():
        with _world_errors(path, path):  # such as /dev/full
            yield Output(path)
        return
    output = Output(real.with_name(real.name + PARTIAL))
    try:
        with _world_errors(path, output.path):
            output.path.unlink(missing_ok=True)
            yield output
            output.kept = _set_aside(path, real, force)
            output.path.replace(real)
    except BaseException as error:
        if keep and output.path.exists() and output.path.stat().st_size:
            error.add_note(f"what was done so far is in {path}{PARTIAL}")
        else:
            output.path.unlink(missing_ok=True)
            _note_interruption(error)
        raise


@contextlib.contextmanager
def new_folder(path: Path, force: bool) -> Iterator[Output]:
    """The folder ``path`` in the making; what the block has written is in it when the block ends, otherwise nothing.

    Raises as `check_folder` does, WorldError when it cannot be written.
    """
    check_folder(path, force)
    made = not path.exists()
    output = Output(path / PARTIAL)
    try:
        with _world_errors(path, path):
            path.mkdir(exist_ok=True)
            shutil.rmtree(output.path, ignore_errors=True)
            output.path.mkdir()
            yield output
            _fill(path, output)
    except BaseException as error:
        shutil.rmtree(output.path, ignore_errors=True)
        if made:
            with contextlib.suppress(OSError):
                path.rmdir()
        _note_interruption(error)
        raise


def _note_interruption(error: BaseException) -> None:
    """Where the input or the disk is wrong, it goes without saying."""
    if isinstance(error, KeyboardInterrupt):
        error.add_note(NOTHING)


def _fill(path: Path, output: Output) -> None:
    """Give the folder what was written, after what was in it has been set aside as a whole."""
    partial = output.path
    if _holds_something(path):
        output.kept = free_name(path)
        path.rename(output.kept)
        path.mkdir()
        partial = output.kept / PARTIAL
    for entry in partial.iterdir():
        entry.rename(path / entry.name)
    partial.rmdir()


def _set_aside(path: Path, real: Path, force: bool) -> Path | None:
    """Keep the file that is there under another name; at no moment there is none of its own name, if the disk can."""
    if not real.exists():
        return None
    if not force:
        raise InputError(f"{path}: exists by now; choose another name")
    kept = free_name(real)
    try:
        kept.hardlink_to(real)
    except OSError:  # such as on a memory stick
        real.rename(kept)
    return kept if path.is_symlink() else path.with_name(kept.name)


def free_name(path: Path) -> Path:
    """The name beside ``path`` under which an old one is kept."""
    number = 1
    while (kept := path.with_name(f"{path.name}.old-{number}")).exists():
        number += 1
    return kept


@contextlib.contextmanager
def _world_errors(path: Path, written: Path) -> Iterator[None]:
    """Errors of the disk while ``written`` is written, as sentences about ``path``; those about other files are not."""
    try:
        yield
    except OSError as error:
        other = isinstance(error.filename, str) and not Path(error.filename).is_relative_to(written)
        if other or isinstance(error, BrokenPipeError):
            raise
        raise WorldError(f"{path}: cannot be written ({error.strerror or error})") from None


def _mode(path: Path) -> int | None:
    """What is there (st_mode), None for nothing."""
    try:
        return path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None


def _folder_mode(path: Path) -> int | None:
    mode = _mode(path)
    if str(path) == "-":
        raise InputError("-: is the terminal, expected the name of a folder")
    if mode is not None and not stat.S_ISDIR(mode):
        raise InputError(f"{path}: is a file, expected a new or empty folder")
    return mode


def _holds_something(folder: Path) -> bool:
    try:
        return any(entry.name != PARTIAL for entry in folder.iterdir())
    except OSError as error:
        raise InputError(f"{folder}: cannot be read ({error.strerror})") from None


def _check_around(path: Path) -> None:
    folder = path.resolve().parent
    mode = _mode(folder)
    if mode is None:
        raise InputError(f"{path}: there is no folder {path.parent}")
    if not stat.S_ISDIR(mode):
        raise InputError(f"{path}: {path.parent} is a file, expected a folder")
    _mode(path.with_name(path.name + PARTIAL))  # a name that is too long is refused as such
    _try_to_write(folder, path)


def _try_to_write(folder: Path, path: Path) -> None:
    """Write to the folder, and leave nothing: permissions, read-only and full disks show in no other way as surely."""
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(bytes(4096))
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        raise (WorldError if full else InputError)(f"{path}: cannot be written ({error.strerror})") from None
