"""What systemd is told where it has started the server: ready, alive, reading its rig again, ending.

Each is a datagram to the socket that the environment names; without one nothing is told. Protocol: sd_notify(3).
"""

import contextlib
import os
import socket
import time
from collections.abc import Callable, Mapping

OFTENER = 4.0  # times as often as the watchdog asks for it
SEND_S = 0.1  # who does not take it within that long does not get it


class Systemd:
    """``environment`` is what systemd has set: NOTIFY_SOCKET, WATCHDOG_USEC and WATCHDOG_PID; ``monotonic`` is in s."""

    def __init__(
        self, environment: Mapping[str, str] = os.environ, monotonic: Callable[[], float] = time.monotonic
    ) -> None:
        name = environment.get("NOTIFY_SOCKET", "")
        self._address = f"\0{name[1:]}" if name.startswith("@") else name
        self._every_s = _watchdog_s(environment) / OFTENER
        self._monotonic = monotonic
        self._due_s = 0.0

    def ready(self) -> None:
        """It serves, or serves again after `reloading`."""
        self._tell("READY=1")

    def reloading(self) -> None:
        """It has been asked to read its rig again; `ready` says that it is done."""
        self._tell(f"RELOADING=1\nMONOTONIC_USEC={time.monotonic_ns() // 1000}")

    def stopping(self) -> None:
        """It ends."""
        self._tell("STOPPING=1")

    def alive(self) -> None:
        """The loop runs: may be called as often as it likes."""
        now = self._monotonic()
        if self._every_s and now >= self._due_s:
            self._due_s = now + self._every_s
            self._tell("WATCHDOG=1")

    def _tell(self, text: str) -> None:
        if not self._address:
            return
        # Where systemd itself is gone, there is nobody to tell.
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as out:
            out.settimeout(SEND_S)
            out.sendto(text.encode(), self._address)


def _watchdog_s(environment: Mapping[str, str]) -> float:
    """How long systemd waits for a sign of life of this process, 0 where it does not."""
    if environment.get("WATCHDOG_PID", str(os.getpid())) != str(os.getpid()):
        return 0.0
    number = environment.get("WATCHDOG_USEC", "")
    return int(number) * 1e-6 if number.isascii() and number.isdigit() else 0.0
