"""Datagrams that come to a server's sockets, heard by a thread of its own."""

import contextlib
import select
import socket
import threading
from collections.abc import Callable, Collection


class Hearing:
    """Calls ``take`` with every socket to which something came, until it is closed; an OSError of it is passed over:
    who is gone is nobody's trouble. The sockets stay open.
    """

    def __init__(self, sockets: Collection[socket.socket], take: Callable[[socket.socket], None], name: str) -> None:
        self._sockets = sockets
        self._take = take
        self._wake, self._woken = socket.socketpair()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Hear no more."""
        self._wake.close()
        self._thread.join()
        self._woken.close()

    def _run(self) -> None:
        while True:
            ready, _, _ = select.select([self._woken, *self._sockets], [], [])
            if self._woken in ready:
                return
            for one in ready:
                with contextlib.suppress(OSError):
                    self._take(one)
