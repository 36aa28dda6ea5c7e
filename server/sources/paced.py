"""Files played in real time."""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace

from asterism.protocol.messages import Clock
from asterism.server.chain.frame import Frame
from asterism.server.sources.session_clock import SessionClock


def paced(
    frames: Iterator[Frame], rate_hz: float | None, stop: Callable[[], bool], clock: SessionClock
) -> Iterator[Frame]:
    """Play frames of a file in real time, stamped by ``clock`` when they are played.

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
        session = clock.session
        now_ns = clock.now_ns(session)
        yield replace(frame, exposed_ns=now_ns, arrived_ns=now_ns, clock=Clock.PLAYED, session=session)
