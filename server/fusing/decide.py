"""Which of several explanations of spots hold: the likeliest, where nothing else explains them nearly as well."""

from collections.abc import Sequence

from asterism.server.fusing.joined import Hypothesis

LEAST_ODDS = 11.0  # nats against chance from which on a robot is claimed
WORTH = 3.0  # from which on something counts as an explanation at all
MARGIN = 7.0  # nats over the next best explanation

Doubts = dict[str, list[Hypothesis]]


def decided(explanations: Sequence[Hypothesis]) -> tuple[list[Hypothesis], Doubts]:
    """Those that hold, and by the robots that are in doubt what explains as much.

    A robot is at one place, and a spot is one robot's.
    """
    ordered = sorted((h for h in explanations if h.odds > WORTH), key=lambda h: -h.odds)
    found: list[Hypothesis] = []
    doubts: Doubts = {}
    taken: set[int] = set()
    settled: set[str] = set()
    for best in ordered:
        if best.robot in settled or best.used & taken or best.odds < LEAST_ODDS:
            continue
        rivals = [other for other in ordered if _rival(best, other) and other.robot not in settled]
        settled.add(best.robot)
        taken |= best.used
        if not rivals:
            found.append(best)
            continue
        doubts[best.robot] = [best, *rivals]
        for rival in rivals:
            if rival.robot not in settled:
                settled.add(rival.robot)
                doubts[rival.robot] = [rival, best]
    return found, doubts


def _rival(best: Hypothesis, other: Hypothesis) -> bool:
    """Whether another hypothesis speaks against one: it cannot be true as well, and is nearly as likely."""
    if other is best or other.odds <= best.odds - MARGIN:
        return False
    return other.robot == best.robot or bool(other.used & best.used)
