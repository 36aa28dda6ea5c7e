"""How this program was started: hints name commands in words that work when they are typed as printed."""

import shlex
import shutil
import sys
from functools import cache
from pathlib import Path

NAME = "asterism"


@cache
def program() -> str:
    """What to type for `asterism`: as it was typed, or plainly so where that is found and is the same program."""
    return program_of(sys.argv[0], sys.orig_argv[0])


def program_of(started: str, python: str) -> str:
    """The same for ``started``, the first word of the command line, and ``python``, what runs it, as it was typed.

    A program that only uses Asterism's modules is told the plain name.
    """
    path = Path(started)
    if path.name == "__main__.py" and path.parent.name in (NAME, "server"):
        return f"{shlex.quote(python)} -m {NAME}"
    if path.stem != NAME:
        return NAME
    found = shutil.which(NAME)
    if found is not None and path.exists() and Path(found).resolve() == path.resolve():
        return NAME
    return shlex.quote(started)


def typed(*words: object) -> str:
    """A command of this program with its arguments, quoted for a shell where they must be."""
    return " ".join([program(), *(shlex.quote(str(word)) for word in words)])
