"""The C client for robots without Python reads what Python reads and refuses what it refuses, whatever arrives."""

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry

from asterism.protocol.codec import decode_beat, decode_rig, encode_odometry, to_bytes
from asterism.protocol.errors import InputError
from tests.clients.c_client import CClient, Read, build
from tests.clients.c_judge import check, check_time, is_same, judge
from tests.protocol import make_golden, mutated_clients
from tests.protocol.message_mutations import fields_of, message_of, mutated_message

GOLDEN = {version: make_golden.GOLDEN.parent / version for version in ("1", "2")}
GOOD = encode_odometry(make_golden.SMOOTHED_POSE)


def one(c_client: CClient, message: bytes, robot: str | None = "alpha") -> Read:
    (read,) = c_client.poses([message], robot)
    return read


@pytest.mark.parametrize("name", ["odometry", "odometry_smoothed"])
def test_golden_poses_are_read_to_the_last_bit(c_client: CClient, name: str) -> None:
    message = (GOLDEN["2"] / f"{name}.bin").read_bytes()
    read = one(c_client, message)
    assert read.words == "is good"
    assert is_same(read.pose, message)
    assert read.pose["smoothed"] == (name == "odometry_smoothed")
    assert one(c_client, message, None) == read
    assert one(c_client, message, "beta").words == "is of another robot"


def test_the_golden_pose_of_version_1_is_read_once_its_covariance_is_one(c_client: CClient) -> None:
    message = Odometry.FromString((GOLDEN["1"] / "odometry.bin").read_bytes())
    assert one(c_client, to_bytes(message)).words == "has a covariance that is none", "and Python's client says so too"
    message.pose_covariance[:] = make_golden.ROBOT_POSE.covariance.ravel()
    read = one(c_client, to_bytes(message))
    assert is_same(read.pose, to_bytes(message))
    assert read.pose["session"] == 0


def test_what_is_mutated_is_read_as_python_reads_it_or_refused(c_client: CClient, rng: np.random.Generator) -> None:
    told = judge(c_client, mutated_clients.poses(), 10_000, rng)
    assert told["is good"] > 500
    assert len(told) > 15, "of every kind of refusal some"


def test_with_floats_a_pose_is_that_of_python_rounded(
    c_client: CClient, tmp_path: Path, rng: np.random.Generator
) -> None:
    floats = build(tmp_path, "-DASTERISM_FLOAT")
    for message in (*mutated_clients.poses(), GOOD, *_with_numbers()):
        read = one(floats, message)
        assert read.words == "is good"
        assert is_same(read.pose, message, exact=False)
    mutated = [mutated_message(GOOD, rng) for _ in range(2000)]
    both = zip(floats.poses(mutated), c_client.poses(mutated), strict=True)
    assert sum(one.words != other.words for one, other in both) < 5, "they differ in rounding alone"


def _with_numbers() -> list[bytes]:
    """Positions that lie between floats, at their very middle, and where a float has no room for them."""
    numbers = (1.0 + 2.0**-24, 1.0 + 3 * 2.0**-24, 1.0 + 2.0**-24 + 2.0**-50, 16777217.0, 2.0 - 2.0**-25, 1e-45, -0.0)
    messages = []
    for number in numbers:
        told = Odometry.FromString(GOOD)
        told.pose.position.x = number if abs(number) > 2.0**-126 else 0.0
        messages.append(to_bytes(told))
    return messages


def edited(change: Callable[[Odometry], object]) -> bytes:
    told = Odometry.FromString(GOOD)
    change(told)
    return to_bytes(told)


def metadata(key: str, value: str) -> bytes:
    """One more pair, last of the message."""
    told = Odometry()
    told.metadata.add(key=key, value=value)
    return GOOD + to_bytes(told)


def unpacked(message: bytes) -> bytes:
    """Every number of both covariances a field of its own."""
    fields = []
    for number, wire, value in fields_of(message) or ():
        if number in (7, 8) and isinstance(value, bytes):
            fields += [(number, 1, value[k : k + 8]) for k in range(0, len(value), 8)]
        else:
            fields.append((number, wire, value))
    return message_of(fields)


def field(number: int, payload: bytes) -> bytes:
    return message_of([(number, 2, payload)])


def position(**numbers: float) -> bytes:
    """A pose that tells so much of a position, to be put behind another."""
    told = Odometry()
    for axis, number in numbers.items():
        setattr(told.pose.position, axis, number)
    return to_bytes(told)


NEWER = [(2047, 2, b"\x07" * 300), (100, 0, 2**64 - 1), (5000, 1, b"\xff" * 8), (2**29 - 1, 5, b"\xff" * 4)]
FOREIGN = [(1, 0, 5), (4, 1, b"\0" * 8), (7, 0, 1), (8, 5, b"\0" * 4), (9, 0, 1)]
FIELDS = fields_of(GOOD) or []
TAKEN = {
    "numbers one by one": unpacked(GOOD),
    "fields of a newer version": message_of([*NEWER, *FIELDS, *NEWER]),
    "fields of another type than ours": message_of([*FOREIGN, *FIELDS, *FOREIGN]),
    "a key that nobody knows": metadata("colour", "red"),
    "told in another session": metadata("session", "7"),
    "a number that is bad and then good": metadata("leds", "x") + metadata("leds", "5")[len(GOOD) :],
    "three LEDs of several cameras": metadata("leds", "3") + metadata("cameras", '["left","right"]')[len(GOOD) :],
    "a part of the position once more": GOOD + position(y=9.0),
    "a tag of more bytes than it needs": GOOD + b"\x92\x80\x80\x80\x00\x03cam",
    "a length of more bytes than it needs": GOOD + b"\x12\x83\x80\x00cam",
    "whole numbers of ten bytes": GOOD + field(1, b"\x10\x81\x80\x80\x80\xf0\xff\xff\xff\xff\x7f"),
    "a name of 128 bytes": GOOD + field(2, b"x" * 128),
    "a name in another script": GOOD + field(2, "\u7a93\U0001f916".encode()),
    "no name of a frame": GOOD + field(2, b""),
}


@pytest.mark.parametrize("what", TAKEN)
def test_what_protobuf_allows_is_read(c_client: CClient, what: str) -> None:
    read = one(c_client, TAKEN[what])
    assert read.words == "is good"
    check(TAKEN[what], read)


def covariance(change: Callable[[np.ndarray], object], name: str = "pose_covariance") -> bytes:
    told = Odometry.FromString(GOOD)
    matrix = np.array(getattr(told, name)[:]).reshape(6, 6)
    change(matrix)
    getattr(told, name)[:] = matrix.ravel()
    return to_bytes(told)


def of(path: str, value: float | str) -> bytes:
    """The good pose with one field set to that."""
    told = Odometry.FromString(GOOD)
    *way, last = path.split(".")
    inner = told
    for step in way:
        inner = getattr(inner, step)
    setattr(inner, last, value)
    return to_bytes(told)


def without(key: str) -> bytes:
    told = Odometry.FromString(GOOD)
    kept = [pair for pair in told.metadata if pair.key != key]
    del told.metadata[:]
    told.metadata.extend(kept)
    return to_bytes(told)


REFUSED = [
    ("lacks state", b""),
    ("ends within a field", GOOD[:-1]),
    ("ends within a field", GOOD + b"\x12\xff\xff\xff\xff\x07"),  # a length past the end
    ("ends within a field", GOOD + b"\x80"),
    ("has a whole number that does not end", GOOD + b"\x08" + b"\xff" * 10 + b"\0"),
    ("has a whole number that does not end", GOOD + b"\x12\x80\x80\x80\x80\x80\x00"),  # a length of six bytes
    ("has a whole number that does not end", GOOD + b"\xff\xff\xff\xff\x7f"),  # a tag beyond 32 bits
    ("has a field of number 0", GOOD + b"\x00\x00"),
    ("has a field of number 0", GOOD + b"\x0f"),  # type 7
    ("has a group", GOOD + b"\x53\x54"),  # begun and ended: protobuf skips it
    ("has a group", GOOD + b"\x54"),
    ("has text that is not UTF-8", GOOD + field(2, b"\xff")),
    ("has text that is not UTF-8", GOOD + field(2, b"\xed\xa0\x80")),  # half of a surrogate
    ("has text that is not UTF-8", GOOD + field(2, b"\xc0\x80")),  # two bytes where one would do
    ("has text that is not UTF-8", GOOD + field(2, b"\xf4\x90\x80\x80")),  # beyond the last character
    ("has text that is not UTF-8", GOOD + field(2, b"\xe2\x82")),
    ("has text that is not UTF-8", GOOD + field(9, b"\x0a\x01\x80")),
    ("has a list of numbers of which one is cut off", GOOD + field(7, b"\0" * 9)),
    *((f"lacks {needed}", without(key)) for key in ("state", "leds", "rms_px", "sequence") for needed in ["state"]),
    *(("has metadata with a number", metadata(*pair)) for pair in (
        ("leds", ""), ("leds", " 5"), ("leds", "+5"), ("leds", "5.0"), ("sequence", "18446744073709551616"),
        ("session", "9" * 21), ("published_ns", "-1"), ("rms_px", "nan"), ("rms_px", "1e"), ("rms_px", "."),
        ("rms_px", "-0.1"), ("rms_px", "0x1p3"), ("rms_px", "1e99"), ("acceleration", "1_0"), ("turn_acceleration", ""),
    )),
    ("has a name", GOOD + field(2, b"x" * 129)),
    ("has a name", GOOD + field(3, b"alpha\0x")),
    ("is of another robot", of("body_frame_id", "alph")),
    ("is of another robot", of("body_frame_id", "")),
    ("has a state", metadata("state", "LOST")),
    ("has a state", metadata("state", "TRACKED ")),
    ("rests on", metadata("leds", "3")),
    ("rests on", metadata("leds", "3") + metadata("cameras", "[]")[len(GOOD) :]),
    ("rests on", metadata("leds", "260")),  # 4 in eight bits
    *(("has a position", of(f"pose.position.{axis}", value)) for axis, value in zip(
        "xyz", (float("nan"), float("inf"), -1.1e9), strict=True)),
    ("has an orientation", of("pose.orientation.w", 0.503)),
    ("has an orientation", of("pose.orientation.x", float("nan"))),
    ("has an orientation", of("pose.orientation.x", 1e200)),
    ("has residuals", metadata("rms_px", "1.1e9")),
    ("has a covariance", GOOD + struct.pack("<Bd", 7 << 3 | 1, 0.0)),  # a thirty-seventh
    ("has a covariance", message_of([entry for entry in FIELDS if entry[0] != 7])),
    ("has a covariance", covariance(lambda m: m.__setitem__((3, 3), 0.0))),
    ("has a covariance", covariance(lambda m: m.__setitem__((3, 3), float("nan")))),
    ("has a covariance", covariance(lambda m: m.__setitem__((3, 3), float("inf")))),
    ("has a covariance", covariance(lambda m: m.__setitem__((0, 1), m[0, 1] * 1.01))),
    ("has a covariance", covariance(lambda m: m.__imul__(np.where(np.eye(6), 1.0, 60.0)))),
    ("has a velocity", covariance(lambda m: m.__imul__(-1.0), "velocity_covariance")),
    ("has a velocity", GOOD + struct.pack("<Bd", 8 << 3 | 1, 0.0)),
    ("has a velocity", of("linear_velocity.y", 1e10)),
    ("has a velocity", of("angular_velocity.z", float("nan"))),
    ("has a velocity", metadata("acceleration", "1e10")),
    ("has times", of("timestamp.seconds", 2**63 - 1)),
    ("has times", of("timestamp.seconds", -1)),
    ("has times", of("timestamp.nanos", 10**9)),
    ("has times", of("timestamp.nanos", -1)),
    ("has times", metadata("published_ns", str(make_golden.EXPOSED_NS - 1))),
    ("has times", metadata("published_ns", str(make_golden.EXPOSED_NS + 600 * 10**9 + 1))),
    ("has times", metadata("published_ns", str(2**64 - 1))),
    ("has times", without("published_ns")),
]  # fmt: skip


def test_what_is_no_pose_is_refused_with_its_reason(c_client: CClient) -> None:
    for (words, message), read in zip(REFUSED, c_client.poses([message for _, message in REFUSED]), strict=True):
        assert read.words.startswith(words), (words, message)
        check(message, read)


def test_every_message_cut_anywhere_is_refused(c_client: CClient) -> None:
    cuts = [GOOD[:length] for length in range(len(GOOD))]
    assert all(read.pose is None for read in c_client.poses(cuts))


def test_beats_and_rigs_are_read_for_their_clock(c_client: CClient, rng: np.random.Generator) -> None:
    for what, name, decode in (("beats", "beat", decode_beat), ("rigs", "rig_report", decode_rig)):
        golden = (GOLDEN["2"] / f"{name}.bin").read_bytes()
        told = decode(golden)
        told.rate, told.time_ns, told.session = 1.0, make_golden.EXPOSED_NS, make_golden.SESSION
        good = to_bytes(told)
        assert c_client.times(what, [good]) == [("is good", told.session, told.time_ns)]
        mutated = [good, *(mutated_message(good, rng) for _ in range(1000))]
        for message, read in zip(mutated, c_client.times(what, mutated), strict=True):
            try:
                decoded = decode(message)
            except InputError:
                decoded = None
            check_time(read, message, decoded)
        told.rate = 2.0
        assert c_client.times(what, [to_bytes(told)])[0][0].startswith("is of a replay")
