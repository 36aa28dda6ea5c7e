"""Reading files that people name: nothing that hangs, nothing without end, a sentence for what is no such file."""

import os
import stat
from pathlib import Path

from asterism.protocol.errors import InputError

MOST_BYTES = 4 << 20  # of a text that a person writes or a calibration does


def read_text(path: Path, what: str, most_bytes: int = MOST_BYTES) -> str:
    """The text of a file in UTF-8; ``what`` is what sentences expect it to be.

    Raises InputError when there is no such file, when it is none (a folder, a pipe, a device), longer than
    ``most_bytes``, not to be read, or no text.
    """
    try:
        data = read_bytes(path, what, most_bytes)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except ValueError:
        raise InputError(f"{str(path)!r}: is no name of a file, expected {what}") from None
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        raise InputError(f"{path}: is no text in UTF-8, expected {what}") from None


def read_bytes(path: Path, what: str, most_bytes: int) -> bytes:
    """The bytes of a file. Raises InputError as `read_text` does, OSError when it cannot be read."""
    try:
        # Without waiting: opening a pipe would hang until somebody writes to it.
        handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    try:
        found = os.fstat(handle)
        if stat.S_ISDIR(found.st_mode):
            raise InputError(f"{path}: is a folder, expected {what}")
        if not stat.S_ISREG(found.st_mode):
            raise InputError(f"{path}: is no regular file (a pipe, a device?), expected {what}")
        with os.fdopen(handle, "rb", closefd=False) as stream:
            data = stream.read(min(found.st_size, most_bytes) + 1)  # room is made for what is asked for
    finally:
        os.close(handle)
    if len(data) > most_bytes:
        raise InputError(f"{path}: is longer than {_size(most_bytes)}, expected {what}")
    return data


def _size(count: int) -> str:
    return f"{count >> 20} MB" if count >= 1 << 20 else f"{count} bytes"
