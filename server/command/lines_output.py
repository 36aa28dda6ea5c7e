"""Where a command's lines go: a file in the making, the terminal, or nowhere."""

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from asterism.server.output import new_file
from asterism.server.service.say import say


@contextlib.contextmanager
def lines_output(path: Path | None, force: bool) -> Iterator[BinaryIO | None]:
    """A stream for lines: `-` is the terminal, None is nowhere. What was written to a file until it failed is kept.

    Raises as `new_file` does.
    """
    if path is None:
        yield None
        return
    if str(path) == "-":
        with os.fdopen(os.dup(sys.stdout.fileno()), "wb") as stream:
            yield stream
        return
    with new_file(path, force, keep=True) as output, output.path.open("wb") as stream:
        yield stream
    if output.kept:
        say(f"{path}: the old one is kept as {output.kept}")
