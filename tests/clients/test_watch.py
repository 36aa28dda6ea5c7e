"""The live table: what it shows of what arrives, in how many columns, and what it forgets."""

import io
import math
import re
from dataclasses import replace

import pytest
from rich.console import Console

from asterism.clients.age import SLACK_S
from asterism.clients.layout import Row, joined, printable, shorten, table
from asterism.clients.watch import check_prefix
from asterism.clients.watched import FORGOTTEN_NS, MOST_CAMERAS, RobotTable
from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import decode_rig, encode_rig, to_bytes
from asterism.protocol.errors import InputError
from tests.clients.samples import Clock, Sample, moving_report
from tests.protocol import make_golden


def tell_clock(table: RobotTable, clock: Clock, time_ns: int) -> None:
    """The server answers that it is so late by its clock."""
    told = decode_rig(encode_rig(make_golden.RIG))
    told.session, told.time_ns, told.rate = make_golden.frame_report().session, time_ns, 1.0
    table.servers["cam"].answers(told, clock(), clock())


def tell(table: RobotTable, report: "pb.FrameReport | None" = None, key: str = "asterism/cam/frame") -> None:
    payload = to_bytes(report if report is not None else make_golden.frame_report())
    table._frame(Sample(key, payload))  # type: ignore[arg-type]


def tell_alive(table: RobotTable, key: str = "asterism/cam/alive", alive: bool = True) -> None:
    table._shows(Sample(key, b"", alive))  # type: ignore[arg-type]


def tell_status(table: RobotTable, status: "pb.Status", key: str = "asterism/cam/status") -> None:
    table._health(Sample(key, to_bytes(status)))  # type: ignore[arg-type]


def drawn(table: RobotTable, width: int = 160) -> str:
    console = Console(file=io.StringIO(), width=width)
    console.print(table.draw(width))
    text = console.file.getvalue()  # type: ignore[attr-defined]
    assert isinstance(text, str)
    return text


@pytest.mark.parametrize("prefix", ["", "replay/"])
def test_every_robot_has_its_line_and_the_server_its_own(prefix: str) -> None:
    table = RobotTable(prefix=prefix)
    assert "no frame has arrived yet" in drawn(table)
    tell_alive(table, f"{prefix}asterism/cam/alive")
    tell(table, key=f"{prefix}asterism/cam/frame")
    tell_status(table, make_golden.status(), f"{prefix}asterism/cam/status")
    text = drawn(table)
    alpha = next(line for line in text.splitlines() if line.lstrip().startswith("alpha"))
    for word in ("TILT_AMBIGUOUS", "1500.00", "5", "0.013"):
        assert word in alpha
    bravo = next(line for line in text.splitlines() if line.lstrip().startswith("bravo"))
    assert "LOST" in bravo
    assert "60 frames/s" in text
    assert "dropped 1" in text


def test_only_the_robots_asked_for_are_shown() -> None:
    table = RobotTable(["bravo"])
    tell(table)
    assert "alpha" not in drawn(table)
    assert table.lines()[0].startswith("bravo  LOST")


def test_a_problem_is_told() -> None:
    status = make_golden.status()
    status.problem = "/dev/video0: the camera vanished; waiting for it"
    table = RobotTable()
    tell_alive(table)
    tell(table)
    tell_status(table, status)
    assert "the camera vanished; waiting for it" in drawn(table)


def test_bytes_that_are_no_report_are_told_and_ignored() -> None:
    table = RobotTable()
    table._frame(Sample("asterism/cam/frame", b"\x07no report"))  # type: ignore[arg-type]
    assert "asterism/cam/frame: 10 bytes that are no asterism.FrameReport" in drawn(table)
    tell(table)
    assert "alpha" in drawn(table)


@pytest.mark.parametrize("what", ["state", "quaternion", "position"])
def test_a_report_that_no_server_makes_is_told_and_ignored(what: str) -> None:
    report = make_golden.frame_report()
    robot = next(robot for robot in report.robots if robot.id == "alpha")
    if what == "state":
        robot.state = 99  # type: ignore[assignment]
    elif what == "quaternion":
        robot.pose.orientation.CopyFrom(pb.Quaternion(x=0.0, y=0.0, z=0.0, w=0.0))
    else:
        robot.pose.position.x = float("nan")
    table = RobotTable()
    tell(table, report)
    assert "robot 'alpha': " in drawn(table)
    assert "ignored" in drawn(table)
    assert table.rows() == []


def test_a_lost_robots_line_says_why() -> None:
    report = make_golden.frame_report()
    bravo = next(robot for robot in report.robots if robot.id == "bravo")
    assert bravo.reason
    table = RobotTable()
    tell(table, report)
    assert bravo.reason in drawn(table)
    assert bravo.reason in " ".join(drawn(table, 50).split())


NUMBERS = re.compile(r"-?\d+\.\d+")
ROWS = (
    Row("cam", "alpha", "TRACKED", "", 0.0123, (-1234.56, 987.65, 2345.67), -179.9, 44.4, 6, 0.123, 59.0),
    Row("cam", "robot_with_a_long_name_1", "TILT_AMBIGUOUS", "", 12.0, (1.0, -2.0, 3.0), 0.0, 1.0, 5, 0.5, 8.0),
    Row("cam", "robot_with_a_long_name_2", "IDENTITY_AMBIGUOUS", "robot_with_a_long_name_1 explains its spots as well"),
    Row("cam", "echo", "LOST", "its constellation is not among the spots", 700.0),
)


@pytest.mark.parametrize("width", [200, 120, 100, 80, 70, 60, 50, 44])
def test_the_table_fits_and_no_number_is_broken(width: int) -> None:
    lines = [line.plain for line in table(ROWS, width)]
    assert max(map(len, lines)) <= width
    assert len(NUMBERS.findall(lines[1])) >= 3
    assert lines[1].startswith("alpha")
    for number in ("-1234.56", "987.65", "2345.67"):
        assert number in lines[1].split()
    text = " ".join(" ".join(lines).split())
    for row in ROWS:
        assert row.reason in text
    assert ("rms px" in lines[0]) == (width >= 100)
    assert ("heading°" in lines[0]) == (width >= 70)
    assert ("age" in lines[0]) == (width >= 60)


def test_a_wide_terminal_sees_everything_in_full() -> None:
    text = "\n".join(line.plain for line in table(ROWS, 200))
    for word in ("robot_with_a_long_name_2", "IDENTITY_AMBIGUOUS", "12 ms", "12 min", "179.9", "0.123", "59"):
        assert word in text
    assert "camera" not in text


def test_several_cameras_are_told_apart() -> None:
    other = Row("front", "alpha", "LOST", "none of its LEDs is visible")
    lines = [line.plain.split() for line in table([*ROWS, other], 120)]
    assert lines[0][0] == "camera"
    assert (lines[1][:2], lines[-1][:2]) == (["cam", "alpha"], ["front", "alpha"])


def test_names_are_shortened_in_their_middle_and_parts_kept_whole() -> None:
    assert shorten("robot_with_a_long_name_1", 12) == "robot…name_1"
    assert shorten("alpha", 12) == "alpha"
    assert joined(("dropped 0", "not recorded 0", "more"), 20) == "dropped 0,\n  not recorded 0,\n  more"
    assert joined(("dropped 0", "not recorded 0"), 80) == "dropped 0, not recorded 0"


def test_names_from_the_network_do_not_steer_the_terminal() -> None:
    assert printable("a\x1b[2Jb\x9bc\u202ed\n") == "a?[2Jb?c?d?"
    report = make_golden.frame_report()
    for robot in report.robots:
        robot.id += "\x1b]52;c;aGk=\x07"
        robot.reason += "\x1b[31m\r"
    status = make_golden.status()
    status.source += "\x1b[2J"
    status.problem = "bad\x1b[H"
    table = RobotTable(["alhpa"])
    tell_alive(table)
    tell(table, report)
    tell_status(table, status)
    table._frame(Sample("asterism/cam\x1b[2J/frame", b"\x07"))  # type: ignore[arg-type]
    everything = RobotTable()
    tell(everything, report)
    for text in (table.draw(80).plain, everything.draw(80).plain, *table.lines(), *everything.lines()):
        assert not [char for char in text if char != "\n" and not char.isprintable()]


def test_robots_that_left_the_rig_and_cameras_that_fell_silent_are_forgotten() -> None:
    clock = Clock()
    table = RobotTable(clock=clock)
    tell(table)
    assert [row.robot for row in table.rows()] == ["alpha", "bravo"]
    smaller = make_golden.frame_report()
    del smaller.robots[1]
    tell(table, smaller)
    assert [row.robot for row in table.rows()] == ["alpha"]
    clock.passes(1.5)
    assert [row.state for row in table.rows()] == ["NO FRAMES"]
    clock.now += FORGOTTEN_NS
    assert table.rows() == []
    assert "no frame has arrived" in drawn(table)
    for number in range(3 * MOST_CAMERAS):
        clock.passes(0.001)
        tell(table, smaller, f"asterism/cam{number}/frame")
    assert len(table.rows()) == MOST_CAMERAS
    assert f"cam{3 * MOST_CAMERAS - 1}" in {row.camera for row in table.rows()}


def test_the_age_is_that_of_the_servers_clock_and_goes_on_while_a_robot_is_lost() -> None:
    clock = Clock()
    table = RobotTable(clock=clock)
    report = make_golden.frame_report()
    tell(table, report)
    assert table.rows()[0].age_s is None  # nothing is known of the server's clock yet
    late_ns = 3_000_000_000  # the frame waited so long on its way
    tell_clock(table, clock, report.published_ns + late_ns)
    alpha = table.rows()[0]
    expected_s = (late_ns + report.published_ns - report.exposed_ns) * 1e-9
    assert alpha.age_s == pytest.approx(expected_s, abs=1.1 * SLACK_S)
    clock.passes(0.5)
    report.robots[0].ClearField("pose")
    report.robots[0].state = pb.LOST
    tell(table, report)
    later = table.rows()[0]
    assert (later.state, later.position_mm) == ("LOST", None)
    assert later.age_s == pytest.approx(alpha.age_s + 0.5, abs=1e-3)


def test_late_silent_and_gone_are_told_apart() -> None:
    clock = Clock()
    table = RobotTable(clock=clock)
    report = make_golden.frame_report()
    tell_alive(table)
    tell_clock(table, clock, report.published_ns + 2_000_000_000)
    tell(table, report)
    assert "the link is too slow, what the server sends arrives 2.0 s late" in drawn(table)
    clock.passes(1.5)
    assert "the server has stopped answering, for 1.5 s" in drawn(table)
    tell_alive(table, alive=False)
    assert "camera 'cam': the server is gone" in drawn(table)


def test_a_mistyped_robot_is_named_once_a_rig_is_known() -> None:
    table = RobotTable(["alhpa", "bravo"])
    assert table.mistyped() == ""
    tell(table)
    assert table.mistyped() == "no rig here has a robot 'alhpa'; did you mean 'alpha'? There are: alpha, bravo"
    assert "did you mean 'alpha'?" in drawn(table)
    assert any("did you mean 'alpha'?" in line for line in table.lines())


def test_of_a_robot_that_no_rig_has_it_is_not_said_that_no_frame_came() -> None:
    table = RobotTable(["zulu"])
    assert "no frame has arrived" in drawn(table)
    tell(table)
    assert table.mistyped() == "no rig here has a robot 'zulu'; there are: alpha, bravo"
    assert "no frame has arrived" not in drawn(table)
    # A camera that delivers no frames answers for its rig all the same.
    silent = RobotTable(["alpah"])
    silent.servers["cam"].answers(decode_rig(encode_rig(make_golden.RIG)), 0, 1)
    assert "did you mean 'alpha'?" in silent.mistyped()
    right = RobotTable(["alpha"])
    tell(right)
    assert right.mistyped() == ""


@pytest.mark.parametrize("prefix", ["replay", "/replay/", "re*lay/", "a//b/", "/", "$x/"])
def test_what_cannot_stand_before_a_key_is_refused(prefix: str) -> None:
    with pytest.raises(InputError, match=r"--prefix .*: expected parts of a key that end with '/', such as replay/"):
        check_prefix(prefix)


def test_prefixes_of_keys_are_taken() -> None:
    for prefix in ("", "replay/", "site/hall 2/"):
        check_prefix(prefix)


def test_speeds_have_columns_where_the_server_smooths() -> None:
    table = RobotTable()
    tell(table, moving_report())
    row = table.rows()[0]
    assert (row.speed_mm_s, row.turning_deg_s) == (125.0, pytest.approx(math.degrees(0.5)))
    for column, number in (("mm/s", "125.0"), ("°/s", "28.6"), ("tilt°", "30.0")):
        assert column in drawn(table)
        assert number in drawn(table)
    plain = RobotTable()
    tell(plain)
    assert "/s" not in drawn(plain)


@pytest.mark.parametrize("width", [120, 100, 80, 70, 60, 50])
def test_speeds_give_way_on_narrow_terminals(width: int) -> None:
    rows = [replace(row, speed_mm_s=312.5, turning_deg_s=-45.0) for row in ROWS[:1]]
    lines = [line.plain for line in table(rows, width)]
    assert max(map(len, lines)) <= width
    assert ("mm/s" in lines[0], "°/s" in lines[0]) == (width >= 70, width >= 80)
    assert "987.65" in lines[1]


@pytest.mark.parametrize(
    ("axis", "frame_id", "expected"), [((0, 0, 1), "world", 30.0), ((0, 0, 2), "cam", 150.0), ((0, 0, -1), "cam", 30.0)]
)
def test_the_tilt_is_between_the_leds_axis_and_the_vertical(
    axis: tuple[float, ...], frame_id: str, expected: float
) -> None:
    """In the camera's frame, whose z points away from the camera, the vertical is the way back to it."""
    report = moving_report()
    report.frame_id = frame_id
    table, rig = RobotTable(), decode_rig(encode_rig(make_golden.RIG))
    rig.robots[0].axis.x, rig.robots[0].axis.y, rig.robots[0].axis.z = axis
    table.servers["cam"].answers(rig, 0, 1)
    tell(table, report)
    assert table.rows()[0].tilt_deg == pytest.approx(expected)
