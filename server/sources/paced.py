"""Files played in real time."""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace

from asterism.protocol.messages import Clock
from asterism.server.chain.frame import Frame
from asterism.server.sources.session_clock import SessionClock

# A server tells its status every second: nothing for so long is no part of what happened, and is not waited for, ...
LONGEST_GAP_NS = 3_000_000_000
USUAL = 10  # ... unless frames were as rare as that already, within this factor


def paced(
    frames: Iterator[Frame], rate_hz: float | None, stop: Callable[[], bool], clock: SessionClock
) -> Iterator[Frame]:
    """Play frames of a file in real time, stamped by ``clock`` when they are played.

    Their own spacing in time is kept, or ``rate_hz`` if it is given; a chain that is too slow delays, it drops
    nothing. Where the clock that stamped them was set, or nothing was taken for long, the play goes on at once. Ends
    early when ``stop`` says so.
    """
    start_ns = time.perf_counter_ns()
    for count, (frame, played_s) in enumerate(_own_times(frames)):
        due_s = count / rate_hz if rate_hz is not None else played_s
        if not wait(start_ns + round(due_s * 1e9), time.perf_counter_ns, stop):
            return
        session = clock.session
        now_ns = clock.now_ns(session)
        yield replace(frame, exposed_ns=now_ns, arrived_ns=now_ns, clock=Clock.PLAYED, session=session)


def wait(due_ns: int, now_ns: Callable[[], int], stop: Callable[[], bool]) -> bool:
    """Until it is due by that clock, or ``stop`` says so; returns whether to go on."""
    while (left_ns := due_ns - now_ns()) > 0 and not stop():
        time.sleep(min(left_ns * 1e-9, 0.05))
    return not stop()


def _own_times(frames: Iterator[Frame]) -> Iterator[tuple[Frame, float]]:
    """Frames with when they are played at their own spacing, s from the first."""
    played_ns, usual_ns, before_ns = 0, 0, None
    for frame in frames:
        gap_ns = 0 if before_ns is None else frame.exposed_ns - before_ns
        before_ns = frame.exposed_ns
        if gap_ns < 0 or (usual_ns and gap_ns > max(LONGEST_GAP_NS, USUAL * usual_ns)):
            gap_ns = usual_ns
        elif gap_ns:
            usual_ns = gap_ns
        played_ns += gap_ns
        yield frame, played_ns * 1e-9
