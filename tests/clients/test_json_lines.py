"""`watch --json`: one object a line, whatever arrives."""

import json
from typing import Any

import pytest

from asterism.clients.age import SLACK_S
from asterism.clients.json_lines import QUEUE, JsonLines, frame_as_json
from asterism.clients.servers import Servers
from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import decode_rig, encode_rig, to_bytes
from tests.clients.samples import Clock, Sample, moving_report
from tests.protocol import make_golden


def lines_of(*robots: str, clock: Clock | None = None) -> JsonLines:
    return JsonLines(robots, "replay/", Servers(""), clock or Clock())


def tell_frame(lines: JsonLines, report: "pb.FrameReport | bytes") -> None:
    payload = report if isinstance(report, bytes) else to_bytes(report)
    lines._frame(Sample("replay/asterism/cam/frame", payload))  # type: ignore[arg-type]


def told_by(lines: JsonLines) -> list[dict[str, Any]]:
    """All lines that wait."""
    return [json.loads(line) for line in iter(lambda: lines.next(0.0), None)]


def test_json_lines_of_frames_are_those_of_locate_and_more() -> None:
    lines = lines_of("alpha")
    tell_frame(lines, make_golden.frame_report())
    (told,) = told_by(lines)
    assert (told["type"], told["camera"], told["frame"], told["lost"]) == ("frame", "cam", "000042", {})
    assert (told["frame_id"], told["age_s"]) == ("world", None)  # nothing is known of the server's clock
    (alpha,) = told["robots"]
    assert set(alpha) >= {"id", "state", "position", "orientation", "covariance", "leds", "rms_px", "alternative"}
    assert (alpha["id"], alpha["state"], len(alpha["covariance"])) == ("alpha", "TILT_AMBIGUOUS", 36)
    assert set(alpha["alternative"]) == {"position", "orientation", "odds"}
    assert "velocity" not in alpha
    everything = frame_as_json(make_golden.frame_report(), Servers("")["cam"], frozenset())
    assert list(everything["lost"]) == ["bravo"]


def test_json_lines_tell_angles_velocity_and_age() -> None:
    lines = lines_of()
    server, report = lines._servers["cam"], moving_report()
    rig = decode_rig(encode_rig(make_golden.RIG))
    rig.session, rig.time_ns, rig.rate = report.session, report.exposed_ns + 250_000_000, 1.0
    server.answers(rig, Clock.now, Clock.now)
    tell_frame(lines, report)
    (told,) = told_by(lines)
    assert told["age_s"] == pytest.approx(0.25, abs=1.1 * SLACK_S)
    alpha = told["robots"][0]
    assert (alpha["tilt_deg"], alpha["smoothed"]) == (30.0, True)
    assert alpha["velocity"] == {"linear": [0.125, 0.0, 0.0], "angular": [0.0, 0.0, -0.5], "covariance": [0.0625] * 36}


def test_json_lines_tell_what_happened_to_the_robots_asked_for() -> None:
    lines = lines_of("alpha")
    for robot, happening in (("alpha", pb.STATE_CHANGED), ("bravo", pb.STATE_CHANGED), ("", pb.FRAMES_STOPPED)):
        event = make_golden.event()
        event.robot, event.happening = robot, happening
        lines._event(Sample("replay/asterism/cam/event", to_bytes(event)))  # type: ignore[arg-type]
    alpha, camera = told_by(lines)
    assert (alpha["type"], alpha["robot"], alpha["state"], alpha["before"]) == ("event", "alpha", "LOST", "TRACKED")
    assert (alpha["reason"], alpha["lasted_s"], alpha["left_out"]) == (make_golden.event().reason, 12.5, 2)
    assert (camera["robot"], camera["happening"]) == ("", "FRAMES_STOPPED")


def test_json_lines_tell_when_a_server_falls_silent_and_goes() -> None:
    clock = Clock()
    lines = lines_of(clock=clock)
    server = lines._servers["cam"]
    assert told_by(lines) == []  # who was never there is not gone
    server.shows(True, clock())
    server.beats(make_golden.beat(), clock())
    clock.passes(0.1)
    (live,) = told_by(lines)
    clock.passes(2.0)
    (silent,) = told_by(lines)
    server.shows(False, clock())
    (gone,) = told_by(lines)
    assert [told["link"] for told in (live, silent, gone)] == ["live", "silent", "gone"]
    assert silent["sentence"] == "camera 'cam': the server has stopped answering, for 2.1 s"
    assert {told["type"] for told in (live, silent, gone)} == {"link"}


def test_json_lines_are_json_whatever_arrives() -> None:
    lines = lines_of()
    tell_frame(lines, b"\x07")
    nan = make_golden.frame_report()
    nan.robots[0].rms_px = float("nan")
    tell_frame(lines, nan)
    nan.robots[0].pose.position.x = float("nan")
    tell_frame(lines, nan)
    lines._event(Sample("replay/asterism/cam/event", b""))  # type: ignore[arg-type]
    errors = told_by(lines)
    assert [told["type"] for told in errors] == ["error"] * 4
    assert "no asterism.FrameReport" in errors[0]["error"]


def test_a_reader_that_is_too_slow_misses_lines_and_they_are_counted() -> None:
    lines = lines_of()
    for _ in range(QUEUE + 7):
        lines._event(Sample("replay/asterism/cam/event", to_bytes(make_golden.event())))  # type: ignore[arg-type]
    assert lines.left_out == 7
    assert len(told_by(lines)) == QUEUE
