"""Global assignment: of all hypotheses about who is where, the set that explains the frame best, or nothing.

Every hypothesis (a robot, its spots, a pose that fits them) has a score: the logarithm of how much likelier its
spots are as this robot's LEDs than as chance (`evidence`). Hypotheses that share a robot or a spot exclude each
other; the set with the largest sum wins. A member of it is claimed only if it beats chance and the best explanation
without it by a margin; otherwise the robots concerned are ambiguous. Nothing is guessed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from asterism.protocol.geometry import Floats

BEYOND_CHANCE = 12.0  # the least score, in nats: one false claim in 160 000 places looked at
CHANCE = "its spots may be chance"
TWO_PLACES = "it is seen in two places"
RIVAL = 2.5  # score of a brighter place of the same robot, from which on the dimmer one is not claimed
MARGIN = 7.0  # over the best explanation without it, in nats: odds of 1000
MIRROR_RATIO = 0.6  # of two explanations of one robot the dimmer is a mirror image if it is dimmer than this
LARGEST_GROUP = 14  # rivals that are judged together; the weakest beyond that are left out


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """A robot (its index), the spots of its six LEDs (-1: not visible), how bright they are, and the score."""

    robot: int
    spots: tuple[int, ...]
    height: float
    score: float
    rotation: Floats  # (3, 3) T_camera_plane
    t: Floats  # (3,)

    @property
    def used(self) -> frozenset[int]:
        """The spots it claims."""
        return frozenset(spot for spot in self.spots if spot >= 0)

    @property
    def whole(self) -> bool:
        """Whether it claims a spot for every LED."""
        return -1 not in self.spots


def _same(a: Hypothesis, b: Hypothesis) -> bool:
    """Two versions of one explanation: the same robot, most LEDs at the same spots."""
    return a.robot == b.robot and sum(x == y >= 0 for x, y in zip(a.spots, b.spots, strict=True)) >= 4


def _outshines(rival: Hypothesis, member: Hypothesis) -> bool:
    """The same robot, much brighter and no mere chance: then the member may be its mirror image."""
    return rival.robot == member.robot and member.height < MIRROR_RATIO * rival.height and rival.score > RIVAL


def _exclude(a: Hypothesis, b: Hypothesis) -> bool:
    return a.robot == b.robot or bool(a.used & b.used)


def assign(hypotheses: Sequence[Hypothesis]) -> tuple[list[Hypothesis], dict[int, str]]:
    """The hypotheses to claim, and for every robot about which the frame leaves a doubt why."""
    kept: list[Hypothesis] = []
    for hypothesis in sorted(hypotheses, key=lambda h: (-h.score, h.robot, h.spots)):
        if not any(_same(hypothesis, better) for better in kept):
            kept.append(hypothesis)
    kept = _without_mirror_images(kept)
    claimed: list[Hypothesis] = []
    doubts: dict[int, str] = {}
    for group in _groups([h for h in kept if h.score > 0.0]):
        strongest = group[:LARGEST_GROUP]
        best, best_score = _best_set(strongest)
        for member in best:
            rest = best_score - _best_set([h for h in strongest if h is not member])[1]
            if member.score < BEYOND_CHANCE:
                doubts.setdefault(member.robot, CHANCE)
            elif any(_outshines(rival, member) for rival in strongest):
                doubts[member.robot] = TWO_PLACES
            elif rest < MARGIN:
                rivals = [h for h in strongest if h is not member and _exclude(h, member) and h not in best]
                for rival in [member, *rivals]:
                    doubts[rival.robot] = _why(member, rivals)
            else:
                claimed.append(member)
    for member in claimed:
        doubts.pop(member.robot, None)
    return claimed, doubts


def _why(member: Hypothesis, rivals: Sequence[Hypothesis]) -> str:
    if any(rival.robot == member.robot and rival.used.isdisjoint(member.used) for rival in rivals):
        return TWO_PLACES
    if any(rival.robot == member.robot for rival in rivals):
        return "its LEDs can be told apart in two ways"
    return "its spots may be another robot's"


def _without_mirror_images(hypotheses: list[Hypothesis]) -> list[Hypothesis]:
    """Of several places of one robot, leave out those that are much dimmer than the brightest."""
    brightest: dict[int, float] = {}
    for h in hypotheses:
        if h.score >= BEYOND_CHANCE:
            brightest[h.robot] = max(brightest.get(h.robot, 0.0), h.height)
    return [h for h in hypotheses if h.height >= MIRROR_RATIO * brightest.get(h.robot, 0.0)]


def _groups(hypotheses: list[Hypothesis]) -> list[list[Hypothesis]]:
    """Connected groups of hypotheses that exclude each other, each in descending order of score."""
    groups: list[list[Hypothesis]] = []
    for hypothesis in hypotheses:
        touching = [group for group in groups if any(_exclude(hypothesis, other) for other in group)]
        groups = [group for group in groups if group not in touching]
        groups.append([h for group in touching for h in group] + [hypothesis])
    return [sorted(group, key=lambda h: -h.score) for group in groups]


def _best_set(group: Sequence[Hypothesis]) -> tuple[list[Hypothesis], float]:
    """The compatible subset with the largest sum of scores (exhaustive with a bound)."""
    best: list[Hypothesis] = []
    best_score = 0.0
    tail = np.concatenate([np.cumsum([h.score for h in reversed(group)])[::-1], [0.0]]) if group else np.zeros(1)

    def extend(start: int, chosen: list[Hypothesis], total: float) -> None:
        nonlocal best, best_score
        if total > best_score:
            best, best_score = list(chosen), total
        for k in range(start, len(group)):
            if total + tail[k] <= best_score:
                return
            if not any(_exclude(group[k], other) for other in chosen):
                extend(k + 1, [*chosen, group[k]], total + group[k].score)

    extend(0, [], 0.0)
    return best, best_score


def systematic_sigma(costs: Floats, sigma_px: float, prior_px: float) -> float:
    """One sigma, px an axis, of what calibration and LED positions are off, learned from fits of six LEDs.

    ``costs`` (m,) are their squared residuals in units of ``sigma_px``; ``prior_px`` counts as one such fit. The
    median speaks for all: a fit with somebody else's light in it must not make the others look like chance.
    """
    dof, median_dof = 6.0, 5.35  # mean and median of chi squared with six degrees of freedom
    ordered = sorted(costs.tolist())  # numpy's median takes longer than all else here
    half = len(ordered) // 2
    typical = 0.5 * (ordered[half] + ordered[-1 - half]) * dof / median_dof if ordered else 0.0
    squares = len(costs) * typical * sigma_px**2 + dof * prior_px**2
    return max(math.sqrt(squares / (dof * (len(costs) + 1))), 0.02)
