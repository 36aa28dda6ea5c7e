"""A participant of a DDS domain: on loopback alone, unless the user's own configuration says otherwise."""

import contextlib
import ctypes
import os
import socket
from collections.abc import Iterator
from pathlib import Path

from cyclonedds.core import DDSException
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.internal import DDS

from asterism.protocol.errors import InputError
from asterism.server.service.say import say

USERS_OWN = "CYCLONEDDS_URI"  # the variable by which Cyclone is configured
# Multicast finds nodes, on loopback as well; those whose own configuration has none are asked one by one. Poses go to
# each by itself. The queue of what is not acknowledged must not hold up who writes.
_LOOPBACK = """
<CycloneDDS><Domain Id="any">
  <General>
    <Interfaces><NetworkInterface address="127.0.0.1" multicast="true"/></Interfaces>
    <AllowMulticast>spdp</AllowMulticast>
  </General>
  <Discovery>
    <ParticipantIndex>auto</ParticipantIndex>
    <MaxAutoParticipantIndex>{}</MaxAutoParticipantIndex>
    <Peers><Peer Address="localhost"/></Peers>
  </Discovery>
  <Internal><Watermarks><WhcHigh>4MB</WhcHigh><WhcAdaptive>false</WhcAdaptive></Watermarks></Internal>
</Domain></CycloneDDS>
"""
_MOST = 99  # participants on a machine that are asked one by one
_ANY = ("0.0.0.0", "::")
_TO_DEVICE = getattr(socket, "SO_BINDTODEVICE", None)  # Linux
_MASK = DDS._dll_handle["dds_set_log_mask"]
_MASK.argtypes, _MASK.restype = [ctypes.c_uint32], None


class Participant:
    """In that domain until it is closed; ``where`` says who hears it. Raises InputError where it cannot be joined."""

    def __init__(self, domain: int) -> None:
        self._domain: Domain | None = None
        users_own = os.environ.get(USERS_OWN)
        before = _sockets()
        try:
            if not users_own:
                # Past everything its lines would go to the terminal; of a user's own configuration it knows best.
                _MASK(0)
                self._domain = Domain(domain, _loopback(domain))
            self.dds = DomainParticipant(domain)
        except DDSException:
            self._domain = None
            why = f"its UDP ports, from {7400 + 250 * domain} on, may be taken; expected another --ros-domain"
            if users_own:
                why = f"expected {USERS_OWN} to be a configuration for Cyclone DDS on this machine, or not to be set"
            raise InputError(f"--dds: domain {domain} cannot be joined: {why}") from None
        self.where = f"as {USERS_OWN} has it" if users_own else f"on loopback alone ({USERS_OWN} opens it to a network)"
        if not users_own:
            _keep_to_loopback(_sockets() - before)

    def close(self) -> None:
        """Leave the domain."""
        del self.dds
        self._domain = None


def _loopback(domain: int) -> str:
    """The configuration. The ports of later participants of high domains would be beyond the last there is."""
    return _LOOPBACK.format(min(_MOST, (65_535 - 7411 - 250 * domain) // 2))


def _sockets() -> set[int]:
    """The file descriptors of this process that are sockets, where the system tells them (Linux)."""
    found = set()
    with contextlib.suppress(OSError):
        for link in list(Path("/proc/self/fd").iterdir()):
            with contextlib.suppress(OSError):  # the folder's own is closed by now
                if str(link.readlink()).startswith("socket:"):
                    found.add(int(link.name))
    return found


def _keep_to_loopback(numbers: set[int]) -> None:
    """Let no packet of another device reach these sockets: Cyclone binds those that it hears by to every address."""
    try:
        if _TO_DEVICE is None:
            raise OSError
        for one in _opened(numbers):
            if one.type == socket.SOCK_DGRAM and one.getsockname()[0] in _ANY:
                one.setsockopt(socket.SOL_SOCKET, _TO_DEVICE, b"lo\0")
    except OSError:  # Linux before 5.7 lets only root do it
        say("warning: on this system --dds hears other hosts as well; keep them out by a firewall")


def _opened(numbers: set[int]) -> Iterator[socket.socket]:
    for number in numbers:
        with contextlib.suppress(OSError), socket.socket(fileno=os.dup(number)) as one:
            yield one
