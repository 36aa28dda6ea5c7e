"""Where everything that is said and logged goes: the terminal's error channel, and with --log a file as well."""

import contextlib
import logging
import logging.handlers
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO, cast

from asterism.protocol.errors import InputError
from asterism.server.service.lasting import Lasting
from asterism.server.service.say import SAID

LOGGER = logging.getLogger("asterism")
WARNINGS = logging.getLogger("py.warnings")
# Foxglove's SDK tells of clients that it drops; without a handler Python prints that as if nobody had said it.
TAKEN = (LOGGER, WARNINGS, logging.getLogger("foxglove"))
_TRACE = logging.Formatter()


class _Terminal(logging.Handler):
    """Lines on stderr, whatever that is at the moment: a live display puts itself before it."""

    def emit(self, record: logging.LogRecord) -> None:
        """One line: what is said as it is, what is logged with its logger's name."""
        if record.name == WARNINGS.name and self.level > logging.DEBUG:
            return  # libraries' warnings to programmers
        text = record.getMessage()
        if record.name != SAID:
            text = f"{record.name.removeprefix('asterism.')}: {text}"
        if record.exc_info:
            text = f"{text}\n{_TRACE.formatException(record.exc_info)}"
        print(f"asterism: {text}", file=sys.stderr, flush=True)


class _File(logging.handlers.WatchedFileHandler):
    """Lines with UTC times, each whole on the disk; begun anew where the file was moved or removed, as by logrotate.

    A disk that is full, or a folder that is gone, must not end the work: lines are lost until it is back.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path, encoding="utf-8", errors="backslashreplace")
        formatter = logging.Formatter(
            "%(asctime)s.%(msecs)03dZ %(levelname)s %(name)s: %(message)s", "%Y-%m-%dT%H:%M:%S"
        )
        formatter.converter = time.gmtime
        self.setFormatter(formatter)

    def emit(self, record: logging.LogRecord) -> None:
        """One line."""
        with contextlib.suppress(OSError):
            super().emit(record)

    def handleError(self, record: logging.LogRecord) -> None:
        """Go on without."""

    def close(self) -> None:
        """Let go of the file, also where its last lines found no room."""
        with contextlib.suppress(OSError):
            super().close()


_TERMINAL = _Terminal()


def shows_progress() -> bool:
    """Whether there is somebody to show how far the work is: a terminal, without --quiet."""
    return sys.stderr.isatty() and _TERMINAL.level <= logging.INFO


class Telling:
    """What is told, and where."""

    def __init__(self) -> None:
        self._file: _File | None = None

    def choose(self, quiet: bool, verbose: bool, log: Path | None) -> None:
        """As the command's options ask. Raises InputError for a log that cannot be written."""
        _TERMINAL.setLevel(logging.ERROR if quiet else logging.DEBUG if verbose else logging.INFO)
        LOGGER.setLevel(logging.DEBUG if verbose else logging.INFO)
        if log is not None:
            try:
                self._file = _File(log)
            except OSError as error:
                raise InputError(f"--log {log}: cannot be written ({error.strerror})") from None
            for logger in TAKEN:
                logger.addHandler(self._file)

    def close(self) -> None:
        """Let go of the log."""
        if self._file is not None:
            for logger in TAKEN:
                logger.removeHandler(self._file)
            self._file.close()


@contextlib.contextmanager
def telling() -> Iterator[Telling]:
    """For one command: say on the terminal, until `Telling.choose` says otherwise."""
    told = Telling()
    told.choose(quiet=False, verbose=False, log=None)
    logging.captureWarnings(True)
    with _lasting_stderr():
        for logger in TAKEN:
            logger.addHandler(_TERMINAL)
        try:
            yield told
        finally:
            told.close()
            for logger in TAKEN:
                logger.removeHandler(_TERMINAL)
            logging.captureWarnings(False)


@contextlib.contextmanager
def _lasting_stderr() -> Iterator[None]:
    """An error channel that may be lost, or was closed before we were started."""
    before = sys.stderr
    with Path(os.devnull).open("w", encoding="utf-8") as nowhere:
        lasting = Lasting(before or nowhere)
        sys.stderr = cast(TextIO, lasting)
        try:
            yield
        finally:
            lasting.finish()
            sys.stderr = before
