"""`asterism fuse` live, as a person starts and ends it; and what listens to it records it."""

import contextlib
import signal
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import zenoh

from asterism.protocol import keys
from asterism.protocol.messages import FRAME_REPORT
from asterism.protocol.network import client_config
from asterism.recordings.from_network import arrived
from asterism.recordings.reader import Recording
from asterism.server.__main__ import main
from asterism.server.service.listening import Listening
from tests.servers import free_endpoint, open_router, running, wait_for_line
from tests.service.fusing.listener import Listener
from tests.service.fusing.speaking import Speaker
from tests.several import Drive, facing_pair, rigs_at

RIGS = rigs_at(facing_pair())
DRIVE = Drive(tuple(robot.id for robot in RIGS[0].robots))


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("-o", "out.jsonl"), "-o is for recordings"),
        (("--record", "out"), "--record is for recordings; what is joined live is recorded by `asterism record"),
        (("--listen", "tcp/127.0.0.1:9", "--join", "tcp/127.0.0.1:9"), "--listen and --join exclude each other"),
        (("--connect", "nonsense"), "endpoint 'nonsense': expected PROTOCOL/ADDRESS"),
        (("--camera", "a/b"), "--camera 'a/b': the name holds '/'"),
    ],
)
def test_what_makes_no_sense_is_refused(words: tuple[str, ...], told: str, capsys: pytest.CaptureFixture[str]) -> None:
    where = () if "--listen" in words else ("--listen", free_endpoint())
    assert main(["fuse", *words, *where]) == 2
    assert told in capsys.readouterr().err


def test_where_nobody_answers_the_world_has_failed(capsys: pytest.CaptureFixture[str]) -> None:
    nowhere = free_endpoint()
    assert main(["fuse", "--connect", nowhere, "--listen", free_endpoint()]) == 1
    assert f"{nowhere}: no server answers there" in capsys.readouterr().err


@contextlib.contextmanager
def telling(speakers: list[Speaker]) -> Iterator[None]:
    """They tell of frames all the while."""
    stop = threading.Event()

    def tell() -> None:
        while not stop.wait(0.02):
            now_ns = speakers[0].clock.now_ns()
            for speaker in speakers:
                speaker.tell(DRIVE(0.0), now_ns)

    thread = threading.Thread(target=tell)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def test_it_ends_with_a_summary_and_its_poses_are_recorded_beside_the_cameras(
    rng: np.random.Generator, tmp_path: Path
) -> None:
    with contextlib.ExitStack() as stack:
        router, _ = stack.enter_context(open_router())
        speakers = [Speaker(rig, rng, join=router) for rig in RIGS]
        for speaker in speakers:
            stack.callback(speaker.close)
        fusing = stack.enter_context(running("fuse", "--join", router))
        wait_for_line(fusing, f"joining the cameras at {router}; poses are at {router}")
        listener, session = Listener(router), stack.enter_context(zenoh.open(client_config(router)))
        stack.callback(listener.close)
        listening = Listening(session, tmp_path, "", router)
        with telling(speakers):
            joined = 0
            while joined < 20 or len(list(tmp_path.iterdir())) < 3:
                listening.step()
                while not listener.frames.empty():
                    joined += all(len(robot.cameras) == 2 for robot in listener.frames.get().robots)
        fusing.send_signal(signal.SIGINT)
        _, told = fusing.communicate(timeout=60)
        problems = listening.close()
    assert fusing.returncode == 0, told
    assert "stopped after" in told
    assert "TRACKED" in told.splitlines()[-1]
    assert problems == []
    recordings = {folder.name.split("-")[0]: Recording(folder) for folder in tmp_path.iterdir()}
    assert sorted(recordings) == ["fused", "left", "right"]
    fused = recordings["fused"]
    assert [robot.id for robot in fused.rig().robots] == [robot.id for robot in RIGS[0].robots]
    frames = [message for message in fused.messages() if message.kind.schema == FRAME_REPORT.schema]
    reports = [arrived(keys.frame(keys.FUSED), message.payload).told for message in frames]
    assert any(len(robot.cameras) == 2 for report in reports for robot in report.robots)  # type: ignore[union-attr]
