"""Frames of the simulated camera."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from asterism.protocol.messages import Clock
from asterism.protocol.rig import Rig
from asterism.server.chain.frame import Frame
from asterism.server.sources.paced import wait
from asterism.server.sources.session_clock import SessionClock
from asterism.server.sources.source import DEFAULT_RATE_HZ

if TYPE_CHECKING:
    from asterism.server.simulation.simulate import Look


class Simulated:
    """The simulated camera; ``count`` frames, or no end.

    ``common``: its robots are where they are by the time of the world, the same for every camera that looks at them.
    """

    live = False

    def __init__(self, rig: Rig, seed: int = 0, count: int | None = None, look: "Look | None" = None) -> None:
        from asterism.server.simulation.simulate import Scene

        self.name = "sim"
        self.rate_hz = rig.capture.rate_hz or DEFAULT_RATE_HZ
        self.unreadable = 0
        self.length = count
        self._scene = Scene(rig, seed, look)
        self.common = self._scene.table.common

    def frames(self) -> Iterator[Frame]:
        """Frame after frame, rendered when asked for; their times count from 0."""
        index = 0
        while self.length is None or index < self.length:
            yield self._frame(index, index, round(index * 1e9 / self.rate_hz))
            index += 1

    def by_the_clock(self, rate_hz: float | None, stop: Callable[[], bool], clock: SessionClock) -> Iterator[Frame]:
        """Frames at whole multiples of the period since the epoch, each with the robots where they are then.

        So all cameras of one rate expose at once, as if one trigger were wired to them, wherever they are simulated; as
        well as their hosts' clocks agree. What cannot be rendered in time is never exposed. Ends early when ``stop``
        says so.
        """
        period_ns = round(1e9 / (rate_hz or self.rate_hz))
        index, number, session = 0, 0, None
        while (self.length is None or index < self.length) and not stop():
            before, session = session, clock.session
            due = clock.now_ns(session) // period_ns + 1
            number = due if session != before else max(due, number + 1)
            frame = self._frame(index, number, number * period_ns)
            if not wait(frame.exposed_ns, partial(clock.now_ns, session), stop):
                return
            yield replace(frame, arrived_ns=clock.now_ns(session), clock=Clock.PLAYED, session=session)
            index += 1

    def _frame(self, index: int, number: int, exposed_ns: int) -> Frame:
        """``number`` counts the exposures of the scene."""
        image = self._scene.render(number, self._scene.truth(number, exposed_ns * 1e-9))
        return Frame(image, exposed_ns, index, f"{index:06d}", exposed_ns)
