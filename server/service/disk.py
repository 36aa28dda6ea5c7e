"""What a recording is doing to its disk: said once its rate is known, and again when there is not much room left."""

import math
import time
from collections.abc import Callable

from asterism.recordings.pace import Growth, Pace
from asterism.recordings.recorder import Recorder

SHORT_S = 600.0  # of room left: a warning
ENOUGH_S = 1200.0  # with so much again the next shortage is a new one
BEHIND_S = 10.0  # between two sentences about what the recorder leaves out


class Disk:
    """Watches a recorder; `look` is called about once a second. ``clock`` is monotonic, s."""

    def __init__(
        self, recorder: Recorder, say: Callable[[str], None], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._recorder = recorder
        self._say = say
        self._clock = clock
        self._growth = Growth()
        self._told = False
        self._warned = False
        self._problem = ""
        self._left_out = (0, 0)
        self._behind_s = -math.inf
        self.text = "recording"  # for the live line

    def look(self) -> None:
        """Take the pace; say it where it is due."""
        self._tell_problem(self._recorder.problem)
        if self._problem:
            return
        self._tell_behind()
        pace = self._growth.pace(self._clock(), self._recorder.bytes_written, self._recorder.bytes_free())
        if pace is None:
            return
        self.text = f"recording {sentence(pace)}"
        if not self._told:
            self._told = True
            self._say(f"recording {sentence(pace)} ({pace.bytes_per_s * 3600 / 1e9:.1f} GB an hour)")
        if pace.seconds_left < SHORT_S and not self._warned:
            self._warned = True
            self._say(f"warning: {self._recorder.folder}: the disk is full in {duration(pace.seconds_left)}")
        elif pace.seconds_left > ENOUGH_S:
            self._warned = False

    def _tell_problem(self, problem: str) -> None:
        """Say what is not recorded, when that changes, and when all is recorded again."""
        if problem == self._problem:
            return
        self._problem = problem
        self.text = "recording disturbed" if problem else "recording"
        recorder = self._recorder
        missing = f"{recorder.frames_left_out} frames and {recorder.messages_left_out} messages are missing so far"
        self._say(problem or f"{recorder.folder}: everything is recorded again; {missing}")
        self._left_out = recorder.frames_left_out, recorder.messages_left_out

    def _tell_behind(self) -> None:
        """Say, now and then, what a recorder leaves out that cannot keep up."""
        left_out = self._recorder.frames_left_out, self._recorder.messages_left_out
        if left_out == self._left_out or self._clock() < self._behind_s + BEHIND_S:
            return
        self._left_out, self._behind_s = left_out, self._clock()
        self._say(
            f"warning: {self._recorder.folder}: the recorder cannot keep up: {left_out[0]} frames and {left_out[1]} "
            "messages are missing so far"
        )


def sentence(pace: Pace) -> str:
    """A pace in a few words."""
    rate = f"{pace.bytes_per_s / 1e6:.1f} MB/s"
    return rate if math.isinf(pace.seconds_left) else f"{rate}, disk full in {duration(pace.seconds_left)}"


def duration(seconds: float) -> str:
    """How long something takes, roughly."""
    for unit, size in (("days", 86_400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * size:
            number = seconds / size
            return f"{number:.0f} {unit}" if number >= 10 else f"{number:.1f} {unit}"
    return f"{seconds:.0f} s"
