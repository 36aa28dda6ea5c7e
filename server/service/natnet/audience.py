"""Who listens: clients that called not long ago."""

import threading
import time

Address = tuple[str, int]

MOST = 32
PATIENCE_S = 10.0  # after its last call; clients call several times a second


class Audience:
    """Addresses of clients. Any thread may ask and tell."""

    def __init__(self) -> None:
        self._heard_s: dict[Address, float] = {}
        self._lock = threading.Lock()

    def joins(self, client: Address) -> bool:
        """It called. Returns whether there was room for it."""
        with self._lock:
            self._forget()
            room = client in self._heard_s or len(self._heard_s) < MOST
            if room:
                self._heard_s[client] = time.monotonic()
            return room

    def leaves(self, client: Address) -> None:
        """It wants no more."""
        with self._lock:
            self._heard_s.pop(client, None)

    def now(self) -> list[Address]:
        """Who is to get the next frame."""
        with self._lock:
            self._forget()
            return list(self._heard_s)

    def _forget(self) -> None:
        until_s = time.monotonic() - PATIENCE_S
        self._heard_s = {client: heard_s for client, heard_s in self._heard_s.items() if heard_s > until_s}
