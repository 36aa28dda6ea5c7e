"""What a recording is doing to its disk: said once its rate is known, and again when there is not much room left."""

import math
import time
from collections.abc import Callable

from asterism.recordings.pace import Growth, Pace
from asterism.recordings.recorder import Recorder

SHORT_S = 600.0  # of room left: a warning
ENOUGH_S = 1200.0  # with so much again the next shortage is a new one
ENDED = "recording ended"


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
        self.text = "recording"  # for the live line

    def look(self) -> None:
        """Take the pace; say it where it is due."""
        if self._recorder.problem:
            if self.text != ENDED:
                self.text = ENDED
                self._say(self._recorder.problem)
            return
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
