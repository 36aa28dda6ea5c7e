"""Robots that no camera claims and nobody foresees: found where the unexplained spots of all cameras together show one.

Three LEDs in one camera and three or four in another are a pose. `triples` makes guesses of three spots; each gathers
what all cameras show of it (`joined`); what holds is decided by the odds against chance, for all ways that there were
to try, and over whatever explains the same spots, or the same robot elsewhere.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.rig import Rig, Robot
from asterism.server.centres.blobs import Ints
from asterism.server.fusing.arrays import still
from asterism.server.fusing.decide import LEAST_ODDS, Doubts, decided
from asterism.server.fusing.joined import UNKNOWN_RATES, Hypothesis, Joined, without
from asterism.server.fusing.look import Body, Course, State
from asterism.server.fusing.triples import Guesses, Limits, Scratch, Sought, guess, room_to_guess
from asterism.server.identity.plan import NEARER, plan_for
from asterism.server.pose.fit import SYSTEMATIC_PX

LEAST = 6  # LEDs seen in all cameras together
SHARP_PX = 0.08  # what a good rig is off
GUESSES = 96  # that are kept
EXPLAINED = 40  # of them, that are looked into
MOST = 10_000  # poses that are tried in one exposure
AT_ONCE = 1500  # before what they explain is looked into
MOST_THERE = 20_000  # where a robot may be, before that is decided
STRIDE = 7919  # a prime: another exposure begins elsewhere
TICK_NS = 1_000_000
SAME_M, SAME_RAD = 0.1, 0.15  # of a robot's extent: poses that are one
SIGMAS = 5.2  # of chi squared about its mean, its own sigma the unit, beyond which a fit is none


def searched(
    joined: Joined, sought: Sequence[Robot], free: NDArray[np.bool_], most: int = MOST
) -> tuple[list[Hypothesis], Doubts]:
    """Which of the ``sought`` robots the ``free`` (n,) spots show, and for those that are in doubt what they may be.

    At most so many poses are tried; the exposure's time says where to begin.
    """
    if not sought or _too_few(joined, free):
        return [], {}
    found: list[Hypothesis] = []
    doubts: Doubts = {}
    start = (joined.exposed_ns // TICK_NS) * STRIDE
    while sought and most > 0:
        told, tried, turns = _explanations(joined, sought, free, (min(most, AT_ONCE), start))
        likely = [one for one in told if one.odds >= LEAST_ODDS]
        if likely:
            # Nothing is decided before all is tried that the same spots may be.
            there = free & _around(joined, likely)
            told = told + _explanations(joined, sought, there, (MOST_THERE, 0))[0]
        more, doubtful = decided(_best_of_each(told))
        found, doubts = found + more, doubts | doubtful
        # Spots that are explained are searched no more.
        free = without(free, [*more, *(one for group in doubtful.values() for one in group)])
        sought = [robot for robot in sought if all(robot.id not in of for of in (doubts, [h.robot for h in found]))]
        if (turns < 0 and not more) or _too_few(joined, free):
            break
        start, most = start + max(turns, 0), most - max(tried, 1)
    return found, doubts


def _too_few(joined: Joined, free: NDArray[np.bool_]) -> bool:
    """Whether no camera has three free spots, or all together no six."""
    counts = [int(free[a:b].sum()) for a, b in pairwise(joined.scene.first)]
    return max(counts) < 3 or sum(counts) < LEAST or sum(count > 0 for count in counts) < 2


def _around(joined: Joined, likely: Sequence[Hypothesis]) -> NDArray[np.bool_]:
    """Which spots (n,) stand where robots may be."""
    near = np.zeros(len(joined.scene.rays), np.bool_)
    for one in likely:
        near |= joined.near(one.state.t, one.whose.extent)
    return near


def _explanations(
    joined: Joined, sought: Sequence[Robot], free: NDArray[np.bool_], limits: tuple[int, int]
) -> tuple[list[Hypothesis], int, int]:
    """What the guesses explain, each with its odds after all ways there were to try; how many poses were tried, and of
    how many triples, -1 for all. ``limits``: of poses, and the triple to begin with.
    """
    guesses, tried, turns = _guesses(joined, sought, free, limits)
    told: list[Hypothesis] = []
    order = np.argsort(-guesses.seen, kind="stable")
    for k in order[guesses.seen[order] >= LEAST][:EXPLAINED]:
        number, camera, *rest = guesses.who[k].tolist()
        spots, leds = rest[:3], rest[3:6]
        robot = sought[number]
        if any(other.robot == robot.id and (other.labels[camera, leds] == spots).all() for other in told):
            continue
        start = State(guesses.rotations[k], guesses.ts[k], np.zeros((6, 6)))
        labels = joined.no_labels()
        labels[camera, leds] = spots
        best = _explained(joined, robot, start, labels, free)
        if best is not None:
            told.append(replace(best, odds=best.odds - math.log(len(sought))))
    return told, tried, turns


def _explained(joined: Joined, robot: Robot, start: State, labels: Ints, free: NDArray[np.bool_]) -> Hypothesis | None:
    """What the spots around a guess are, with the likeliest of what the rig may be off; None where they do not hold."""
    open_spots = free.copy()
    open_spots[labels[labels >= 0]] = False
    best: Hypothesis | None = None
    for body in _bodies(joined, robot):
        told = joined.explain_with(body, robot, start, labels, open_spots.copy())
        if told is not None and _holds(told) and (best is None or told.odds > best.odds):
            best = told
    return best


def _holds(told: Hypothesis) -> bool:
    """Whether at least six spots in two cameras fit."""
    freedom = 2.0 * told.count - 6.0
    return told.count >= LEAST and len(told.cameras()) > 1 and told.chi2 < freedom + SIGMAS * math.sqrt(2.0 * freedom)


def _bodies(joined: Joined, robot: Robot) -> Iterator[Body]:
    """The robot as it may be off: as was learned, or as of a good rig and a worse one."""
    body = joined.body(robot)
    yield body
    if body.misfit == 0.0:
        yield body._replace(systematic=body.systematic * (SHARP_PX / SYSTEMATIC_PX))


def _guesses(
    joined: Joined, sought: Sequence[Robot], free: NDArray[np.bool_], limits: tuple[int, int]
) -> tuple[Guesses, int, int]:
    bodies = [joined.body(robot) for robot in sought]
    robots = Sought(
        np.array([body.layout for body in bodies]),
        np.array([body.optics for body in bodies]),
        np.array([body.misfit for body in bodies]),
        np.array([body.systematic for body in bodies]),
        np.array([robot.extent for robot in sought]),
    )
    near, far = np.array([_range_of(sighting.view.rig) for sighting in joined.sightings]).T.copy()
    guesses = room_to_guess(GUESSES)
    prior = State(np.eye(3), np.zeros(3), np.zeros((6, 6)))
    scratch = Scratch(State(np.eye(3), np.zeros(3), np.zeros((6, 6))), prior, joined.room)
    within = Limits(near, far, *limits)
    tried, turns = guess(joined.scene, robots, _course(joined), free, within, scratch, guesses)
    return guesses, tried, turns


@lru_cache(maxsize=64)
def _range_of(rig: Rig) -> tuple[float, float]:
    """Within which distances, m, a camera's robots are looked for."""
    plan = plan_for(rig)
    return NEARER * plan.near, plan.far


def _course(joined: Joined) -> Course:
    """Of robots whose motion nobody knows."""
    course = still(len(joined.sightings))
    for k, sighting in enumerate(joined.sightings):
        course.drifts[k] = abs(sighting.exposed_ns - joined.exposed_ns) * 1e-9 * np.array(UNKNOWN_RATES)
    return course


def is_same(one: Hypothesis, other: Hypothesis) -> bool:
    """Whether two hypotheses are one robot at one place."""
    if one.robot != other.robot:
        return False
    if math.dist(one.state.t, other.state.t) > SAME_M * one.whose.extent:
        return False
    return float(np.sum(one.state.rotation * other.state.rotation)) > 1.0 + 2.0 * math.cos(SAME_RAD)


def _best_of_each(hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """The likeliest first, each place of a robot once."""
    kept: list[Hypothesis] = []
    for hypothesis in sorted(hypotheses, key=lambda h: -h.odds):
        if not any(is_same(hypothesis, other) for other in kept):
            kept.append(hypothesis)
    return kept
