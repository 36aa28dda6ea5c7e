"""One input after another within bounds: processor time, and memory beyond what the process had before."""

import contextlib
import resource
import signal
from collections.abc import Iterator
from pathlib import Path

MOST_S = 1.0  # of processor time: a busy machine takes none away
MOST_KB = 300 << 10
_PEAK = Path("/proc/self/clear_refs")


class TooMuch(BaseException):
    """An input took more than it may; no handler of exceptions in between takes it for its own."""


@contextlib.contextmanager
def bounded() -> Iterator[None]:
    """Raises TooMuch in its body after `MOST_S`, at its end where memory grew by more than `MOST_KB` meanwhile."""
    before_kb = _peak_kb()

    def late(*_: object) -> None:
        raise TooMuch(f"more than {MOST_S} s")

    handler = signal.signal(signal.SIGPROF, late)
    signal.setitimer(signal.ITIMER_PROF, MOST_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, handler)
    grown_kb = _peak_kb() - before_kb
    if grown_kb > MOST_KB:
        forget_peak()
        raise TooMuch(f"{grown_kb >> 10} MB more memory")


def forget_peak() -> None:
    """Memory that was taken and given back before counts no more, where the system can do that."""
    with contextlib.suppress(OSError):
        _PEAK.write_text("5")


def _peak_kb() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
