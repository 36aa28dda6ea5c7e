"""Files played against the clock."""

import time
from collections.abc import Callable, Iterator

from asterism.server.chain.frame import Frame


def paced(frames: Iterator[Frame], rate_hz: float | None, stop: Callable[[], bool]) -> Iterator[Frame]:
    """Play frames of a file against the clock, stamped when they are played.

    Their own spacing in time is kept, or ``rate_hz`` if it is given; a chain that is too slow delays, it drops
    nothing. Ends early when ``stop`` says so.
    """
    start = time.perf_counter()
    first: Frame | None = None
    for count, frame in enumerate(frames):
        first = first or frame
        own = (frame.exposed_ns - first.exposed_ns) * 1e-9
        due = start + (count / rate_hz if rate_hz is not None else own)
        while (left := due - time.perf_counter()) > 0 and not stop():
            time.sleep(min(left, 0.05))
        if stop():
            return
        now = time.time_ns()
        yield Frame(frame.image, now, frame.index, frame.name, now)
