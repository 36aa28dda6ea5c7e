"""MAVLink 2: a message's frame on the wire, and the few messages that are sent and read here.

Source: mavlink.io, "Packet Serialization" and the message set `common`. Fields lie largest type first, which is not the
order of the definition; extension fields come last, and the checksum knows nothing of them.
"""

import struct
from binascii import crc_hqx
from typing import NamedTuple

from asterism.protocol.geometry import Floats

MAGIC = 0xFD
COMPONENT = 197  # MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY
LOCAL_FRD = 20  # MAV_FRAME: x forward, y right, z down from where the user's world lies, x not to the north
BODY_FRD = 12
MOTION_CAPTURE = 6  # MAV_ESTIMATOR_TYPE_MOCAP

_HEAD = struct.Struct("<BBBBBBBHB")
# Bit-reversed bytes: the checksum (CRC-16/MCRF4XX) is that of `crc_hqx` with the order of bits turned round.
_TURNED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
_BARE_BYTES = 12  # of a frame without payload and signature


class Kind(NamedTuple):
    """A message: its number, the seed of its checksum (made from its definition), its fields as they lie."""

    number: int
    seed: int
    fields: struct.Struct


HEARTBEAT = Kind(0, 50, struct.Struct("<IBBBBB"))
TIMESYNC = Kind(111, 34, struct.Struct("<qq"))
ODOMETRY = Kind(331, 91, struct.Struct("<Q13f21f21fBBBBb"))
# custom mode, MAV_TYPE_ONBOARD_CONTROLLER, MAV_AUTOPILOT_INVALID, base mode, MAV_STATE_ACTIVE, MAVLink version
ALIVE = (0, 18, 8, 0, 4, 3)


def checksum(data: bytes) -> int:
    """CRC-16/MCRF4XX."""
    turned = crc_hqx(data.translate(_TURNED), 0xFFFF)
    return _TURNED[turned & 0xFF] << 8 | _TURNED[turned >> 8]


def framed(kind: Kind, payload: bytes, sequence: int, system: int) -> bytes:
    """A message as it goes out, from `COMPONENT` of that system; ``sequence`` counts messages, 0 to 255.

    Zeros at the payload's end are left out, as MAVLink 2 wants it; the first byte stays.
    """
    payload = payload[:1] + payload[1:].rstrip(b"\0")
    number = kind.number
    head = _HEAD.pack(MAGIC, len(payload), 0, 0, sequence, system, COMPONENT, number & 0xFFFF, number >> 16)
    check = checksum(head[1:] + payload + bytes([kind.seed]))
    return head + payload + struct.pack("<H", check)


def unframed(kind: Kind, datagram: bytes) -> tuple[int, ...] | None:
    """The fields of the one message in a datagram, or None where it is none of that kind, or damaged."""
    if len(datagram) < _BARE_BYTES or datagram[0] != MAGIC:
        return None
    length, number = datagram[1], int.from_bytes(datagram[7:10], "little")
    body, check = datagram[1 : 10 + length], datagram[10 + length : 12 + length]
    if number != kind.number or length > kind.fields.size or len(check) < 2:
        return None
    if checksum(body + bytes([kind.seed])) != int.from_bytes(check, "little"):
        return None
    return kind.fields.unpack(body[9:].ljust(kind.fields.size, b"\0"))


class Odometry(NamedTuple):
    """What `ODOMETRY` tells, in frames whose y points right and z down.

    ``position`` (3,) m; ``orientation`` (4,) w x y z; ``velocity`` (6,) m/s and rad/s of the body, NaN where unknown;
    the covariances (6, 6), of x, y, z, roll, pitch, yaw and of the velocity.
    """

    time_us: int
    position: Floats
    orientation: Floats
    covariance: Floats
    velocity: Floats
    velocity_covariance: Floats
    resets: int
    quality: int

    def payload(self) -> bytes:
        """The message's bytes."""
        return ODOMETRY.fields.pack(
            self.time_us,
            *self.position.tolist(),
            *self.orientation.tolist(),
            *self.velocity.tolist(),
            *_upper(self.covariance),
            *_upper(self.velocity_covariance),
            LOCAL_FRD,
            BODY_FRD,
            self.resets & 0xFF,
            MOTION_CAPTURE,
            self.quality,
        )


def _upper(covariance: Floats) -> list[float]:
    """The 21 numbers of a symmetric (6, 6) that are on and above its diagonal, row by row."""
    rows: list[list[float]] = covariance.tolist()
    return [value for k, row in enumerate(rows) for value in row[k:]]
