"""Images in MCAP files and bags of other programs: read exactly, timed by their headers; refusals that help."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from mcap.writer import CompressionType
from numpy.typing import NDArray

from asterism.protocol.errors import InputError
from asterism.server.chain.frame import Frame
from asterism.server.sources.foreign.image_messages import ENCODINGS, picture
from asterism.server.sources.foreign.ros_messages import BadMessage, RawTold
from asterism.server.sources.open_source import open_source
from tests.rigs import make_camera, make_rig
from tests.sources.foreign.foreign_files import (
    ROS1,
    compressed,
    raw,
    ros_compressed,
    ros_image,
    ros_text,
    write_bag1,
    write_bag2,
    write_mcap,
)

RIG = make_rig(2, camera=make_camera(64, 48, 80.0))
BEGAN_NS, STEP_NS = 1_700_000_000_123_456_789, 16_666_667
COUNT = 5


def pattern(seed: int) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, (48, 64)).astype(np.uint8)


def png(image: NDArray[Any]) -> bytes:
    return cv2.imencode(".png", image)[1].tobytes()


def stamp(k: int) -> int:
    return BEGAN_NS + k * STEP_NS


def film(message: Callable[[NDArray[np.uint8], int], Any], topic: str = "/cam/image") -> list[tuple[str, int, Any]]:
    """Images that are written some time after they were taken, among other things."""
    said = [("/chatter", stamp(k) + 1, ros_text("hello")) for k in range(COUNT)]
    images = [(topic, stamp(k) + 5_000_000, message(pattern(k), stamp(k))) for k in range(COUNT)]
    return [entry for pair in zip(said, images, strict=True) for entry in pair]


def read(path: Path, topic: str | None = None, said: list[str] | None = None) -> list[Frame]:
    source = open_source(str(path), RIG, (said if said is not None else []).append, topic=topic)
    frames = list(source.frames())
    assert source.length in (None, len(frames) + source.unreadable)
    assert not source.live
    return frames


def check(frames: list[Frame]) -> None:
    """The film as it was taken."""
    assert [frame.exposed_ns for frame in frames] == [stamp(k) for k in range(COUNT)]
    assert [frame.index for frame in frames] == list(range(COUNT))
    for k, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.image, pattern(k))


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"compression": CompressionType.LZ4, "chunk_size": 1},
        {"compression": CompressionType.NONE},
        {"use_chunking": False},
        {"use_statistics": False, "repeat_channels": False, "repeat_schemas": False, "use_summary_offsets": False},
    ],
)
def test_images_in_an_mcap_file_are_read_exactly(tmp_path: Path, options: dict[str, Any]) -> None:
    check(read(write_mcap(tmp_path / "a.mcap", film(raw), **options)))
    check(read(write_mcap(tmp_path / "b.mcap", film(ros_image), **options)))


@pytest.mark.parametrize(
    "message",
    [
        lambda image, at: raw(image, at, pad=13),
        lambda image, at: raw(image, at, "8UC1"),
        lambda image, at: compressed(png(image), at),
        lambda image, at: ros_compressed(png(image), at, "mono8; png compressed "),
    ],
)
def test_kinds_of_images(tmp_path: Path, message: Callable[..., Any]) -> None:
    check(read(write_mcap(tmp_path / "a.mcap", film(message))))


@pytest.mark.parametrize(
    ("storage", "packed"), [("sqlite3", None), ("sqlite3", "message"), ("mcap", None), ("mcap", "storage")]
)
def test_rosbag2_folders(tmp_path: Path, storage: str, packed: str | None) -> None:
    bag = write_bag2(tmp_path / "bag", film(ros_image), storage, packed)
    check(read(bag))
    check(read(bag, "/cam/image"))
    if packed is None:
        check(read(next(file for file in bag.iterdir() if file.suffix != ".yaml")))


@pytest.mark.parametrize("packed", [None, "bz2", "lz4"])
def test_bags_of_ros_1(tmp_path: Path, packed: str | None) -> None:
    images = [("/cam/image", stamp(k) + 5_000_000, ros_image(pattern(k), stamp(k), store=ROS1)) for k in range(COUNT)]
    check(read(write_bag1(tmp_path / "a.bag", images, packed)))
    small = [("/c", stamp(k), ros_compressed(png(pattern(k)), stamp(k), "png", ROS1)) for k in range(COUNT)]
    check(read(write_bag1(tmp_path / "b.bag", small, packed)))


def test_without_a_stamp_the_time_of_writing_holds(tmp_path: Path) -> None:
    messages = [("/i", stamp(k) + 7, raw(pattern(k), 0)) for k in range(COUNT)]
    frames = read(write_mcap(tmp_path / "a.mcap", messages))
    assert [frame.exposed_ns for frame in frames] == [stamp(k) + 7 for k in range(COUNT)]


def test_what_holds_no_image_is_said_counted_and_skipped(tmp_path: Path) -> None:
    messages = film(raw, "/i")
    bad = raw(pattern(1), stamp(1))
    bad.step = 65
    messages[3] = ("/i", stamp(1) + 5_000_000, bad)
    said: list[str] = []
    frames = read(write_mcap(tmp_path / "a.mcap", messages), None, said)
    assert [frame.index for frame in frames] == [0, 2, 3, 4]
    (sentence,) = said
    assert re.search(
        r"a\.mcap, /i, message 1: 3072 bytes in rows of 65 bytes, expected 48 rows of at least 64 \(64x48, mono8\); "
        "skipped",
        sentence,
    )


@pytest.mark.parametrize(
    ("messages", "topic", "words"),
    [
        (
            [("/chatter", 1, ros_text("a")), ("/alarm", 1, ros_text("b"))],
            None,
            r"has no topic with images \(foxglove.RawImage, .*\); it has /alarm \(std_msgs/String\), /chatter",
        ),
        ([], None, r"has no topic with images .*; it has no topics"),
        (
            [("/a", 1, raw(pattern(0), 1)), ("/b", 1, ros_image(pattern(0), 1))],
            None,
            r"has several topics with images; choose by --topic: /a \(foxglove.RawImage\), /b \(sensor_msgs/Image\)",
        ),
        ([("/chatter", 1, ros_text("a"))], "/chatter", r"topic /chatter is std_msgs/String \(cdr\), expected images"),
        ([("/a", 1, raw(pattern(0), 1))], "/x", r"has no topic /x; it has /a \(foxglove.RawImage\)"),
        ([("/a", 1, raw(pattern(0), 1, "32FC1"))], None, r"/a, message 0: encoding '32FC1', expected one of mono8, "),
        ([("/a", 1, raw(np.zeros((40, 60), np.uint8), 1))], None, "the image is 60x40, expected 64x48"),
        ([("/a", 1, compressed(b"\0\0\0\1", 1, "h264"))], None, r"none of the 1 images on /a can be read"),
    ],
)
def test_refusals_tell_what_there_is(tmp_path: Path, messages: list[Any], topic: str | None, words: str) -> None:
    with pytest.raises(InputError, match=words):
        read(write_mcap(tmp_path / "a.mcap", messages), topic)


def test_topics_are_for_what_has_them(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), pattern(1))
    with pytest.raises(InputError, match=r"--topic /a: .*a\.png has no topics; they are in MCAP files and bags"):
        open_source(str(tmp_path / "a.png"), RIG, print, topic="/a")
    (tmp_path / "b").mkdir()
    write_mcap(tmp_path / "b" / "some.mcap", film(raw))
    with pytest.raises(InputError, match=r"is neither a recording .* nor a bag .*; name one of the files"):
        open_source(str(tmp_path / "b"), RIG, print)


def refusal(path: Path) -> str:
    """The sentence in which reading a file ends, or nothing."""
    try:
        assert all(frame.image.shape == (48, 64) for frame in read(path))
    except InputError as problem:
        return str(problem)
    return ""


def test_a_folder_of_images_may_hold_other_metadata(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), pattern(1))
    (tmp_path / "metadata.yaml").write_text("made_by: somebody\n")
    assert [frame.name for frame in read(tmp_path)] == ["a.png"]


def test_a_topics_name_moves_no_cursor(tmp_path: Path) -> None:
    messages = [(f"/{name}\x1b[2J", 1, raw(pattern(0), 1)) for name in ("a", "b")]
    with pytest.raises(InputError, match=r"'/a\\x1b\[2J' \(foxglove.RawImage\)"):
        read(write_mcap(tmp_path / "a.mcap", messages))


@pytest.mark.parametrize("kind", ["mcap", "cdr.mcap", "db3", "bag"])
def test_damaged_files_end_in_a_sentence(tmp_path: Path, kind: str, rng: np.random.Generator) -> None:
    """Whatever is cut off or changed: frames, or one sentence."""
    path = tmp_path / f"whole.{kind}"
    if kind == "db3":
        path = next(write_bag2(tmp_path / "bag", film(ros_image)).glob("*.db3"))
    elif kind == "bag":
        write_bag1(path, [("/i", stamp(k), ros_image(pattern(k), stamp(k), store=ROS1)) for k in range(2)], "lz4")
    else:
        write_mcap(path, film(raw if kind == "mcap" else ros_image), compression=CompressionType.NONE)
    whole, bad = path.read_bytes(), tmp_path / f"bad{path.suffix}"
    refused = 0
    for trial in range(60):
        data = bytearray(whole[: int(rng.integers(len(whole)))] if trial % 3 == 0 else whole)
        for _ in range(0 if trial % 3 == 0 else 4):
            data[int(rng.integers(len(data)))] = int(rng.integers(256))
        bad.write_bytes(bytes(data))
        sentence = refusal(bad)
        assert "\n" not in sentence
        assert not sentence or "bad" in sentence
        refused += bool(sentence)
    assert refused >= 15


def test_a_bags_metadata_are_read_strictly(tmp_path: Path) -> None:
    bag = write_bag2(tmp_path / "bag", film(ros_image), packed="file")
    with pytest.raises(InputError, match=r"compression_mode: 'file', expected none or message; `ros2 bag convert`"):
        read(bag)
    metadata = bag / "metadata.yaml"
    text = metadata.read_text()
    metadata.write_text(text.replace("storage_identifier: sqlite3", "storage_identifier: leveldb"))
    with pytest.raises(InputError, match="storage_identifier: 'leveldb', expected one of mcap, sqlite3"):
        read(bag)
    for file in bag.glob("*.db3*"):
        file.unlink()
    metadata.write_text(re.sub("compression_mode: .*", "compression_mode: NONE", text))
    with pytest.raises(InputError, match="relative_file_paths: there is no file"):
        read(bag)


def colours(encoding: str) -> NDArray[Any]:
    """An even grey in every encoding."""
    pixels = ENCODINGS[encoding]
    value = np.full((48, 64, pixels.channels), 100, np.uint8) if pixels.size == 1 else None
    image = value if value is not None else np.full((48, 64, pixels.channels), 25_700, np.uint16)
    if "yu" in encoding or encoding == "uyvy":
        image[..., 0 if encoding in ("yuv422", "uyvy") else 1] = 128
    return image


@pytest.mark.parametrize("encoding", list(ENCODINGS))
def test_every_encoding_comes_out_grey(encoding: str) -> None:
    message = raw(colours(encoding), 5, encoding)
    told = RawTold(5, 64, 48, message.step, encoding, False, message.data)
    image = picture(told, lambda *_: None).image
    assert image.shape == (48, 64)
    assert set(np.unique(image)) <= ({100} if image.dtype == np.uint8 else {25_700})
    if ENCODINGS[encoding].size == 2:
        swapped = np.frombuffer(message.data, np.uint16).byteswap().tobytes()
        big = picture(RawTold(5, 64, 48, message.step, encoding, True, swapped), lambda *_: None).image
        np.testing.assert_array_equal(big, image)


def test_colours_are_told_apart() -> None:
    """Red is darker than green, whichever comes first."""
    red = np.zeros((4, 4, 3), np.uint8)
    red[..., 0] = 200
    message = raw(red, 1, "rgb8")

    def grey(encoding: str) -> int:
        told = RawTold(1, 4, 4, message.step, encoding, False, message.data)
        return int(picture(told, lambda *_: None).image[0, 0])

    assert (grey("rgb8"), grey("bgr8")) == (60, 23)


@pytest.mark.parametrize(
    ("width", "height", "step", "encoding", "size"),
    [
        (2**31, 2**31, 2**31, "mono8", 10),
        (0, 48, 0, "mono8", 0),
        (64, 48, 0, "mono8", 3072),
        (64, 48, 64, "mono8", 3071),
        (64, 48, 64, "rgb8", 3072),
    ],
)
def test_pixels_that_are_not_what_they_say_are_refused(
    width: int, height: int, step: int, encoding: str, size: int
) -> None:
    told = RawTold(0, width, height, step, encoding, False, bytes(size))
    with pytest.raises(BadMessage):
        picture(told, lambda *_: None)
