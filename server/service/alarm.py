"""Something that is wrong and stays so: said once, shown while it lasts, taken back when it is gone."""

from collections.abc import Callable
from datetime import UTC, datetime
from typing import NamedTuple

RAISED_AFTER = 5  # looks, one after the other, that find it
GONE_AFTER = 20  # looks that do not


class Finding(NamedTuple):
    """What is wrong: ``what`` names it for the program, ``text`` says it with by how much, ``remedy`` what to do; it
    began at ``since_ns``.
    """

    what: str
    text: str
    remedy: str
    since_ns: int


class Alarm:
    """Turns looks into an alarm: one look that finds something is none."""

    def __init__(self) -> None:
        self._candidate = ""
        self._found = 0
        self._missing = 0
        self._raised: Finding | None = None

    @property
    def raised(self) -> Finding | None:
        """What is said now, with when it began and by how much it is off today."""
        return self._raised

    @property
    def problem(self) -> str:
        """The same as part of a sentence; empty where nothing is wrong."""
        return "" if self._raised is None else f"{self._raised.text}, since {clock_text(self._raised.since_ns)}"

    def look(self, finding: Finding | None, say: Callable[[str], None]) -> None:
        """One more look."""
        if self._raised is not None:
            self._look_again(self._raised, finding, say)
            return
        if finding is None:
            self._candidate, self._found = "", 0
            return
        self._found = self._found + 1 if finding.what == self._candidate else 1
        self._candidate = finding.what
        if self._found >= RAISED_AFTER:
            self._raised, self._found, self._missing = finding, 0, 0
            say(f"{self.problem}; {finding.remedy}")

    def _look_again(self, raised: Finding, finding: Finding | None, say: Callable[[str], None]) -> None:
        if finding is not None and finding.what == raised.what:
            self._missing = 0
            self._raised = finding._replace(since_ns=raised.since_ns)
            return
        self._missing += 1
        if self._missing >= GONE_AFTER:
            self._raised, self._candidate, self._found = None, "", 0
            say(f"no longer: {raised.text}, since {clock_text(raised.since_ns)}")


def clock_text(time_ns: int) -> str:
    """The time of day, as logs have it."""
    return datetime.fromtimestamp(time_ns * 1e-9, UTC).strftime("%H:%M:%S UTC")


def step_of(shares: list[float]) -> int:
    """Where numbers step from about 0 to about 1: the place of the first that is 1.

    The likeliest place of a step is where the sum of what lies below its half is largest (Page, "Continuous inspection
    schemes", 1954).
    """
    best, at, total = 0.0, 0, 0.0
    for place, share in enumerate(shares):
        total += 0.5 - share
        if total > best:
            best, at = total, place + 1
    return min(at, len(shares) - 1)
