"""`asterism record` and `watch --json` against a server on loopback, as a person runs them."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import encode_rig, in_session, to_bytes
from asterism.protocol.messages import STATUS, Message
from asterism.protocol.network import open_server
from asterism.protocol.rig import Rig
from asterism.recordings.compare import compare
from asterism.recordings.mend import mend
from asterism.recordings.reader import Recording
from asterism.recordings.recorder import FramesKept, Recorder
from asterism.server.service.publish import Publisher
from asterism.server.sources.session_clock import SessionClock
from tests.recordings.mutations import hand_made, rig
from tests.recordings.reloaded import two_rigs
from tests.servers import free_endpoint, running, wait_for_line


class Serving:
    """A server without a camera: publishes and records frames made by hand."""

    def __init__(self, endpoint: str, parent: Path, of: Rig, frames: int, rng: np.random.Generator) -> None:
        self.clock = SessionClock()
        self.publisher = Publisher(open_server(endpoint), of.camera.name, encode_rig(of), self.clock)
        self.recorder = Recorder(parent, of, "test", FramesKept(0), wait=True)
        told, _ = hand_made(frames, rng)
        self._frames = [told[k : k + 3] for k in range(0, len(told), 3)]

    def tell(self, count: int) -> None:
        """The next frames."""
        for frame in self._frames[:count]:
            messages = [in_session(message, self.clock.session) for message in frame]
            out = self.publisher.publish(messages)
            self.recorder.write(out, None, out[-1].log_ns, out[-1].sequence)
        del self._frames[:count]

    def tell_status(self) -> None:
        now_ns = self.clock.now_ns()
        status = to_bytes(pb.Status(time_ns=now_ns, source="by hand", session=self.clock.session))
        self.publisher.publish([Message(keys.status("demo"), STATUS, status, now_ns, now_ns, 1)])

    def close(self) -> Recording:
        """End, as a server does; what it recorded."""
        self.publisher.close()
        self.recorder.close({})
        return Recording(self.recorder.folder)


@pytest.fixture
def endpoint() -> str:
    return free_endpoint()


@pytest.fixture
def serving(endpoint: str, tmp_path: Path, rng: np.random.Generator) -> Iterator[Serving]:
    made = Serving(endpoint, tmp_path / "own", rig(), 60, rng)
    yield made
    made.publisher.close()


def until(condition: Callable[[], object], timeout_s: float = 60.0) -> None:
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, "it did not come about"
        time.sleep(0.01)


Heard = dict[str, list[tuple[bytes, int, int, int]]]


def heard(recording: Recording) -> Heard:
    """What was published, by key and in order, but for the status, which does not tell its number."""
    keyed: Heard = {}
    for m in recording.messages():
        if m.kind.on_wire and m.kind.schema != STATUS.schema:
            keyed.setdefault(m.key, []).append((m.payload, m.log_ns, m.publish_ns, m.sequence))
    return keyed


def assert_same(listened: Heard, told: Heard) -> None:
    """The same in the same order, but that poses of a burst may be dropped on their way, as they may anywhere: the
    report of their frame is not, and holds them.
    """
    assert listened.keys() == told.keys()
    for key, messages in listened.items():
        if keys.robot_of(key) is None:
            assert messages == told[key]
        else:
            coming = iter(told[key])
            assert all(message in coming for message in messages), f"{key}: what was never told, or in another order"


def ended(recording: "subprocess.Popen[str]") -> tuple[int, str]:
    """Ctrl-C, and what it said."""
    recording.send_signal(signal.SIGINT)
    _, told = recording.communicate(timeout=60)
    return recording.returncode, told


def test_a_listener_records_the_very_bytes_that_servers_record(
    endpoint: str, tmp_path: Path, rng: np.random.Generator
) -> None:
    with running("record", tmp_path / "heard", "--connect", endpoint) as recording:
        wait_for_line(recording, f"waiting for a server at {endpoint}")
        serving = Serving(endpoint, tmp_path / "own", rig(), 40, rng)
        wait_for_line(recording, "which is all but images")
        until(lambda: serving.tell_status() or list((tmp_path / "heard").glob("demo-*")))
        serving.tell(40)
        own = serving.close()
        wait_for_line(recording, "camera 'demo': the server is gone; waiting for it")
        before, _ = two_rigs()
        again = Serving(endpoint, tmp_path / "own", before, 5, rng)  # a server that starts anew, with another rig
        until(lambda: again.tell_status() or len(list((tmp_path / "heard").iterdir())) == 2)
        again.tell(5)
        second = again.close()
        wait_for_line(recording, "the server is gone")
        code, told = ended(recording)
    assert (code, told.count("all of them arrived")) == (0, 1), told
    folders = sorted((tmp_path / "heard").iterdir(), key=lambda folder: (len(folder.name), folder.name))
    for folder, other in zip(folders, (own, second), strict=True):
        listened = Recording(folder)
        assert_same(heard(listened), heard(other))
        assert compare(listened, other).within(0.0, 0.0)
        assert encode_rig(listened.rig()) == encode_rig(other.rig())
        assert any(message.kind.schema == STATUS.schema for message in listened.messages())


def test_killed_it_has_lost_less_than_a_second(endpoint: str, serving: Serving, tmp_path: Path) -> None:
    with running("record", tmp_path / "heard", "--connect", endpoint) as recording:
        wait_for_line(recording, "which is all but images")
        until(lambda: serving.tell_status() or list((tmp_path / "heard").glob("demo-*/poses-0001.mcap")))
        serving.tell(30)
        (file,) = (tmp_path / "heard").glob("demo-*/poses-0001.mcap")
        size = file.stat().st_size
        until(lambda: file.stat().st_size > size + 2000)  # it is flushed by itself
        recording.kill()
        recording.wait()
    (mended,) = mend([file])
    assert mended.kept > 0
    kept = heard(Recording(file.parent))
    serving.recorder.close({})
    for key, own in heard(Recording(serving.recorder.folder)).items():
        assert kept[key] == own[: len(kept[key])]
        assert len(kept[key]) >= 20


def test_nothing_recorded_is_said(endpoint: str, tmp_path: Path) -> None:
    with running("record", tmp_path / "heard", "--connect", endpoint) as recording:
        wait_for_line(recording, "waiting for a server")
        code, told = ended(recording)
    assert code == 1
    assert "nothing was recorded: no server was found" in told
    assert not (tmp_path / "heard").exists()


@pytest.mark.parametrize("tells", [True, False], ids=["while frames come", "while nothing comes"])
def test_lines_end_with_their_reader(endpoint: str, serving: Serving, tells: bool) -> None:
    command = [sys.executable, "-m", "asterism.server", "watch", "--json", "--connect", endpoint]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as watching:
        assert watching.stdout is not None
        assert watching.stderr is not None
        link = json.loads(watching.stdout.readline())
        watching.stdout.close()
        until(lambda: (tells and serving.tell(1)) or watching.poll() is not None)
        assert watching.stderr.read() == ""
    assert (link["type"], link["camera"], link["link"]) == ("link", "demo", "live")
    assert watching.returncode == 0
