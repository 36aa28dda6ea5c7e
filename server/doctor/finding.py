"""What a check found: a verdict, what was measured, what to do."""

from enum import IntEnum
from typing import NamedTuple


class Verdict(IntEnum):
    """How good it is, the worse the larger."""

    UNTOLD = 0  # these frames cannot tell
    GOOD = 1
    LOOK = 2
    WRONG = 3

    @property
    def words(self) -> str:
        """What a person reads."""
        return ("cannot tell", "good", "look at it", "wrong")[self]


class Finding(NamedTuple):
    """One line of the doctor's table."""

    check: str
    verdict: Verdict
    measured: str  # with units
    advice: str = ""  # what to do, a sentence


def graded(value: float, look: float, wrong: float) -> Verdict:
    """The verdict on what is the worse the larger it is."""
    return Verdict.WRONG if value >= wrong else Verdict.LOOK if value >= look else Verdict.GOOD
