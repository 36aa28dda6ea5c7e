"""What waits to be handed on: in order, from a thread of its own, and no more of it than a bound."""

import logging
import threading
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

_LOG = logging.getLogger(__name__)
T = TypeVar("T")


class Backlog(Generic[T]):
    """Calls a function with everything it is given, in order, from a thread of its own.

    Whoever gives is never held up: where more than ``most`` values wait, the oldest is dropped and counted in
    ``dropped``. With one, the newest wins.
    """

    def __init__(self, call: Callable[[T], None], name: str, most: int = 1) -> None:
        self._call = call
        self._name = name
        self.dropped = 0
        self._ready = threading.Condition()
        self._waiting: deque[T] = deque(maxlen=most)
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def give(self, value: T) -> None:
        """To be handed on after what waits already."""
        with self._ready:
            self.dropped += len(self._waiting) == self._waiting.maxlen
            self._waiting.append(value)
            self._ready.notify()

    @property
    def busy(self) -> bool:
        """Whether its thread has not ended: of one that is closed, that a call does not return."""
        return self._thread.is_alive()

    def close(self, timeout_s: float = 5.0, rest: bool = True) -> None:
        """Hand on what waits, unless nobody wants the ``rest``, and no more; a call that does not return within that
        time is left behind.
        """
        with self._ready:
            self._closed = True
            if not rest:
                self._waiting.clear()
            self._ready.notify()
        self._thread.join(timeout_s)

    def _run(self) -> None:
        while True:
            with self._ready:
                self._ready.wait_for(lambda: self._waiting or self._closed)
                if not self._waiting:
                    return
                value = self._waiting.popleft()
            try:
                self._call(value)
            except Exception:  # one value's fault must not end what hands on the next
                _LOG.exception("%s failed; it goes on with the next", self._name)
