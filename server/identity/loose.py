"""Robots whose rig is off: LEDs that lie beside where the rig has them, as a ruler leaves them, or a lens half known.

Where such a robot's six spots are searched with the tolerance of a good rig, they are nobody's. So what is missing
after that is searched again with the tolerance of a ruler, six spots at a time. What keeps such a claim safe is not how
well it fits but how far all else is: the separation of the robot from every other robot and labelling must be several
times the residual (`search.FARTHER_BELOW`), six spots must beat chance at that tolerance (`evidence.score`), and every
explanation of the frame that is left beside it. How far off a rig is, is a robot's own matter: each is tried with
several sigmas, of which the likeliest counts; what was learned of a robot in earlier frames counts as known.
"""

import math
from collections import Counter
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.protocol.program import typed
from asterism.server.centres.blobs import Ints
from asterism.server.identity.assign import CHANCE, Hypothesis, assign
from asterism.server.identity.evidence import Version, version_of
from asterism.server.identity.hypotheses import COST, ROBOT, Found
from asterism.server.identity.led_size import size_of
from asterism.server.identity.neighbours import Spots
from asterism.server.identity.plan import Plan
from asterism.server.identity.search import FARTHER_BELOW, SECOND_QUADS, searched
from asterism.server.pose.fit import LEDS, SYSTEMATIC_PX

RULER_M = 1e-3  # what LED positions are off where they were measured with a ruler, one sigma an axis
MOST_PX, LEAST_PX = 2.0, 0.5  # of what that may look like, and does at least
SIGMAS_PX = (SYSTEMATIC_PX, 0.5, 1.0, 2.0)  # what is tried
SEVERAL = 3  # fits that agree tell how large spots are
SIZE_SPREAD, LEAST_SIZE = 0.06, 1.0  # of an LED's size among robots, logarithm; an odd one costs only so much, nats
CLOSE = ", too much to tell it from all else"
EACH = 4  # fits of a robot, the best, that are judged
ROUNDS = 4  # of claims, each of which says more of how far off the frame's robots are


class _Fit(NamedTuple):
    """What six spots may be.

    ``scored``: at each sigma, its score where but one robot is sought, and which of the SIGMAS_PX that is (-1: what was
    learned of that robot). ``misfit_px``: one sigma of the residuals, and whether all else is so far that it is
    ``safe``. ``size``: the logarithm of the spots' radii over what they should be, nan where the rig does not say.
    """

    scored: list[tuple[Hypothesis, int]]
    misfit_px: float
    safe: bool
    size: float

    @property
    def robot(self) -> int:
        """Whose LEDs they may be."""
        return self.scored[0][0].robot

    @property
    def used(self) -> frozenset[int]:
        """The spots."""
        return self.scored[0][0].used

    def likeliest(self, alike: list[int], sought: int, alike_in_size: float) -> tuple[Hypothesis, int]:
        """With the sigma that is likeliest, its score among so many robots that are sought, and with what its spots'
        size says for it.

        Before, each sigma is as likely as the robots that were found with it make it, ``alike``, and one more.
        """
        before = [(count + 1) / (sum(alike) + len(alike)) for count in alike]
        scored = [(h.score + (math.log(before[k]) if k >= 0 else 0.0), h, k) for h, k in self.scored]
        value, best, sigma = max(scored, key=lambda entry: entry[0])
        return replace(best, score=value - math.log(sought) + alike_in_size), sigma


class _Scored(NamedTuple):
    """Where a hypothesis comes from, and with which of the SIGMAS_PX."""

    fit: _Fit
    sigma: int


def tolerance_px(plan: Plan) -> float:
    """One sigma, px an axis, of what a ruler's errors look like where robots are nearest."""
    return min(max(RULER_M * plan.focal / plan.near, LEAST_PX), MOST_PX)


def loose(
    spots: Spots, plan: Plan, misfits: Floats, found: list[Found], wanted: NDArray[np.bool_],
    rivals: list[Hypothesis],
) -> tuple[list[Found], dict[int, str]]:  # fmt: skip
    """The ``wanted`` robots (mask over the rig's) whose six LEDs are among the spots that no robot of ``found`` has,
    and doubts about such.

    ``misfits`` (robots,) m, one sigma of what is known of each robot's LEDs, 0 for nothing; ``rivals``: what was
    thought of the spots before.
    """
    if not wanted.any():
        return [], {}
    free = spots.free.copy()
    for _, labels, _, _ in found:
        free[labels[labels >= 0]] = False
    if np.count_nonzero(free) < LEDS:
        return [], {}
    spots = spots._replace(free=free)
    fits = _fits(spots, plan, misfits, wanted)
    sizes = [size_of(spots, plan, robot, labels, rotation, t) for robot, labels, rotation, t in found]
    sizes += [fit.size for fit in fits]
    claimed: dict[int, Hypothesis] = {}
    alike = [len(found), *[0] * (len(SIGMAS_PX) - 1)]
    doubts: dict[int, str] = {}
    for _ in range(ROUNDS):
        used = frozenset[int]().union(*(h.used for h in claimed.values()))
        hypotheses = [h for h in rivals if free[list(h.used)].all() and h.robot not in claimed and not h.used & used]
        sigmas: dict[Hypothesis, _Scored] = {}
        for fit in fits:
            if fit.robot not in claimed and not fit.used & used:
                left = int(wanted.sum()) - len(claimed)
                hypothesis, sigma = fit.likeliest(alike, left, _alike_in_size(fit, sizes, plan))
                sigmas[hypothesis] = _Scored(fit, sigma)
        chosen, doubts = assign([*hypotheses, *sigmas])
        safe = [h for h in chosen if h not in sigmas or sigmas[h].fit.safe]
        for h in [h for h in chosen if h not in safe]:
            doubts[h.robot] = misfit_words(sigmas[h].fit.misfit_px, CLOSE)
        if not safe:
            break
        for h in safe:
            claimed[h.robot] = h
            alike[max(sigmas[h].sigma, 0) if h in sigmas else 0] += 1
    for fit in reversed(fits):
        if doubts.get(fit.robot) == CHANCE:
            doubts[fit.robot] = misfit_words(fit.misfit_px, ", which may be chance")
    return [(h.robot, np.array(h.spots), h.rotation, h.t) for h in claimed.values()], doubts


def misfit_words(misfit_px: float, doubt: str = "") -> str:
    """What is to be said of a robot whose six spots fit but for so much, px."""
    return f"six spots fit but for {misfit_px:.1f} px{doubt}: run {typed('calibrate', 'leds')}"


def _fits(spots: Spots, plan: Plan, misfits: Floats, wanted: NDArray[np.bool_]) -> list[_Fit]:
    """What six spots may be of the wanted robots; beyond what the search calls certain only what shares no spot."""
    searching = spots._replace(free=spots.free.copy())
    brightness, unlike = np.where(wanted, 0.0, np.inf), SECOND_QUADS // int(np.count_nonzero(wanted))
    claims, pending = searched(searching, plan, ~wanted, brightness, LEDS, tolerance=tolerance_px(plan), unlike=unlike)
    taken: set[int] = set(claims.spots.ravel().tolist())
    told: list[_Fit] = []
    left = Counter[int]()
    for fits in (claims, pending):
        for k in np.argsort(fits.values[:, COST], kind="stable"):
            robot, labels, away_m = int(fits.values[k, ROBOT]), fits.spots[k], float(np.linalg.norm(fits.ts[k]))
            left[robot] += 1
            if left[robot] > EACH or (fits is pending and taken & set(labels.tolist())):
                continue
            per_px = away_m / plan.focal
            if scored := _scored(robot, labels, spots, plan, float(misfits[robot]) / per_px):
                cost_px = math.sqrt(float(fits.values[k, COST])) * tolerance_px(plan)
                safe = FARTHER_BELOW * cost_px * per_px <= plan.separations[robot]
                size = size_of(spots, plan, robot, labels, fits.rotations[k], fits.ts[k])
                told.append(_Fit(scored, cost_px / math.sqrt(LEDS), safe, size))
    return told


def _alike_in_size(fit: _Fit, sizes: list[float], plan: Plan) -> float:
    """What it says for a fit, in nats, that its spots are as large as the other fits' are for their distances.

    By chance the distance that six spots imply is anywhere in the range, and so is what their size should be.
    """
    told = [size for size in sizes if math.isfinite(size)]
    if len(told) < SEVERAL or not math.isfinite(fit.size):
        return 0.0
    off = (fit.size - float(np.median(told))) / SIZE_SPREAD
    by_chance = math.log(plan.far / plan.near * 1.5)
    return max(math.log(by_chance / (math.sqrt(2.0 * math.pi) * SIZE_SPREAD)) - 0.5 * off * off, -LEAST_SIZE)


def _scored(robot: int, labels: Ints, spots: Spots, plan: Plan, known_px: float) -> list[tuple[Hypothesis, int]]:
    """A fit with its score at every sigma at which there is a pose."""
    sigmas = list(enumerate(SIGMAS_PX))
    if known_px > 0.0:
        sigmas.append((-1, max(known_px, SYSTEMATIC_PX)))
    scored: list[tuple[Hypothesis, int]] = []
    version = Version(np.empty(LEDS, np.int64), np.empty((3, 3)), np.empty(3))
    for number, sigma_px in sigmas:
        value, height = version_of(
            plan.layouts[robot], plan.extents[robot], labels, spots, plan.focal, sigma_px, 1, version
        )
        if value > -math.inf:
            pose = version.rotation.copy(), version.t.copy()
            scored.append((Hypothesis(robot, tuple(labels.tolist()), height, value, *pose), number))
    return scored
