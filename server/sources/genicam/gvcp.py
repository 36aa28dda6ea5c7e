"""GigE Vision's control protocol, as much of it as anybody may speak: is a camera there, which, and is it taken?

Aravis waits seconds for a camera that does not answer; this asks the same in milliseconds. Packets as in GigE Vision
1.0, chapters 14 to 17, and its bootstrap registers.
"""

import socket
import struct
from typing import NamedTuple

PORT = 3956
_KEY, _ANSWER = 0x42, 0x01  # of a command; the flag that asks for an answer
_DISCOVER, _READ = 0x0002, 0x0080
_CONTROL, _OWNER = 0x0A00, 0x0A14  # registers: who may write, and the address of whoever does
_STREAM_PORT = 0x0D00  # to which frames are sent
_MODEL, _SERIAL = slice(0x68, 0x88), slice(0xD8, 0xE8)
TIMEOUTS_S = (0.1, 0.2, 0.25)  # of one try after the other; cameras answer within 5 ms


class Answer(NamedTuple):
    """What a camera says of itself."""

    model: str
    serial: str


def who_is(address: str) -> Answer | None:
    """The camera at an IP address; None where none answers within half a second."""
    data = _ask(address, _DISCOVER, b"")
    if data is None:
        return None
    model, serial = (data[part].split(b"\0")[0].decode(errors="replace") for part in (_MODEL, _SERIAL))
    return Answer(model, serial)


def sends_to(address: str, port: int) -> bool:
    """Whether the camera at an IP address is controlled and sends its frames to this port; also where it does not
    tell.
    """
    control, told = _register(address, _CONTROL), _register(address, _STREAM_PORT)
    return control != 0 and (told is None or told & 0xFFFF == port)


def taken_by(address: str) -> str | None:
    """Which program controls the camera at an IP address, in words; None where none does, or it does not tell."""
    if not _register(address, _CONTROL):
        return None
    owner = _register(address, _OWNER)
    return f"a program on {socket.inet_ntoa(struct.pack('>I', owner))}" if owner else "another program"


def _register(address: str, register: int) -> int | None:
    data = _ask(address, _READ, struct.pack(">I", register))
    return None if data is None or len(data) < 4 else int(struct.unpack_from(">I", data)[0])


def _ask(address: str, command: int, data: bytes) -> bytes | None:
    """What the camera answers, without the header."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asker:
        for number, timeout_s in enumerate(TIMEOUTS_S, 1):
            asker.settimeout(timeout_s)
            try:
                asker.connect((address, PORT))
                asker.send(struct.pack(">BBHHH", _KEY, _ANSWER, command, len(data), number) + data)
                while True:
                    told = asker.recv(2048)
                    status, answer, _, to = struct.unpack_from(">HHHH", told)
                    if answer == command + 1 and to == number:
                        return None if status else told[8:]
            except (OSError, struct.error):
                continue
    return None
