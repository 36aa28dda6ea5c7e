"""asterism reload, and SIGHUP: the rig is read again between two frames, whole or not at all."""

import signal
import socket
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import zenoh

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.capture import Capture
from asterism.protocol.codec import decode_frame_report, decode_rig, decode_status
from asterism.protocol.errors import InputError
from asterism.protocol.network import client_config
from asterism.protocol.rig import load_rig
from asterism.recordings.held import WRITER
from asterism.recordings.reader import Recording
from asterism.recordings.room import RESERVE
from asterism.server.__main__ import main
from asterism.server.command.reload import refuse_what_cannot_reload
from asterism.server.service.on_air import Place, on_air
from asterism.server.service.reload import refuse_another_camera, settings_left
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.sources.session_clock import SessionClock
from tests.command.test_command_line import refused
from tests.rigs import make_camera, make_rig
from tests.servers import free_endpoint, running, wait_for_line

TIMEOUT_S = 60.0


class Client:
    """What a client hears of a server: its frame reports in order, its newest status."""

    def __init__(self, endpoint: str) -> None:
        self.session = zenoh.open(client_config(endpoint))
        self.reports: list[pb.FrameReport] = []
        self.status = pb.Status()
        self.changed = threading.Condition()
        self.session.declare_subscriber(keys.frame("demo"), self._frame)
        self.session.declare_subscriber(keys.status("demo"), self._status)

    def _frame(self, sample: zenoh.Sample) -> None:
        with self.changed:
            self.reports.append(decode_frame_report(sample.payload.to_bytes()))
            self.changed.notify_all()

    def _status(self, sample: zenoh.Sample) -> None:
        with self.changed:
            self.status = decode_status(sample.payload.to_bytes())
            self.changed.notify_all()

    def frames(self, count: int) -> None:
        """Wait for so many more."""
        with self.changed:
            end = len(self.reports) + count
            assert self.changed.wait_for(lambda: len(self.reports) >= end, TIMEOUT_S)

    def problem(self, words: str) -> None:
        """Wait for a status whose problem holds the words, or where they are empty for one without."""
        with self.changed:
            assert self.changed.wait_for(
                lambda: words in self.status.problem if words else not self.status.problem, TIMEOUT_S
            )

    def rig(self) -> "pb.RigReport":
        return next(decode_rig(reply.ok.payload.to_bytes()) for reply in self.session.get(keys.rig("demo")) if reply.ok)


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    """A copy of the demo's rig, to be edited."""
    for file in DEMO_RIG.parent.glob("*.yaml"):
        (tmp_path / file.name).write_text(file.read_text())
    return tmp_path / DEMO_RIG.name


@pytest.fixture
def told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[socket.socket]:
    """What a server tells systemd."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(tmp_path / "notify"))
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        yield listener


def without_echo(text: str) -> str:
    return text[: text.index("  echo:")]


def test_a_running_server_reads_its_rig_again(
    rig: Path, tmp_path: Path, told: socket.socket, capsys: pytest.CaptureFixture[str]
) -> None:
    endpoint, text = free_endpoint(), rig.read_text()
    ask = ["reload", "--connect", endpoint]
    with running("serve", rig, "sim", "--listen", endpoint, "--record", tmp_path / "rec") as server:
        wait_for_line(server, "recording to")
        client = Client(endpoint)
        client.frames(5)
        began = client.rig()
        # One robot less.
        rig.write_text(without_echo(text))
        assert main(ask) == 0
        assert "camera 'demo' (process" in (said := capsys.readouterr().out)
        assert "is in force after" in said
        assert said.endswith("4 robots\n")
        assert [robot.id for robot in client.rig().robots] == ["alpha", "bravo", "charlie", "delta"]
        client.frames(5)
        # One that is wrong: refused whole, with the sentence, and told until the next that is right.
        rig.write_text(text.replace("range: [0.9, 1.6]", "range: [1.6, 0.9]"))
        sentence = "rig.yaml: range: [1.6, 0.9], expected 0 < nearest < farthest, m; the one before stays in force"
        assert sentence in refused(capsys, *ask)
        client.problem("expected 0 < nearest < farthest")
        assert sentence in wait_for_line(server, "was not read again")
        client.frames(5)
        assert len(client.reports[-1].robots) == 4
        rig.write_text(text)
        server.send_signal(signal.SIGHUP)
        client.problem("")
        client.frames(5)
        client.session.close()
        # A second Ctrl-C, and more, change nothing.
        for number in (signal.SIGINT, signal.SIGINT, signal.SIGTERM, signal.SIGINT):
            server.send_signal(number)
        _, ended = server.communicate(timeout=TIMEOUT_S)
    assert server.returncode == 0
    assert "Traceback" not in ended
    assert began.reloads == pb.Reloads()
    # No frame was lost, each was told with the rig in force, and who was followed was followed on.
    folder = next((tmp_path / "rec").iterdir())
    messages = Recording(folder).messages()
    recorded = [decode_frame_report(m.payload) for m in messages if m.key == keys.frame("demo")]
    assert [report.sequence for report in recorded] == list(range(counted(ended)))
    for reports in (recorded, client.reports):
        counts = [len(report.robots) for report in reports]
        assert [count for count, before in zip(counts, [0, *counts], strict=False) if count != before] == [5, 4, 5]
    located = {pb.TRACKED, pb.TILT_AMBIGUOUS}
    assert all(robot.state in located for report in recorded for robot in report.robots)
    # The recording holds each rig with its frames, and ended in order.
    names = sorted(path.name for path in folder.iterdir())
    assert [name for name in names if name.startswith("poses")] == [f"poses-000{n}.mcap" for n in (1, 2, 3)]
    assert not {RESERVE, WRITER} & set(names)
    assert [len(load(folder, name, tmp_path).robots) for name in names if name.startswith("poses")] == [5, 4, 5]
    assert Recording(folder).count_frames() == counted(ended)
    words = told_by_now(told)
    assert words == ["READY=1", *["RELOADING=1", "READY=1"] * 3, "STOPPING=1"]


def load(folder: Path, name: str, scratch: Path) -> "pb.RigReport":
    """The rig that one file of the recording tells."""
    alone = scratch / f"alone-{name}"
    alone.mkdir()
    (alone / "poses-0001.mcap").symlink_to(folder / name)
    return Recording(alone).rig()  # type: ignore[return-value]


def counted(said: str) -> int:
    return int(said.partition("stopped after ")[2].split()[0])


def told_by_now(listener: socket.socket) -> list[str]:
    """The first line of every datagram."""
    listener.setblocking(False)
    words = []
    while True:
        try:
            words.append(listener.recv(4096).decode().splitlines()[0])
        except BlockingIOError:
            return words


def test_another_camera_is_refused_and_settings_wait_for_the_next_start() -> None:
    served = make_rig(2)
    refuse_another_camera(make_rig(3), served, "rig.yaml")
    for camera, words in (
        (make_camera(name="left"), "rig.yaml: its camera is 'left', expected 'test'"),
        (make_camera(640, 512), "rig.yaml: its camera's images are 640x512, expected 1280x1024 as served"),
    ):
        with pytest.raises(InputError, match=words):
            refuse_another_camera(make_rig(2, camera=camera), served, "rig.yaml")
    moved = replace(served, capture=Capture(offset=(8, 0)))
    with pytest.raises(
        InputError, match=r"offset and binning are \(8, 0\) and 1, expected None and 1 as the camera was"
    ):
        refuse_another_camera(moved, served, "rig.yaml")
    assert settings_left(served, make_rig(3)) == ""
    triggered = replace(served, capture=Capture(gain=3.0, trigger="Line1", delay_us=20.0))
    left = "capture.gain, capture.trigger, capture.delay_us: the camera takes that at the next start"
    assert settings_left(served, triggered) == left


def test_what_is_not_there_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    endpoint = free_endpoint()
    assert "no server answers there" in refused(capsys, "reload", "--connect", endpoint, code=1)
    assert "expected PROTOCOL/ADDRESS" in refused(capsys, "reload", "--connect", "x")
    assert "camera '*': holds '*'" in refused(capsys, "reload", "*")
    with on_air(Place(listen=endpoint), load_rig(DEMO_RIG), SessionClock(), lambda: None):
        assert "no server of a camera 'x' answers" in refused(capsys, "reload", "x", "--connect", endpoint, code=1)
        assert "expected asterism serve" in refused(capsys, "reload", "--connect", endpoint)


def test_no_process_but_the_server_on_this_machine_gets_the_signal(tmp_path: Path) -> None:
    asked = pb.RigReport(camera="cam", host="here", pid=12, reloads=pb.Reloads())
    with pytest.raises(InputError, match=r"by process 12 on here, and this is there; expected this command there"):
        refuse_what_cannot_reload(asked, "there")
    with pytest.raises(InputError, match=r"process 12 of this machine is not its server"):
        refuse_what_cannot_reload(asked, "here", tmp_path)
    (tmp_path / "12").mkdir()
    (tmp_path / "12" / "cmdline").write_bytes(b"bash\0server\0")
    with pytest.raises(InputError, match=r"process 12 of this machine is not its server"):
        refuse_what_cannot_reload(asked, "here", tmp_path)
    (tmp_path / "12" / "cmdline").write_bytes(b"python\0/usr/bin/asterism\0serve\0rig.yaml\0sim\0")
    refuse_what_cannot_reload(asked, "here", tmp_path)
    refuse_what_cannot_reload(asked, "here", tmp_path / "none")  # a system that shows no processes
