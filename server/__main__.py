"""The command line: `asterism COMMAND ...`. Only what a command needs is imported, so `--help` is there at once."""

import argparse
import contextlib
import errno
import logging
import shlex
import signal
import sys
import time
from collections.abc import Iterator, Sequence

from asterism import __version__
from asterism.protocol.errors import InputError, WorldError
from asterism.server.command.installed import missing_module, older_install
from asterism.server.command.parser import module_of, parser
from asterism.server.output import NOTHING
from asterism.server.service.say import complain, say
from asterism.server.service.telling import Telling, telling

# Of a file that was named: nothing is wrong with the world.
NAMED_WRONGLY = (errno.ENOENT, errno.EISDIR, errno.ENOTDIR, errno.ENAMETOOLONG, errno.ELOOP, errno.EACCES)

_LOG = logging.getLogger(__name__)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code: 0 done, 1 the world failed, 2 the user's input is wrong."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    for stream in (sys.stdout, sys.stderr):
        # Names of files may be no UTF-8, and terminals may know less than UTF-8.
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
    with telling() as told, _in_one_go(alone=arguments is None):
        options = argparse.Namespace(out=None)
        try:
            parser(words).parse_args(words, options)
            return _run(options, words, told)
        except (InputError, WorldError, OSError, MemoryError, ModuleNotFoundError, KeyboardInterrupt) as error:
            code, text = _failure(error, words)
            _LOG.debug("how it came about", exc_info=error)
            notes = getattr(error, "__notes__", [])
            if isinstance(error, KeyboardInterrupt) and not notes and options.out and not options.out.exists():
                notes = [NOTHING]
            if text:
                complain(" ".join("; ".join([text, *notes]).split("\n")))
            return code


@contextlib.contextmanager
def _in_one_go(alone: bool) -> Iterator[None]:
    """Where this is the process' only work: once it is done, one more Ctrl-C cannot disturb how Python ends."""
    yield
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        if alone and hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)


def _run(options: argparse.Namespace, words: list[str], told: Telling) -> int:
    told.choose(options.quiet, options.verbose, options.log)
    _LOG.debug("asterism %s, Python %s: asterism %s", __version__, sys.version.split()[0], shlex.join(words))
    if older := older_install(sys.path):
        say(older)
    began = time.monotonic()
    code: int = module_of(options.command).run(options)
    _LOG.debug("done after %.1f s, exit code %d", time.monotonic() - began, code)
    return code


def _failure(error: BaseException, words: list[str]) -> tuple[int, str]:
    """The exit code of what ended a command, and the sentence about it; an error of ours is raised again."""
    match error:
        case InputError():
            return 2, str(error)
        case WorldError():
            return 1, str(error)
        case ModuleNotFoundError():
            if text := missing_module(error.name or "", words):
                return 2, text
            raise error
        case KeyboardInterrupt():
            return 130, "interrupted"
        case BrokenPipeError():
            return 1, ""
        case MemoryError():
            return 1, "there is not enough memory for this"
        case OSError():
            name = f"{error.filename}: " if error.filename else ""
            return 2 if error.filename and error.errno in NAMED_WRONGLY else 1, f"{name}{error.strerror or error}"
    raise error


if __name__ == "__main__":
    sys.exit(main())
