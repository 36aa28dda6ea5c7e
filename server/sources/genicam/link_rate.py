"""How many frames a second the way from a camera carries."""

import fcntl
import socket
import struct
from pathlib import Path
from typing import NamedTuple

from asterism.server.sources.genicam.aravis_camera import ArvCamera

_GET_ADDRESS = 0x8915  # SIOCGIFADDR
_HEADERS = 36  # bytes of an IP packet that are no image: IP, UDP and GigE Vision's own
_AROUND = 38  # bytes of the wire for each packet: Ethernet's header, check sum, preamble and gap
_MBIT = 125_000  # bytes/s
_SPEEDS = (("DeviceLinkThroughputLimit", 1), ("DeviceLinkSpeed", 1), ("GevLinkSpeed", _MBIT))  # feature, bytes/s of one


class Most(NamedTuple):
    """The highest rate, Hz, and why it is not higher."""

    rate_hz: float
    why: str


def most_hz(camera: ArvCamera) -> Most | None:
    """As the camera is set now; None where neither it nor the host tells of a limit."""
    limits = [camera.whole(name) * unit for name, unit in _SPEEDS if camera.has(name)]
    if camera.address:
        limits += _of_host(camera.address)
    limits = [limit for limit in limits if limit > 0]
    if not limits:
        return None
    payload, carried = camera.payload(), float(min(limits))
    if camera.is_gige():
        size = camera.packet_size()
        carried *= (size - _HEADERS) / (size + _AROUND)
    rate = carried / payload
    why = f"a frame has {payload / 1e6:.2f} MB, and the camera's link carries {carried / 1e6:.0f} MB/s: {rate:.3g} Hz"
    return Most(rate, f"{why} at most; a smaller size or fewer bits leave room for more")


def _of_host(address: str) -> list[int]:
    """What the network card that faces the camera is linked with, bytes/s; nothing for loopback."""
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.connect((address, 9))  # sends nothing; the kernel chooses the way
            ours = probe.getsockname()[0]
        card = _card_of(ours)
        return [] if card is None else [int((Path("/sys/class/net") / card / "speed").read_text()) * _MBIT]
    except (OSError, ValueError):
        return []


def _card_of(address: str) -> str | None:
    """The name of the network card with that address."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asker:
        for _, name in socket.if_nameindex():
            try:
                told = fcntl.ioctl(asker.fileno(), _GET_ADDRESS, struct.pack("256s", name.encode()[:15]))
            except OSError:
                continue
            if socket.inet_ntoa(told[20:24]) == address:
                return name
    return None
