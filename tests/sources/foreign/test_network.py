"""Images from the network: stamps, loss and return, and nothing that comes in ends a server."""

import itertools
import json
import threading
import time
from collections.abc import Iterator

import cv2
import numpy as np
import pytest
import zenoh
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from numpy.typing import NDArray

from asterism.protocol.capture import Capture
from asterism.protocol.errors import InputError
from asterism.protocol.messages import Clock
from asterism.protocol.network import open_server
from asterism.protocol.rig import Rig
from asterism.server.sources.foreign.network import COMPRESSED, RAW, NetworkImages
from asterism.server.sources.foreign.remote_stamps import SET_NS, RemoteStamps
from asterism.server.sources.open_source import open_source, refuse_endless
from asterism.server.sources.source import LiveSource
from tests.clients.serving import until
from tests.rigs import make_camera, make_rig
from tests.servers import free_endpoint
from tests.sources.foreign.foreign_files import compressed, raw

RIG = make_rig(2, camera=make_camera(64, 48, 80.0))
KEY = "cell/cam"
S = 10**9


def pattern(seed: int) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, (48, 64)).astype(np.uint8)


def png(image: NDArray[np.uint8]) -> bytes:
    return cv2.imencode(".png", image)[1].tobytes()


class Wire:
    """A server's session with a source in it, and a stranger's that publishes."""

    def __init__(self, rig: Rig | None = RIG) -> None:
        endpoint = free_endpoint()
        self.server = open_server(endpoint)
        self.said: list[str] = []
        self.heard = threading.Condition()
        source = open_source(f"zenoh:{KEY}", rig, self._say)
        assert isinstance(source, NetworkImages)
        assert isinstance(source, LiveSource)
        self.source = source
        source.join(self.server, listens=True)
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", json.dumps([endpoint]))
        config.insert_json5("scouting/multicast/enabled", "false")
        self.stranger = zenoh.open(config)

    def _say(self, text: str) -> None:
        with self.heard:
            self.said.append(text)
            self.heard.notify_all()

    def put(self, payload: bytes, encoding: str = RAW) -> None:
        self.stranger.put(KEY, payload, encoding=zenoh.Encoding(encoding))

    def wait_for(self, words: str) -> None:
        with self.heard:
            assert self.heard.wait_for(lambda: any(words in text for text in self.said), 20.0), self.said

    def close(self) -> None:
        self.source.close()
        self.stranger.close()
        self.server.close()


@pytest.fixture
def wire() -> Iterator[Wire]:
    made = Wire()
    yield made
    made.close()


def test_images_of_both_kinds_come_through_exactly_and_by_their_own_clock(wire: Wire) -> None:
    """The camera's host is an hour ahead."""
    ahead_ns = wire.source.clock.now_ns() + 3600 * S
    frames = wire.source.frames()
    for k, (payload, encoding) in enumerate(
        [
            (raw(pattern(0), ahead_ns, pad=5).SerializeToString(), RAW),
            (compressed(png(pattern(1)), ahead_ns + 1_000_000).SerializeToString(), COMPRESSED),
            (raw(pattern(2), ahead_ns + 2_000_000).SerializeToString(), "zenoh/bytes"),
            (compressed(png(pattern(3)), ahead_ns + 3_000_000).SerializeToString(), "application/octet-stream"),
        ]
    ):
        wire.put(payload, encoding)
        frame = next(frames)
        np.testing.assert_array_equal(frame.image, pattern(k))
        assert (frame.index, frame.clock) == (k, Clock.CAMERA)
        assert frame.session == wire.source.clock.session
        assert frame.exposed_ns <= frame.arrived_ns < frame.exposed_ns + 20 * S
    wire.put(raw(pattern(4), 0).SerializeToString())
    frame = next(frames)
    assert (frame.clock, frame.exposed_ns) == (Clock.ARRIVAL, frame.arrived_ns)


def test_silence_is_said_and_so_is_the_return(wire: Wire, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("asterism.server.sources.foreign.arriving.SILENT_S", 0.05)
    taken: list[int] = []
    thread = threading.Thread(target=lambda: taken.extend(frame.index for frame in wire.source.frames()))
    thread.start()
    wire.wait_for(f"zenoh:{KEY}: no images for 0.1 s; waiting for them")
    assert wire.source.problem == wire.said[0]
    wire.put(raw(pattern(0), 1).SerializeToString())
    wire.wait_for(f"zenoh:{KEY}: images come")
    wire.source.close()
    thread.join(10.0)
    assert not thread.is_alive()
    assert taken == [0]


def test_who_has_no_time_for_them_is_not_told_that_none_come(wire: Wire, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("asterism.server.sources.foreign.arriving.SILENT_S", 0.001)
    for k in range(3):
        wire.put(raw(pattern(k), k + 1).SerializeToString())
    until(lambda: wire.source._arrived.qsize() == 3)
    frames = wire.source.frames()
    for k in range(3):
        assert next(frames).index == k
        time.sleep(0.01)  # who takes them is busy
    assert wire.said == []


def test_what_comes_instead_of_images_is_said(wire: Wire, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("asterism.server.sources.foreign.arriving.SILENT_S", 0.05)
    stop = threading.Event()

    def flood() -> None:
        while not stop.is_set():
            wire.put(b"noise", "text/plain")

    taking = threading.Thread(target=lambda: list(wire.source.frames()))
    flooding = threading.Thread(target=flood)
    taking.start()
    flooding.start()
    wire.wait_for("no images for 0.1 s; what comes is none (zenoh:cell/cam, message ")
    stop.set()
    flooding.join()
    wire.source.close()
    taking.join(10.0)
    assert not taking.is_alive()


def hostile() -> list[tuple[bytes, str]]:
    """What is no image of this camera."""
    small = raw(pattern(0), 5)
    huge = RawImage(width=2**32 - 1, height=2**32 - 1, step=2**32 - 1, encoding="mono8", data=b"1")
    bomb = bytearray(png(pattern(0)))
    bomb[16:24] = (60_000).to_bytes(4, "big") * 2
    wrong = raw(pattern(0), 5)
    wrong.step = 7
    return [
        (b"", RAW),
        (b"\xff" * 100, RAW),
        (huge.SerializeToString(), RAW),
        (wrong.SerializeToString(), RAW),
        (raw(pattern(0), 5, "32FC1").SerializeToString(), RAW),
        (raw(np.zeros((10, 10), np.uint8), 5).SerializeToString(), RAW),
        (raw(np.full((48, 64), 60_000, np.uint16), 2**63 - 1 - 10**9, "mono16").SerializeToString(), "text/plain"),
        (compressed(bytes(bomb), 5).SerializeToString(), COMPRESSED),
        (compressed(png(pattern(0))[:200], 5).SerializeToString(), COMPRESSED),
        (compressed(b"\0\0\0\1\x67", 5, "h264").SerializeToString(), COMPRESSED),
        (small.SerializeToString(), COMPRESSED),
        (small.SerializeToString()[:-1], ""),
        (b"not an image", ""),
    ]


def test_nothing_that_comes_in_ends_a_server(wire: Wire) -> None:
    frames = wire.source.frames()
    for number, (payload, encoding) in enumerate(hostile()):
        wire.put(payload, encoding)
        wire.put(raw(pattern(number), 5 + number).SerializeToString())
        frame = next(frames)
        assert frame.index == 2 * number + 1
        np.testing.assert_array_equal(frame.image, pattern(number))
    assert wire.source.unreadable == len(hostile())
    # Said once, however many come.
    assert len([text for text in wire.said if "skipped" in text]) == 1


def test_a_message_longer_than_any_image_is_not_kept(wire: Wire, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("asterism.server.sources.foreign.arriving.MOST_BYTES", 4000)
    wire.put(raw(pattern(0), 5, pad=100).SerializeToString())
    wire.put(raw(pattern(1), 6).SerializeToString())
    assert next(wire.source.frames()).index == 1
    assert "message 0: is longer than 0 MB" in wire.said[0]


@pytest.mark.parametrize("seconds", [-1, -(2**62), 253_402_300_800, 2**63 - 1])
def test_a_stamp_may_be_anything(wire: Wire, seconds: int) -> None:
    message = raw(pattern(1), 5)
    message.timestamp.seconds = seconds
    frames = wire.source.frames()
    wire.put(message.SerializeToString())
    frame = next(frames)
    assert frame.arrived_ns - S < frame.exposed_ns <= frame.arrived_ns


def test_of_images_that_come_too_fast_the_newest_win(wire: Wire) -> None:
    for k in range(10):
        wire.put(raw(pattern(k), k + 1).SerializeToString())
    frames = wire.source.frames()
    newest = next(frame for frame in frames if frame.index == 9)
    np.testing.assert_array_equal(newest.image, pattern(9))
    assert wire.source.missed <= 7


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("zenoh:", "zenoh:: is no zenoh key, expected one such as zenoh:cell/camera"),
        ("zenoh:/a", "is no zenoh key"),
        ("zenoh:a//b", "is no zenoh key"),
        ("zenoh:a/*", "is the key of many, expected one camera's"),
        ("zenoh:**", "is the key of many"),
    ],
)
def test_wrong_keys_are_refused(text: str, words: str) -> None:
    with pytest.raises(InputError, match=words.replace("*", r"\*")):
        open_source(text, RIG, print)


def test_a_key_under_which_nobody_is_heard_is_refused(wire: Wire) -> None:
    for key in ("asterism/cam/image", "replay/asterism/cam/image"):
        source = NetworkImages(key, RIG, print)
        with pytest.raises(InputError, match="nobody else speaks under asterism/\\*\\*; publish under another key"):
            source.join(wire.server, listens=True)
    with pytest.raises(InputError, match="zenoh:a: has no end; locate takes a folder"):
        refuse_endless("zenoh:a", "locate")
    with pytest.raises(InputError, match="--topic /i: zenoh:a has no topics"):
        open_source("zenoh:a", RIG, print, topic="/i")


def stamps(**capture: float) -> RemoteStamps:
    return RemoteStamps(Capture(**capture))  # type: ignore[arg-type]


def test_stamps_of_another_clock_are_mapped_by_the_least_delay_seen() -> None:
    mapped, delays = stamps(), itertools.cycle([9_000_000, 3_000_000, 7_000_000])
    errors = []
    for k in range(300):
        taken_ns = 50 * S + k * 16_000_000
        told_ns = 1_700_000_000 * S + taken_ns
        middle_ns = mapped.middle_ns(told_ns, taken_ns + next(delays))
        assert middle_ns is not None
        errors.append(middle_ns - taken_ns)
    # What of the delay is always there stays.
    assert all(abs(error - 3_000_000) < 500_000 for error in errors[2:])


def test_the_stamp_may_be_the_start_or_the_end_of_the_exposure() -> None:
    for stamp, middle_ns in (("start", 400_000), ("middle", 0), ("end", -400_000)):
        mapped = RemoteStamps(Capture(exposure_us=800.0, stamp=stamp))
        mapped.middle_ns(1 * S, 5 * S)
        assert mapped.middle_ns(1 * S + 500_000_000, 5 * S + 510_000_000) == 5 * S + 500_000_000 + middle_ns


def test_a_stamp_that_tells_nothing_and_one_that_was_overtaken() -> None:
    mapped = stamps()
    assert mapped.middle_ns(0, 5 * S) is None
    assert mapped.middle_ns(-7, 5 * S) is None
    assert mapped.middle_ns(S, 5 * S) == 5 * S
    assert mapped.middle_ns(S, 5 * S + 16_000_000) is None
    assert mapped.middle_ns(S + 32_000_000, 5 * S + 32_000_000) == 5 * S + 32_000_000
    assert mapped.middle_ns(S + 16_000_000, 5 * S + 33_000_000) == 5 * S + 16_000_000


def test_what_waited_on_its_way_does_not_look_fresh_and_a_clock_that_was_set_is_followed() -> None:
    mapped, at_ns = stamps(), 100 * S
    for k in range(50):
        mapped.middle_ns(10 * S + k * 16_000_000, at_ns + k * 16_000_000)
    # A burst that waited for two seconds.
    for k in range(50, 150):
        middle_ns = mapped.middle_ns(10 * S + k * 16_000_000, at_ns + 150 * 16_000_000 + 2 * S + k)
        assert middle_ns is not None
        assert abs(middle_ns - (at_ns + k * 16_000_000)) < 1_000_000
    assert mapped.middle_ns(15 * S, at_ns + 5 * S + 1_000_000) == pytest.approx(at_ns + 5 * S, abs=1_000_000)
    # The clock is set back: images are as old as they look for a while, then it is followed.
    for k in range(400):
        arrived_ns = at_ns + 10 * S + k * 16_000_000
        middle_ns = mapped.middle_ns(1 * S + k * 16_000_000, arrived_ns)
        assert middle_ns is not None
        if k * 16_000_000 < SET_NS:
            assert arrived_ns - middle_ns > 18 * S
        else:
            assert arrived_ns - middle_ns < 20_000_000
