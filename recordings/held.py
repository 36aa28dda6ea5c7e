"""Who writes a recording, a server or a recovery: a file in its folder that is locked as long as its process lives, and
removed in the end.

Where that file is left and not locked, the recording was cut off. Some network disks know no locks.
"""

import contextlib
import json
import os
import stat
from collections.abc import Iterator
from pathlib import Path

from asterism.protocol.errors import InputError

WRITER = ".writer"
_MOST_BYTES = 4096  # that such a file holds


class Hold:
    """A recording's folder is held by this process until `release`, or its end."""

    def __init__(self, path: Path, file: int) -> None:
        self._path = path
        self._file = file

    def release(self, whole: bool = True) -> None:
        """Let go of it; one that is not ``whole`` stays marked as cut off."""
        if whole:
            with contextlib.suppress(OSError):
                self._path.unlink()
        os.close(self._file)


@contextlib.contextmanager
def held_for_recovery(folder: Path) -> Iterator[None]:
    """Hold a recording while it is recovered. Raises InputError where another process holds it."""
    marked = os.path.lexists(folder / WRITER)
    try:
        held = hold(folder)
    except OSError:  # no folder, or one that cannot be written: not for us to say
        _refuse_held(folder)
        yield
        return
    whole = False
    try:
        yield
        whole = True
    finally:
        held.release(whole or not marked)


def hold(folder: Path, camera: str | None = None) -> Hold:
    """Hold a recording of that camera (none: of whichever it was before).

    Raises InputError where another process holds it, OSError where the disk does not let it be held.
    """
    import fcntl

    path = folder / WRITER
    while True:
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK, 0o644)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if _is(path, file):  # else its holder removed it meanwhile
                told = _told(file) | {"pid": os.getpid()} | ({} if camera is None else {"camera": camera})
                os.ftruncate(file, 0)
                os.pwrite(file, json.dumps(told).encode(), 0)
                return Hold(path, file)
        except BlockingIOError:
            refusal = _refusal(folder, file)
            os.close(file)
            raise refusal from None
        except OSError:
            os.close(file)
            raise
        os.close(file)


def cut_off(parent: Path, camera: str) -> list[Path]:
    """The recordings of that camera in ``parent`` that were not finished and that nobody holds, oldest name first."""
    found = []
    for path in sorted(parent.glob(f"*/{WRITER}")):
        with contextlib.suppress(OSError):
            file = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK)
            try:
                if not path.parent.is_symlink() and _told(file).get("camera") == camera and _is_free(file):
                    found.append(path.parent)
            finally:
                os.close(file)
    return found


def _refuse_held(folder: Path) -> None:
    """Raises InputError where somebody whose file we may only read holds it."""
    with contextlib.suppress(OSError):
        file = os.open(folder / WRITER, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK)
        try:
            if not _is_free(file):
                raise _refusal(folder, file)
        finally:
            os.close(file)


def _refusal(folder: Path, file: int) -> InputError:
    pid = _told(file).get("pid")
    who = f"process {pid}" if isinstance(pid, int) else "another process"
    return InputError(
        f"{folder}: is being written by {who}, which records or recovers it; expected a recording that nobody writes: "
        "stop that one first"
    )


def _is(path: Path, file: int) -> bool:
    try:
        return os.path.samestat(path.lstat(), os.fstat(file))
    except FileNotFoundError:
        return False


def _is_free(file: int) -> bool:
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    fcntl.flock(file, fcntl.LOCK_UN)
    return True


def _told(file: int) -> dict[str, object]:
    """What the file says; nothing where it is none of ours."""
    if not stat.S_ISREG(os.fstat(file).st_mode):
        return {}
    try:
        told = json.loads(os.pread(file, _MOST_BYTES, 0))
    except (ValueError, RecursionError):
        return {}
    return told if isinstance(told, dict) else {}
