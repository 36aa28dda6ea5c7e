"""An outlet in a thread of its own: what it takes is taken from the chain no more than handing it over."""

from collections.abc import Callable
from functools import partial

from asterism.protocol.messages import Message
from asterism.protocol.rig import Rig
from asterism.server.chain.frame import Frame
from asterism.server.service.backlog import Backlog
from asterism.server.service.outlets import Outlet
from asterism.server.service.say import say


class Aside:
    """Hands everything on to ``outlet``, in order; where it does not keep up, the oldest of ``most`` is dropped, which
    is said in the end.
    """

    def __init__(self, outlet: Outlet, name: str, most: int = 10) -> None:
        self._outlet = outlet
        self._name = name
        self._backlog: Backlog[Callable[[], None]] = Backlog(lambda call: call(), name, most)

    def write(self, messages: list[Message], frame: Frame) -> None:
        """When it is this frame's turn."""
        self._backlog.give(partial(self._outlet.write, messages, frame))

    def status(self, messages: list[Message]) -> None:
        """When it is its turn."""
        self._backlog.give(partial(self._outlet.status, messages))

    def take_rig(self, rig: Rig) -> None:
        """For the frames that come after it."""
        self._backlog.give(partial(self._outlet.take_rig, rig))

    def close(self) -> None:
        """When what waits is handed on."""
        self._backlog.close()
        self._outlet.close()
        if self._backlog.dropped:
            say(f"{self._name} did not keep up: {self._backlog.dropped} frames or messages were left out")
