"""The live table: what it shows of what arrives."""

import io

import pytest
from rich.console import Console

from asterism.clients.watch import RobotTable
from asterism.protocol.codec import to_bytes
from tests.protocol import make_golden


class Sample:
    """As much of a zenoh sample as the table looks at."""

    def __init__(self, key: str, payload: bytes) -> None:
        self.key_expr = key
        self.payload = self
        self._payload = payload

    def to_bytes(self) -> bytes:
        return self._payload


def drawn(table: RobotTable) -> str:
    console = Console(file=io.StringIO(), width=160)
    console.print(table.draw())
    text = console.file.getvalue()  # type: ignore[attr-defined]
    assert isinstance(text, str)
    return text


@pytest.mark.parametrize("prefix", ["", "replay/"])
def test_every_robot_has_its_line_and_the_server_its_own(prefix: str) -> None:
    table = RobotTable(prefix=prefix)
    assert "no frame has arrived yet" in drawn(table)
    table._frame(Sample(f"{prefix}asterism/cam/frame", to_bytes(make_golden.frame_report())))  # type: ignore[arg-type]
    table._health(Sample(f"{prefix}asterism/cam/status", to_bytes(make_golden.status())))  # type: ignore[arg-type]
    text = drawn(table)
    alpha = next(line for line in text.splitlines() if line.lstrip().startswith("alpha"))
    for word in ("TILT_AMBIGUOUS", "1500.00", "5", "0.013", "ms"):
        assert word in alpha
    bravo = next(line for line in text.splitlines() if line.lstrip().startswith("bravo"))
    assert "LOST" in bravo
    assert "60 frames/s" in text
    assert "dropped 1" in text


def test_only_the_robots_asked_for_are_shown() -> None:
    table = RobotTable(["bravo"])
    table._frame(Sample("asterism/cam/frame", to_bytes(make_golden.frame_report())))  # type: ignore[arg-type]
    assert "alpha" not in drawn(table)
    assert table.lines()[0].startswith("bravo LOST")


def test_a_problem_is_told() -> None:
    status = make_golden.status()
    status.problem = "/dev/video0: the camera vanished; waiting for it"
    table = RobotTable()
    table._frame(Sample("asterism/cam/frame", to_bytes(make_golden.frame_report())))  # type: ignore[arg-type]
    table._health(Sample("asterism/cam/status", to_bytes(status)))  # type: ignore[arg-type]
    assert "the camera vanished; waiting for it" in drawn(table)


def test_bytes_that_are_no_report_are_told_and_ignored() -> None:
    table = RobotTable()
    table._frame(Sample("asterism/cam/frame", b"\x07no report"))  # type: ignore[arg-type]
    assert "asterism/cam/frame: 10 bytes that are no asterism.FrameReport" in drawn(table)
    table._frame(Sample("asterism/cam/frame", to_bytes(make_golden.frame_report())))  # type: ignore[arg-type]
    assert "alpha" in drawn(table)


def test_a_lost_robots_line_says_why() -> None:
    report = make_golden.frame_report()
    table = RobotTable()
    table._frame(Sample("asterism/cam/frame", to_bytes(report)))  # type: ignore[arg-type]
    bravo = next(robot for robot in report.robots if robot.id == "bravo")
    assert bravo.reason
    assert bravo.reason in drawn(table)
