"""Where each robot's flight controller is: ROBOT=HOST:PORT of the command line."""

import socket
from collections.abc import Sequence
from typing import NamedTuple

from asterism.protocol.errors import InputError
from asterism.protocol.rig import Rig

WORLD = "world"  # the frame of poses where the rig has one
EXPECTED = "expected ROBOT=HOST:PORT such as alpha=127.0.0.1:14550"
_MOST_SYSTEMS = 254  # of MAVLink; 255 is the ground station's by custom


class Endpoint(NamedTuple):
    """One flight controller: of which robot, and where it listens."""

    robot: str
    host: str
    port: int

    def __str__(self) -> str:
        return f"{self.robot}={f'[{self.host}]' if ':' in self.host else self.host}:{self.port}"


def endpoint(text: str) -> Endpoint:
    """Raises InputError for what is none. An IPv6 address stands in brackets."""
    robot, equals, where = text.rpartition("=")
    host, colon, port = where.rpartition(":")
    plain = host.removeprefix("[").removesuffix("]")
    if not (robot and equals and plain and colon) or (":" in plain) != (len(host) == len(plain) + 2):
        raise InputError(f"--mavlink {text}: {EXPECTED}")
    if not (port.isascii() and port.isdecimal() and len(port) <= 5 and 0 < int(port) < 65_536):
        raise InputError(f"--mavlink {text}: port {port!r}, expected 1 to 65535")
    return Endpoint(robot, plain, int(port))


def systems_of(endpoints: Sequence[Endpoint], rig: Rig) -> list[int]:
    """The MAVLink system that each endpoint's robot is: its place in the rig, from 1.

    Raises InputError for an endpoint that is there twice, for a robot that the rig does not know, and for a rig without
    `world`: its poses are in the camera's frame, in which down is where nobody knows.
    """
    if twice := [where for where in endpoints if endpoints.count(where) > 1]:
        raise InputError(f"--mavlink {twice[0]}: is there twice, expected once: it would hear every pose twice")
    if rig.parent_frame != WORLD:
        raise InputError(
            f"--mavlink: the rig has no `world`, so poses are in the frame of camera '{rig.camera.name}'; expected one "
            "with z up (`asterism calibrate world`)"
        )
    return [_system_of(where.robot, rig) for where in endpoints]


def _system_of(robot: str, rig: Rig) -> int:
    known = [known.id for known in rig.robots]
    if robot not in known:
        raise InputError(f"--mavlink: the rig has no robot {robot!r}, expected one of {', '.join(known)}")
    system = known.index(robot) + 1
    if system > _MOST_SYSTEMS:
        raise InputError(
            f"--mavlink: {robot!r} is robot {system} of the rig, expected one of the first {_MOST_SYSTEMS}"
        )
    return system


def joined(where: Endpoint) -> socket.socket:
    """A UDP socket that sends there and hears from there alone. Raises InputError where there is no way to it."""
    try:
        family, kind, _, _, address = socket.getaddrinfo(where.host, where.port, type=socket.SOCK_DGRAM)[0]
        made = socket.socket(family, kind)
    except (OSError, UnicodeError) as error:  # a name that no host can have
        why = getattr(error, "strerror", None) or "its parts have 1 to 63 characters"
        raise InputError(f"--mavlink {where}: no such host ({why}); {EXPECTED}") from None
    try:
        made.connect(address)
    except OSError as error:
        made.close()
        raise InputError(f"--mavlink {where}: there is no way to it ({error.strerror}); {EXPECTED}") from None
    made.setblocking(False)
    return made
