"""What may take seconds and nobody waits for: letting go of cameras that do not answer."""

import atexit
import threading
import time
from collections.abc import Callable

LONGEST_S = 2.0  # that the program's end waits: a camera that is let go of properly is free for the next one

_running: list[threading.Thread] = []


def in_background(work: Callable[[], None]) -> threading.Thread:
    """Do it in a thread of its own, which is returned."""
    _running[:] = [thread for thread in _running if thread.is_alive()]
    thread = threading.Thread(target=work, name="letting-go", daemon=True)
    _running.append(thread)
    thread.start()
    return thread


@atexit.register
def wait_for_background(longest_s: float = LONGEST_S) -> None:
    """Wait for all of it, not longer than so."""
    until_s = time.monotonic() + longest_s
    for thread in list(_running):
        thread.join(max(until_s - time.monotonic(), 0.0))
