"""The line that says how a run is doing, and what is said of a recording's disk."""

import io
import math

import pytest
from rich.console import Console

from asterism.recordings.pace import FIRST_S, Growth, Pace
from asterism.server.service.disk import Disk, duration, sentence
from asterism.server.service.live_line import LiveLine, Now, states, told

ROBOTS = {"alpha": "TRACKED", "bravo": "TRACKED", "charlie": "TILT_AMBIGUOUS", "delta": "LOST"}


def test_the_line_says_rate_states_recording_and_drops() -> None:
    now = Now(120, 600, 58.7, ROBOTS, ("recording 45.2 MB/s, disk full in 2.9 h", "3 dropped"))
    line = "120 of 600 frames, 59/s, 2 TRACKED 1 TILT_AMBIGUOUS 1 LOST (delta), recording 45.2 MB/s, disk full in 2.9 h"
    assert told(now) == f"{line}, 3 dropped"
    assert told(Now(7, None, 0.0, {})) == "7 frames, 0/s"


def test_robots_without_a_pose_are_named_while_they_are_few() -> None:
    assert states(dict.fromkeys("abc", "LOST")) == "3 LOST"
    assert states({"a": "TRACKED", **dict.fromkeys("bcde", "LOST")}) == "1 TRACKED 4 LOST"
    assert states({"a": "TRACKED", "b": "IDENTITY_AMBIGUOUS"}) == "1 TRACKED 1 IDENTITY_AMBIGUOUS (b)"


def written(terminal: bool) -> str:
    file = io.StringIO()
    console = Console(file=file, width=60, force_terminal=terminal, color_system=None)
    now = Now(120, None, 58.7, ROBOTS, ("recording 45.2 MB/s, disk full in 2.9 h",), "the camera vanished; waiting")
    with LiveLine(lambda: now, console):
        pass
    return file.getvalue()


def test_it_is_drawn_on_terminals_only_in_their_width_with_the_problem_below() -> None:
    assert written(terminal=False) == ""
    lines = written(terminal=True).splitlines()
    line = next(line for line in lines if "120 frames" in line)
    assert "…" in line
    assert len(line[line.index("120") :]) <= 60
    assert any("the camera vanished; waiting" in line for line in lines)


def test_a_pace_is_known_after_the_first_seconds_and_is_that_of_the_last() -> None:
    growth = Growth()
    rate, free = 40_000_000, 10**12
    for second in range(60):
        pace = growth.pace(float(second), rate * second, free)
        assert (pace is None) == (second < FIRST_S)
    assert pace == Pace(rate, free / rate)
    for second in range(60, 80):
        pace = growth.pace(float(second), rate * 60, free)
    assert pace == Pace(0.0, math.inf)


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(45, "45 s"), (119, "119 s"), (540, "9.0 min"), (5400, "90 min"), (10_440, "2.9 h"), (400_000, "4.6 days")],
)
def test_how_long_something_takes(seconds: float, words: str) -> None:
    assert duration(seconds) == words


class Recorder:
    """As much of a recorder as the disk looks at."""

    folder = "recordings/cam-1"
    problem = ""
    bytes_written = frames_left_out = messages_left_out = 0
    free = 10**12

    def bytes_free(self) -> int:
        return self.free


def test_the_rate_is_said_once_and_a_full_disk_ahead_of_time() -> None:
    recorder, said, now = Recorder(), list[str](), [0.0]
    disk = Disk(recorder, said.append, lambda: now[0])  # type: ignore[arg-type]

    def run(seconds: int) -> None:
        for _ in range(seconds):
            disk.look()
            now[0] += 1.0
            recorder.bytes_written += 50_000_000
            recorder.free -= 50_000_000

    run(2)
    assert (said, disk.text) == ([], "recording")
    run(30)
    assert said == ["recording 50.0 MB/s, disk full in 5.6 h (180.0 GB an hour)"]
    assert disk.text.startswith("recording 50.0 MB/s, disk full in 5.5 h")
    recorder.free = 50_000_000 * 590
    run(30)
    assert len(said) == 2
    assert said[1] == "warning: recordings/cam-1: the disk is full in 9.8 min"
    recorder.free = 10**12
    run(5)
    recorder.free = 50_000_000 * 100
    run(5)
    assert len(said) == 3
    recorder.problem = "only poses are recorded at the moment"
    run(3)
    assert (disk.text, said[3:]) == ("recording disturbed", ["only poses are recorded at the moment"])
    recorder.problem, recorder.frames_left_out = "", 7
    run(3)
    assert said[4:] == ["recordings/cam-1: everything is recorded again; 7 frames and 0 messages are missing so far"]
    recorder.messages_left_out = 3
    run(5)
    assert said[5:] == [
        "warning: recordings/cam-1: the recorder cannot keep up: 7 frames and 3 messages are missing so far"
    ]


def test_what_does_not_grow_never_fills_the_disk() -> None:
    assert sentence(Pace(0.0, math.inf)) == "0.0 MB/s"
