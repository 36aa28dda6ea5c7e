"""How a run ends before its time: by Ctrl-C, a signal, or whoever ends it."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager


class Stop:
    """Set by Ctrl-C, a signal, or whoever ends the run.

    It holds no lock: a signal's handler sets it, which may interrupt another one that does.
    """

    def __init__(self) -> None:
        self._stopped = False
        self.interrupted = False  # by a person or a signal, before its time

    def interrupt(self) -> None:
        """End the run for a signal."""
        self.interrupted = True
        self.set()

    def set(self) -> None:
        """End the run after the frame in work."""
        self._stopped = True

    def __call__(self) -> bool:
        return self._stopped


@contextmanager
def stop_on_signals(stop: Stop) -> Iterator[None]:
    """Let Ctrl-C, SIGTERM and a terminal that closes end the run cleanly, however often they come.

    SIGHUP stays ignored where it is: somebody wanted the program to outlive its terminal.
    """
    numbers = [signal.SIGINT, signal.SIGTERM]
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        numbers.append(signal.SIGHUP)
    before = {number: signal.signal(number, lambda *_: stop.interrupt()) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
