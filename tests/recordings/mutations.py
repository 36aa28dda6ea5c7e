"""Recordings made by hand, without the chain, and what can befall their files: seeded, one kind at a time."""

import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.writer import CompressionType
from mcap.writer import Writer as PlainWriter

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import encode_image, encode_odometry, to_bytes
from asterism.protocol.geometry import Pose
from asterism.protocol.messages import FRAME_REPORT, IMAGE, ODOMETRY, Message, RobotPose
from asterism.protocol.rig import Rig, load_rig
from asterism.protocol.schemas import descriptor_set
from asterism.recordings.chunks import Chunk
from asterism.recordings.packing import Packing
from asterism.recordings.records import HEAD, MAGIC, records_in
from asterism.recordings.series import Series
from asterism.server.simulation.demo_rig import DEMO_RIG

START_NS = 1_795_398_896_000_000_000
STEP_NS = 16_666_667
U64 = struct.Struct("<Q")
_COMPRESSIONS = {"": CompressionType.NONE, "lz4": CompressionType.LZ4, "zstd": CompressionType.ZSTD}


class Damage(NamedTuple):
    """``data`` is what became of a file; ``touched`` the bytes of the old one that are not to be found in it, or None
    where what is told is not true any more.
    """

    data: bytes
    touched: tuple[int, int] | None


def rig() -> Rig:
    """Whose recordings are made."""
    return load_rig(DEMO_RIG)


def hand_made(frames: int, rng: np.random.Generator) -> tuple[list[Message], list[Message]]:
    """Messages of so many frames, and their images."""
    told: list[Message] = []
    images = []
    camera = rig().camera
    for index in range(frames):
        time_ns = START_NS + index * STEP_NS
        report = pb.FrameReport(sequence=index, exposed_ns=time_ns, frame_id="world")
        for robot in ("alpha", "bravo"):
            pose = Pose(rng.normal(size=3), np.array([0.0, 0.0, 0.0, 1.0]))
            one = RobotPose(robot, "world", pose, np.eye(6), "TRACKED", 6, 0.1, index, time_ns, time_ns)
            key = keys.odometry(camera.name, robot)
            told.append(Message(key, ODOMETRY, encode_odometry(one), time_ns, time_ns, index))
            entry = report.robots.add(id=robot, state=pb.TRACKED, leds=6, rms_px=0.1)
            entry.pose.position.x, entry.pose.orientation.w = float(pose.position[0]), 1.0
        key = keys.frame(camera.name)
        told.append(Message(key, FRAME_REPORT, to_bytes(report), time_ns, time_ns, index))
        payload = encode_image(time_ns, camera, rng.integers(0, 20, (24, 32), np.uint8))
        images.append(Message(keys.image(camera.name), IMAGE, payload, time_ns, time_ns, index))
    return told, images


def metadata() -> dict[str, str]:
    """A recording's."""
    one = rig()
    return {"camera": one.camera.name, "rig.yaml": one.rig_text, "camera.yaml": one.camera_text, "protocol": "2"}


def write_file(
    folder: Path, stem: str, messages: list[Message], compression: str, a_chunk: int, crc: bool = True
) -> None:
    """<folder>/<stem>-0001.mcap, with so many messages a chunk."""
    series = Series(folder, stem, Packing(compression, crc), 1 << 40, metadata(), list)
    for number, message in enumerate(messages):
        series.add(message)
        if number % a_chunk == a_chunk - 1:
            series.flush()
    series.close({"frames": "1"})


def write_old(path: Path, messages: list[Message], compression: str, a_chunk: int) -> None:
    """The same with MCAP's own writer, as version 0.1 did: channels stand in the first chunk only, and at the end."""
    with path.open("wb") as stream:
        writer = PlainWriter(stream, chunk_size=1 << 30, compression=_COMPRESSIONS[compression])
        writer.start(library="asterism 0.1.0")
        writer.add_metadata("asterism", metadata())
        schemas: dict[str, int] = {}
        channels: dict[str, int] = {}
        for number, m in enumerate(messages):
            if m.kind.schema not in schemas:
                data = descriptor_set(m.kind.schema)
                schemas[m.kind.schema] = writer.register_schema(m.kind.schema, "protobuf", data)
            if m.key not in channels:
                told = {"on_wire": "yes" if m.kind.on_wire else "no"}
                channels[m.key] = writer.register_channel(m.key, "protobuf", schemas[m.kind.schema], told)
            writer.add_message(channels[m.key], m.log_ns, m.payload, m.publish_ns, m.sequence)
            if number % a_chunk == a_chunk - 1:
                writer.flush()
        writer.finish()


def flip(data: bytes, rng: np.random.Generator) -> Damage:
    """One bit."""
    at = int(rng.integers(len(data)))
    return Damage(data[:at] + bytes([data[at] ^ (1 << int(rng.integers(8)))]) + data[at + 1 :], (at, at + 1))


def flips(data: bytes, rng: np.random.Generator) -> Damage:
    """Some bytes near each other."""
    begin, end = _range(data, rng, 200)
    noise = rng.integers(0, 256, end - begin, np.uint8).tobytes()
    return Damage(data[:begin] + noise + data[end:], (begin, end))


def truncate(data: bytes, rng: np.random.Generator) -> Damage:
    """The rest is missing."""
    at = int(rng.integers(len(data)))
    return Damage(data[:at], (at, len(data)))


def zero(data: bytes, rng: np.random.Generator) -> Damage:
    """A range of zeros, as a disk leaves what was not written yet."""
    begin, end = _range(data, rng, 3000)
    return Damage(data[:begin] + bytes(end - begin) + data[end:], (begin, end))


def zero_tail(data: bytes, rng: np.random.Generator) -> Damage:
    """Zeros to the end."""
    at = int(rng.integers(len(data)))
    return Damage(data[:at] + bytes(len(data) - at), (at, len(data)))


def duplicate(data: bytes, rng: np.random.Generator) -> Damage:
    """A range is there twice."""
    begin, end = _range(data, rng, 6000)
    return Damage(data[:end] + data[begin:], (end, end))


def remove(data: bytes, rng: np.random.Generator) -> Damage:
    """A range is not there."""
    begin, end = _range(data, rng, 3000)
    return Damage(data[:begin] + data[end:], (begin, end))


def insert(data: bytes, rng: np.random.Generator) -> Damage:
    """Something else is between."""
    at = int(rng.integers(len(data)))
    noise = rng.integers(0, 256, int(rng.integers(1, 2000)), np.uint8).tobytes()
    return Damage(data[:at] + noise + data[at:], (at, at))


def length(data: bytes, rng: np.random.Generator) -> Damage:
    """A record tells another length, an absurd one at times."""
    at = _record(data, rng)[0]
    told = HEAD.unpack_from(data, at)[1]
    other = [told + 1, max(told - 1, 0), 0, 1 << 20, 1 << 31, 1 << 50, 1 << 63, (1 << 64) - 1, told * 2]
    head = data[at : at + 1] + U64.pack(other[rng.integers(len(other))])
    return Damage(data[:at] + head + data[at + 9 :], (at, at + 9))


def opcode(data: bytes, rng: np.random.Generator) -> Damage:
    """A record is of another kind."""
    at = _record(data, rng)[0]
    return Damage(data[:at] + bytes([int(rng.integers(1, 17))]) + data[at + 1 :], (at, at + 1))


def remove_record(data: bytes, rng: np.random.Generator) -> Damage:
    """A whole record is missing: a chunk, its index, the metadata."""
    begin, end = _record(data, rng)
    return Damage(data[:begin] + data[end:], (begin, end))


def duplicate_record(data: bytes, rng: np.random.Generator) -> Damage:
    """A whole record is there twice."""
    begin, end = _record(data, rng)
    return Damage(data[:end] + data[begin:], (end, end))


def swap_records(data: bytes, rng: np.random.Generator) -> Damage:
    """Two records in each other's place."""
    a, b = sorted((_record(data, rng), _record(data, rng)))
    if a == b:
        return swap_records(data, rng)
    swapped = data[: a[0]] + data[b[0] : b[1]] + data[a[1] : b[0]] + data[a[0] : a[1]] + data[b[1] :]
    return Damage(swapped, (a[0], b[1]))


def chunk_head(data: bytes, rng: np.random.Generator) -> Damage:
    """A field of a chunk's head is another: times, size, check sum, compression, length."""
    begin = _record(data, rng, Opcode.CHUNK)[0] + HEAD.size
    at = begin + int(rng.integers(36 + 4 + 8))
    noise = rng.integers(0, 256, int(rng.integers(1, 9)), np.uint8).tobytes()
    return Damage(data[:at] + noise + data[at + len(noise) :], (at, at + len(noise)))


def inside_chunk(data: bytes, rng: np.random.Generator) -> Damage:
    """A chunk whose records are others, under a check sum that is right: channels gone, numbers and texts changed."""
    begin, end = _record(data, rng, Opcode.CHUNK)
    chunk = Chunk(data[begin + HEAD.size : end])
    records = [(op, bytes(body)) for _, op, body in records_in(chunk.unpack())]
    which = int(rng.integers(4))
    if which == 0:
        records = [(op, body) for op, body in records if op != (Opcode.CHANNEL, Opcode.SCHEMA)[rng.integers(2)]]
    else:
        at = int(rng.integers(len(records)))
        op, body = records[at]
        place = int(rng.integers(min(len(body), (2, 22, len(body))[which - 1])))
        records[at] = op, body[:place] + bytes([int(rng.integers(256))]) + body[place + 1 :]
    unpacked = b"".join(HEAD.pack(op, len(body)) + body for op, body in records)
    return Damage(data[:begin] + chunk_record(unpacked, chunk) + data[end:], None)


def index_lies(data: bytes, rng: np.random.Generator) -> Damage:
    """A number of the index is another, under a check sum that is right."""
    footer = len(data) - len(MAGIC) - 20
    start = U64.unpack_from(data, footer)[0]
    places = [start + at for at, op, _ in records_in(data[start : footer - HEAD.size]) if op in _LYING]
    at = places[rng.integers(len(places))] + HEAD.size + 8 * int(rng.integers(4))
    number = (0, 1, 1 << 20, 1 << 50, (1 << 64) - 1)[rng.integers(5)]
    lied = bytearray(data[:at] + U64.pack(number) + data[at + 8 :])
    crc = zlib.crc32(lied[start : footer + 16])
    struct.pack_into("<I", lied, footer + 16, crc)
    return Damage(bytes(lied), (at, at + 8))


def bomb(data: bytes, rng: np.random.Generator) -> Damage:
    """A chunk of a few kB that unpacks to more than there is memory."""
    begin, end = _record(data, rng, Opcode.CHUNK)
    packed, told = BOMBS[rng.integers(len(BOMBS))]
    chunk = Chunk(data[begin + HEAD.size : end])
    return Damage(data[:begin] + packed_record(packed, "zstd", told, 0, chunk) + data[end:], (begin, end))


def chunk_record(unpacked: bytes, like: Chunk) -> bytes:
    """A chunk of these records, not packed, with the times of another."""
    return packed_record(unpacked, "", len(unpacked), zlib.crc32(unpacked), like)


def packed_record(packed: bytes, compression: str, size: int, crc: int, like: Chunk) -> bytes:
    """A chunk of that data, with the times of another."""
    builder = RecordBuilder()
    for number in (like.first_ns, like.last_ns, size):
        builder.write8(number)
    builder.write4(crc)
    builder.write_prefixed_string(compression)
    builder.write8(len(packed))
    body = builder.end() + packed
    return HEAD.pack(Opcode.CHUNK, len(body)) + body


def _bombs() -> list[tuple[bytes, int]]:
    pieces = zstandard.ZstdCompressor().compressobj()
    zeros = bytes(1 << 20)
    packed = b"".join([*(pieces.compress(zeros) for _ in range(200)), pieces.flush()])
    return [(packed, 3 << 30), (packed, 200 << 20), (packed, 1000), (packed, 1 << 50)]


BOMBS = _bombs()
_LYING = (Opcode.CHUNK_INDEX, Opcode.STATISTICS, Opcode.METADATA_INDEX)
MUTATIONS: dict[str, Callable[[bytes, np.random.Generator], Damage]] = {
    made.__name__: made
    for made in (
        flip, flips, truncate, zero, zero_tail, duplicate, remove, insert, length, opcode, remove_record,
        duplicate_record, swap_records, chunk_head, inside_chunk, index_lies, bomb,
    )
}  # fmt: skip


def records_of(data: bytes) -> list[tuple[int, int, int]]:
    """Where every record of a whole file begins and ends, and its opcode."""
    found, at = [], len(MAGIC)
    while at + HEAD.size <= len(data) - len(MAGIC):
        op, size = HEAD.unpack_from(data, at)
        found.append((at, at + HEAD.size + size, op))
        at += HEAD.size + size
    return found


def untouched(data: bytes, damage: Damage) -> list[tuple[int, int]]:
    """Where the chunks begin and end that the damage left alone."""
    if damage.touched is None:
        return []
    begin, end = damage.touched
    return [
        (a, b)
        for a, b, op in records_of(data)
        if op == Opcode.CHUNK and (b <= begin or a >= end) and not (begin == end and a < begin < b)
    ]


def payloads(data: bytes, chunks: list[tuple[int, int]]) -> list[bytes]:
    """The payloads of all messages in these chunks."""
    return [
        bytes(message.data) for begin, end in chunks for message in Chunk(data[begin + HEAD.size : end]).read().messages
    ]


def _range(data: bytes, rng: np.random.Generator, most: int) -> tuple[int, int]:
    begin = int(rng.integers(len(data)))
    return begin, min(begin + int(rng.integers(1, most)), len(data))


def _record(data: bytes, rng: np.random.Generator, kind: int | None = None) -> tuple[int, int]:
    found = [(begin, end) for begin, end, op in records_of(data) if kind in (None, op)]
    return found[rng.integers(len(found))]


def recordings(folder: Path, told: list[Message], images: list[Message]) -> dict[str, Path]:
    """Recordings of these messages in folder, as this version and version 0.1 write them, packed in each way."""
    made = {}
    for compression in _COMPRESSIONS:
        for name in (f"new {compression}", f"old {compression}"):
            place = made[name] = folder / name.replace(" ", "-")
            place.mkdir()
            for stem, messages, a_chunk in (("poses", told, 9), ("frames", images, 3)):
                if name.startswith("new"):
                    write_file(
                        place, stem, messages, compression, a_chunk, crc=compression != "zstd" or stem == "poses"
                    )
                else:
                    write_old(place / f"{stem}-0001.mcap", messages, compression, a_chunk)
    return made
