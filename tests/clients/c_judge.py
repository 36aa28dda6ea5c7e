"""What the C client makes of bytes against what Python's client and protobuf itself make of them."""

import math
import re
from collections import Counter

import numpy as np
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from google.protobuf.message import DecodeError

from asterism.clients.accept import problem
from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import decode_odometry
from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats
from asterism.protocol.messages import Velocity
from tests.clients.c_client import STATES, CClient, Read
from tests.protocol.message_mutations import fields_of, mutated_message

NO_MESSAGE = ("ends within", "whole number that does not", "field of number 0", "not UTF-8", "is cut off")
GROUP = "has a group"
LATEST_NS = 1 << 62
_WHOLE = re.compile(r"[0-9]{1,20}", re.ASCII)
_REAL = re.compile(r"(?=.{1,40}$)([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?", re.ASCII)


def judge(client: CClient, good: tuple[bytes, ...], count: int, rng: np.random.Generator) -> Counter[str]:
    """Mutate ``count`` of the good messages, have all read by everybody, and assert that they agree."""
    messages = [mutated_message(good[k % len(good)], rng) for k in range(count)]
    told = Counter[str]()
    for message, read in zip(messages, client.poses(messages), strict=True):
        check(message, read)
        told[read.words] += 1
    return told


def check(message: bytes, read: Read) -> None:
    """The law: protobuf's errors are the C client's, what it takes Python takes with equal numbers, and what Python
    takes it refuses only for a reason that its README names.
    """
    is_message = _is_message(message)
    if read.words.removeprefix("has ").startswith(NO_MESSAGE):
        assert not is_message, read.words
    accepted = _is_pose(message)
    if read.pose is not None:
        assert accepted
        assert is_same(read.pose, message)
    elif accepted:
        assert is_stricter(message, read.words), read.words
    if not is_message:
        assert read.pose is None


def check_time(told: tuple[str, int, int], message: bytes, decoded: "pb.Beat | pb.RigReport | None") -> None:
    """The same for a beat or a rig report, as Python has it, or None where that is none."""
    words, session, time_ns = told
    if words == "is good":
        # Of a rig report the C client looks at three numbers; what else may be wrong with it is not looked at.
        assert decoded is None or (decoded.session, decoded.time_ns, decoded.rate or 1.0) == (session, time_ns, 1.0)
        return
    assert (session, time_ns) == (0, 0)
    assert (
        decoded is None
        or (words == "is of no session" and decoded.session == 0)
        or (words.startswith("is of a replay") and decoded.rate != 1.0)
        or (words == "has times that cannot be" and not 0 < decoded.time_ns < LATEST_NS)
        or (words.startswith(GROUP) and fields_of(message) is None)
    ), words


def _is_message(message: bytes) -> bool:
    try:
        Odometry().ParseFromString(message)
    except DecodeError:
        return False
    return True


def _is_pose(message: bytes) -> bool:
    """Whether Python's client takes it."""
    try:
        return problem(decode_odometry(message), "alpha") is None
    except InputError:
        return False


def is_same(told: np.void, message: bytes, exact: bool = True) -> bool:
    """Equal to what Python's client and protobuf have of the message: to the last bit, but for what comes as text, and
    orientations, which Python makes exactly unit; not ``exact``: all rounded to floats.
    """
    pose, raw = decode_odometry(message), Odometry.FromString(message).pose.orientation
    velocity = pose.velocity or Velocity(np.zeros(3), np.zeros(3), np.zeros((6, 6)))
    reals = (
        (told["position"], pose.position),
        (told["orientation"], np.array([raw.x, raw.y, raw.z, raw.w])),
        (told["covariance"], pose.covariance),
        (told["linear"], velocity.linear),
        (told["angular"], velocity.angular),
        (told["velocity_covariance"], velocity.covariance),
    )
    texts = ((told["rms_px"], pose.rms_px), *zip(told["accelerations"], velocity.accelerations, strict=True))
    whole = ("exposed_ns", "published_ns", "session", "sequence", "leds", "extrapolated")
    return (
        all(_equal(c, python, exact) for c, python in reals)
        and all(math.isclose(*two, rel_tol=1e-14 if exact else 1e-6, abs_tol=1e-37) for two in texts)
        and all(told[name] == getattr(pose, name) for name in whole)
        and STATES[told["state"]] == pose.state
        and (told["robot"].decode(), told["frame_id"].decode()) == (pose.robot, pose.frame_id)
        and bool(told["has_velocity"]) == (pose.velocity is not None)
    )


def _equal(c: Floats, python: Floats, exact: bool) -> bool:
    with np.errstate(over="ignore"):
        return np.array_equal(c, python if exact else python.astype(np.float32))


def is_stricter(message: bytes, words: str) -> bool:
    """Whether the C client may refuse, for that reason, a message that Python takes."""
    told = Odometry.FromString(message)
    texts = {pair.key: pair.value for pair in told.metadata}
    if words == "has metadata with a number that is none":
        wholes = ("leds", "sequence", "session", "published_ns")
        reals = ("rms_px", "acceleration", "turn_acceleration")
        return not all(_WHOLE.fullmatch(texts.get(key, "0")) for key in wholes) or not all(
            _REAL.fullmatch(texts.get(key, "0")) for key in reals
        )
    if words.startswith("has a name"):
        names = (told.frame_id, told.body_frame_id)
        # The last of a name holds in Python, every one must be one in C.
        names += tuple(
            value.decode() for number, wire, value in fields_of(message) or () if number in {2, 3} and wire == 2
        )
        return any(len(name.encode()) > 128 or "\0" in name for name in names)
    if words == "has times that cannot be":
        stamp = told.timestamp
        return stamp.seconds * 10**9 + stamp.nanos >= LATEST_NS or not 0 <= stamp.nanos < 10**9
    return words.startswith(GROUP) and _has_a_group(message)


def _has_a_group(message: bytes) -> bool:
    """Protobuf takes the bytes, and a plain reader of fields does not: somewhere there is a group."""
    fields = fields_of(message)
    if fields is None:
        return True
    nested = {1: (), 4: (1, 2), 5: (), 6: (), 9: ()}
    for number, wire, value in fields:
        if wire != 2 or number not in nested or not isinstance(value, bytes):
            continue
        inner = fields_of(value)
        if inner is None:
            return True
        if any(fields_of(v) is None for n, w, v in inner if w == 2 and n in nested[number] and isinstance(v, bytes)):
            return True
    return False
