"""The terminal's error channel while a command runs: whoever read it may be gone, and the work goes on."""

import contextlib
import errno
import os
from typing import Any, TextIO

# There is nobody any more, and nobody will come: the reader of a pipe ended, the terminal was closed.
FOR_GOOD = (errno.EPIPE, errno.EIO, errno.EBADF, errno.ENXIO)


class Lasting:
    """A text stream that loses what cannot be written, instead of failing; else it is ``stream``."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write, or lose it."""
        try:
            return self._stream.write(text)
        except OSError as error:
            self._lost(error)
            return len(text)

    def flush(self) -> None:
        """Bring out what was written, or lose it."""
        try:
            self._stream.flush()
        except OSError as error:
            self._lost(error)

    def finish(self) -> None:
        """The last flush: what cannot be written now never will be, and must not change Python's exit code."""
        try:
            self._stream.flush()
        except OSError:
            self._give_up()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def _lost(self, error: OSError) -> None:
        # A full disk may have room again.
        if error.errno in FOR_GOOD:
            self._give_up()

    def _give_up(self) -> None:
        """Lead the channel nowhere, for libraries too, some of which end the process where they cannot write."""
        with contextlib.suppress(OSError):
            number = self._stream.fileno()
            nowhere = os.open(os.devnull, os.O_WRONLY | os.O_CLOEXEC)
            os.dup2(nowhere, number)
            os.close(nowhere)
            self._stream.flush()
