"""Bags of ROS: rosbag2 folders (storage mcap or sqlite3), single .db3 files, and ROS 1's .bag files.

MCAP files are read by `mcap_files`; the others need the package `rosbags`, the extra `ros`.
"""

import bz2
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path, PurePath
from typing import Any

import lz4.frame
import zstandard

from asterism.protocol.errors import InputError
from asterism.protocol.text_file import read_text
from asterism.protocol.yaml_file import Section, read_yaml, shortened
from asterism.recordings.chunks import MOST_BYTES
from asterism.server.sources.foreign.mcap_files import McapFiles
from asterism.server.sources.foreign.topics import Topic, Topics, ros2_name

METADATA = "metadata.yaml"
STORAGES = ("mcap", "sqlite3")


_INFORMATION = "rosbag2_bagfile_information"


def is_bag(folder: Path) -> bool:
    """Whether a folder is a rosbag2: others may hold a metadata.yaml too."""
    try:
        return _INFORMATION in read_text(folder / METADATA, "a bag's metadata")
    except InputError:
        return False


def open_folder(path: Path) -> Topics:
    """The bag that a rosbag2 folder is. Raises InputError."""
    section = read_yaml(path / METADATA).section(_INFORMATION)
    storage = section.text("storage_identifier", STORAGES)
    mode = str(section.values.get("compression_mode") or "none").lower()
    if mode not in ("none", "message"):
        raise section.error(
            "compression_mode",
            f"{shortened(mode)!r}, expected none or message; `ros2 bag convert` writes a bag without compression",
        )
    files = [path / name for name in _files(section)]
    for file in files:
        if not file.exists():
            raise section.error("relative_file_paths", f"there is no file {file}")
    if storage == "mcap":
        return McapFiles(str(path), files)
    return RosFiles(str(path), files, packed=mode == "message")


def _files(section: Section) -> list[str]:
    """Names of the bag's files; older bags tell them with the folder's."""
    told = section.values.get("relative_file_paths")
    if not isinstance(told, list) or not told or not all(isinstance(name, str) and name for name in told):
        raise section.error("relative_file_paths", "expected the names of the bag's files")
    return [PurePath(name).name for name in told]


class RosFiles:
    """SQLite files of rosbag2, or one .bag of ROS 1. ``packed``: every message is compressed by itself (zstd).

    Raises InputError for files that are damaged, ModuleNotFoundError without `rosbags`.
    """

    def __init__(self, name: str, paths: Sequence[Path], packed: bool = False) -> None:
        self.name = name
        self._paths = paths
        self._packed = packed
        counts: dict[tuple[str, str, str], int] = {}
        for path in paths:
            with _opened(path) as bag, _damage(path):
                for connection in bag.connections:
                    key = _key(connection)
                    counts[key] = counts.get(key, 0) + connection.msgcount
        self._topics = [Topic(*key, count) for key, count in counts.items()]

    def topics(self) -> list[Topic]:
        """All topics."""
        return self._topics

    def messages(self, topic: Topic) -> Iterator[tuple[int, bytes]]:
        """Times of receipt, ns, and payloads of a topic's messages, by time."""
        for path in self._paths:
            with _opened(path) as bag:
                with _damage(path):
                    wanted = [connection for connection in bag.connections if _key(connection) == topic[:3]]
                    messages = bag.messages(wanted) if wanted else iter(())
                while True:
                    with _damage(path):
                        found = next(messages, None)
                        if found is None:
                            break
                        _, time_ns, payload = found
                        if not isinstance(payload, bytes):
                            raise ValueError("a message that is no bytes")
                        if self._packed:
                            payload = _unzstd(payload)
                    yield time_ns, payload


def _key(connection: Any) -> tuple[str, str, str]:
    encoding = getattr(connection.ext, "serialization_format", "ros1")
    return connection.topic, ros2_name(connection.msgtype), encoding


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """A file by the reader of its kind."""
    from rosbags import rosbag1, rosbag2

    if not path.is_file():  # a pipe would hang
        raise InputError(f"{path}: is no regular file, expected one of a bag")
    with _damage(path):
        bag = rosbag1.Reader(path) if path.suffix == ".bag" else rosbag2.Reader(path)
        bag.open()
        if isinstance(bag, rosbag1.Reader):
            # Its own make as much room as a chunk asks for.
            bounded = {bz2.decompress: _bunzip2, lz4.frame.decompress: _unlz4}
            bag.chunks = {
                at: chunk._replace(decompressor=bounded.get(chunk.decompressor, chunk.decompressor))
                for at, chunk in bag.chunks.items()
            }
    try:
        yield bag
    finally:
        bag.close()


@contextmanager
def _damage(path: Path) -> Iterator[None]:
    """Says in a sentence what the reader stumbles over: damaged files make it raise anything."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        why = shortened(" ".join(str(error).split()) or type(error).__name__, 200)
        raise InputError(f"{path}: is damaged, or no bag ({why})") from None


def _unzstd(data: bytes) -> bytes:
    with zstandard.ZstdDecompressor(max_window_size=MOST_BYTES).stream_reader(data) as stream:
        return _bounded(stream.read)


def _bunzip2(data: bytes) -> bytes:
    return _bounded(lambda most: bz2.BZ2Decompressor().decompress(data, most))


def _unlz4(data: bytes) -> bytes:
    return _bounded(lambda most: lz4.frame.LZ4FrameDecompressor().decompress(data, most))


def _bounded(unpack: Callable[[int], bytes]) -> bytes:
    found = unpack(MOST_BYTES + 1)
    if len(found) > MOST_BYTES:
        raise ValueError(f"unpacks to more than the {MOST_BYTES} bytes that are read")
    return found
