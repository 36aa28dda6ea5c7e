"""Frames that a camera sent and that did not come, or not whole: how many, and what to do."""

import time
from collections.abc import Callable
from pathlib import Path

from asterism.server.sources.source import Say

EVERY_S = 60.0  # it is said again, where there are more
JUMBO = 8000  # bytes: a packet of less can be larger
BUFFER = 1 << 25  # bytes that the kernel should be able to hold for a camera
_LIMIT = Path("/proc/sys/net/core/rmem_max")


class LostFrames:
    """Counts and says; ``clock`` is monotonic, s."""

    def __init__(self, name: str, say: Say, clock: Callable[[], float] = time.monotonic) -> None:
        self._name = name
        self._say = say
        self._clock = clock
        self.incomplete = 0  # came, but not whole
        self.missed = 0  # their numbers were left out
        self._next_s = clock()

    def add(self, incomplete: int, missed: int, packets: int = 0, packet_size: int = 0) -> None:
        """So many more; ``packets`` are missing of a GigE Vision camera in all, of ``packet_size`` bytes."""
        self.incomplete += incomplete
        self.missed += missed
        if self._clock() < self._next_s:
            return
        self._next_s = self._clock() + EVERY_S
        of_packets = f" ({packets} packets missing)" if packets else ""
        told = [f"{self.incomplete} came incomplete{of_packets}"] * bool(self.incomplete)
        told += [f"{self.missed} did not come"] * bool(self.missed)
        self._say(f"{self._name}: frames are lost: {' and '.join(told)}; none of them is used. {advice(packet_size)}")


def advice(packet_size: int) -> str:
    """What to do where frames are lost."""
    if not packet_size:
        return "Give the camera a USB 3 port of its own, with a cable of 3 m or less, or a lower rate"
    told = []
    if packet_size < JUMBO:
        told.append(f"packets have {packet_size} bytes: allow jumbo frames (ip link set dev CARD mtu 9000)")
    if (limit := _buffer_limit()) is not None and limit < BUFFER:
        told.append(f"the kernel holds {limit} bytes at most: sysctl -w net.core.rmem_max={BUFFER}")
    told.append("give the camera a network card of its own, or a lower rate")
    first, *rest = told
    return "; ".join([first[0].upper() + first[1:], *rest])


def _buffer_limit() -> int | None:
    try:
        return int(_LIMIT.read_text())
    except (OSError, ValueError):
        return None
