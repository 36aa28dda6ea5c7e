"""Functions that are called with every pose or event: one that raises is told once and keeps nobody else from his."""

import logging
import threading
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")
_LOG = logging.getLogger(__name__)


class Callbacks(Generic[T]):
    """A list of functions. Safe to use from any thread, and from the functions themselves."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._callbacks: tuple[Callable[[T], object], ...] = ()
        self._raised: set[int] = set()
        self.raised = 0  # how often one did

    def add(self, callback: Callable[[T], object]) -> Callable[[], None]:
        """Have it called from now on; what is returned takes it back, as `remove` does."""
        with self._lock:
            self._callbacks += (callback,)
        return lambda: self.remove(callback)

    def remove(self, callback: Callable[[T], object]) -> None:
        """Call it no more. One that is not there is no mistake."""
        with self._lock:
            kept = list(self._callbacks)
            if callback in kept:
                kept.remove(callback)
            self._callbacks = tuple(kept)
            self._raised.discard(id(callback))

    def call(self, value: T) -> None:
        """Call all of them with ``value``."""
        for callback in self._callbacks:
            try:
                callback(value)
            except (Exception, SystemExit):
                self.raised += 1
                if id(callback) not in self._raised:
                    self._raised.add(id(callback))
                    _LOG.exception("a callback raised; it is told once, and called again with the next")
