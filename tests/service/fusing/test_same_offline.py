"""Fusing live and fusing recordings of the same reports is the same, to the bit."""

import threading
import time
from collections.abc import Iterable
from pathlib import Path

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import decode_frame_report, to_bytes
from asterism.protocol.messages import FRAME_REPORT, Message
from asterism.recordings.compare import reports
from asterism.recordings.reader import Recording
from asterism.recordings.tape import exposures_of, tapes_of
from asterism.server.__main__ import main
from asterism.server.fusing.fitting import view_of
from asterism.server.service.fusing.answer import Answer
from asterism.server.service.fusing.ears import Answers, Heard
from asterism.server.service.fusing.joining import Joining
from asterism.server.service.stop import Stop
from asterism.server.sources.session_clock import SessionClock
from tests.command.test_fuse_recordings import films, recorded

__all__ = ["films", "recorded"]
SESSION = 77


class Hall:
    """Stands in for servers and network: what goes out brings the next exposure's reports in."""

    rig_payload = b""

    def __init__(self, recorded: Path) -> None:
        self.told: list[pb.FrameReport] = []
        self.stop = Stop()
        self.joining = Joining(self, SessionClock(), self.stop, (), "here")  # type: ignore[arg-type]
        tapes = tapes_of([recorded])
        self._exposures = exposures_of(tapes)
        self._views = {tape.camera: view_of(tape.parts[0].recording.rig(), tape.camera) for tape in tapes}
        for camera in self._views:
            self.joining.hear(Heard(0, camera, "alive", None, time.monotonic_ns()))

    def put(self, message: Message) -> None:
        if message.kind is FRAME_REPORT:
            self.told.append(decode_frame_report(message.payload))
            self._next()

    def publish(self, messages: Iterable[Message], _: int | None = None) -> list[Message]:
        return list(messages)

    def show_visible(self, _: object) -> None:
        pass

    def ask(self, _: int, camera: str, *__: object) -> None:
        """Asked for a rig: after all have answered the exposures begin."""
        view = self._views.pop(camera, None)
        if view is None:
            return
        self._hear(camera, pb.FrameReport(exposed_ns=1))  # by which its session is known
        self.joining.hear(Answers(camera, (Answer(SESSION, "a test", (camera,), view),)))
        if not self._views:
            self._next()

    def _next(self) -> None:
        exposure = next(self._exposures, None)
        if exposure is None:
            self.stop.set()
            return
        for camera, report, _ in exposure:
            self._hear(camera, report)

    def _hear(self, camera: str, report: "pb.FrameReport") -> None:
        now_ns = time.monotonic_ns()
        report.session, report.published_ns = SESSION, SessionClock().now_ns()
        self.joining.hear(Heard(0, camera, "frame", to_bytes(report), now_ns))


def test_live_and_from_recordings_is_the_same(recorded: Path, tmp_path: Path) -> None:
    hall = Hall(recorded)
    given_up = threading.Timer(60.0, hall.stop.set)
    given_up.start()
    hall.joining.run(hall)  # type: ignore[arg-type]
    given_up.cancel()
    assert main(["fuse", str(recorded), "--record", str(tmp_path)]) == 0
    offline = list(reports(Recording(next(tmp_path.glob("fused-*")))))
    assert [report.exposed_ns for report in hall.told] == [report.exposed_ns for report in offline]
    assert [[to_bytes(robot) for robot in report.robots] for report in hall.told] == [
        [to_bytes(robot) for robot in report.robots] for report in offline
    ]
    assert all(robot.HasField("pose") for report in offline for robot in report.robots)
