"""Why a robot has no claim, in a sentence that says what a person can do."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from asterism.server.fusing.joined import Hypothesis, Joined

NUMBERS = ("none", "one", "two", "three", "four", "five", "six")
SHOW = "show four to one camera, or three to two"


def _list(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def too_few(joined: Joined, told: Hypothesis) -> str:
    """What each camera sees of a robot whose place is foreseen."""
    counts = (told.labels >= 0).sum(axis=1).tolist()
    parts = [f"{s.camera} sees {NUMBERS[count]}" for s, count in zip(joined.sightings, counts, strict=True)]
    parts[0] += " of its LEDs"
    return f"{', '.join(parts)}: {SHOW}"


def nowhere(joined: Joined, free: NDArray[np.bool_]) -> str:
    """What is left in each camera, where it shows the robot nowhere."""
    first = joined.scene.first
    counts = [int(free[a:b].sum()) for a, b in pairwise(first)]
    if not any(counts):
        return f"no camera sees a spot that could be its LEDs: {SHOW}"
    spots = _list([f"{s.camera} {count}" for s, count in zip(joined.sightings, counts, strict=True)])
    return f"no camera finds it, nor do the spots that are nobody's (of {spots}) show it together: {SHOW}"


def contradicted(joined: Joined, explanations: Sequence[Hypothesis]) -> str:
    """Which cameras say what, of a robot that several explanations fit."""
    best, *rivals = explanations
    other = rivals[0]
    cameras = [_list([joined.sightings[c].camera for c in one.cameras()]) for one in (best, other)]
    if other.robot != best.robot:
        return f"its spots in {cameras[0]} may as well be {other.robot}: show more of its LEDs to each camera"
    away = float(np.linalg.norm(best.pose.position - other.pose.position))
    return (
        f"it may be at two places {away:.2g} m apart (by {cameras[0]}; by {cameras[1]}): show more of its LEDs to each "
        "camera, or cover what looks like them"
    )
