"""An outlet in a thread of its own: what it takes is taken from the chain no more than handing it over."""

from collections.abc import Callable

from asterism.protocol.messages import Message
from asterism.protocol.rig import Rig
from asterism.server.chain.frame import Frame
from asterism.server.service.backlog import Backlog
from asterism.server.service.outlets import Outlet
from asterism.server.service.say import say


class Aside:
    """Hands everything on to ``outlet``, which was made for ``rig``, in order; where it does not keep up, the oldest of
    ``most`` is dropped, which is said in the end.
    """

    def __init__(self, outlet: Outlet, rig: Rig, name: str, most: int = 10) -> None:
        self._outlet = outlet
        self._rig = self._taken = rig
        self._name = name
        self._backlog: Backlog[tuple[Callable[[], None], Rig]] = Backlog(self._hand_on, name, most)

    def write(self, messages: list[Message], frame: Frame) -> None:
        """When it is this frame's turn."""
        self._backlog.give((lambda: self._outlet.write(messages, frame), self._rig))

    def status(self, messages: list[Message]) -> None:
        """When it is its turn."""
        self._backlog.give((lambda: self._outlet.status(messages), self._rig))

    def take_rig(self, rig: Rig) -> None:
        """With what comes after it."""
        self._rig = rig

    def close(self) -> None:
        """When what waits is handed on."""
        self._backlog.close()
        self._outlet.close()
        if self._backlog.dropped:
            say(f"{self._name} did not keep up: {self._backlog.dropped} frames or messages were left out")

    def _hand_on(self, waited: tuple[Callable[[], None], Rig]) -> None:
        call, rig = waited
        if rig is not self._taken:
            self._taken = rig
            self._outlet.take_rig(rig)
        call()
