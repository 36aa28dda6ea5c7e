"""The frames of several cameras joined, exposure by exposure: the pure function at the heart of `asterism fuse`.

Of every exposure: the newest frames of all cameras that are not too old (`memory`), whose spots are whose (`claims`),
each robot's pose from all its rays (`solution`), cameras that contradict the others left out (`disagree`, `places`),
what is learned of the robots' LEDs (`misfit`) and motion (`follow`) for the next.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from asterism.server.chain.answers import NO_POSE
from asterism.server.fusing.claims import Claim, Foreseen, claims_of
from asterism.server.fusing.disagree import is_surprising, misplaced_text, off_of, sorted_out
from asterism.server.fusing.films import Film, Spots, films_of, pairs_of
from asterism.server.fusing.fleet import Fleet
from asterism.server.fusing.follow import Courses, Look, follow
from asterism.server.fusing.fused import Fused, FusedPose
from asterism.server.fusing.gather import Sight, Wanted
from asterism.server.fusing.memory import Foresight, Joint, Known
from asterism.server.fusing.misfit import is_due, looked_at
from asterism.server.fusing.passed import passed_through
from asterism.server.fusing.places import Places, add_ties, judged
from asterism.server.fusing.quick import quick_claims
from asterism.server.fusing.sighting import Sighting
from asterism.server.fusing.solution import Solution, are_unlike, likelier, solutions, tilt_squares, unlike_starts
from asterism.server.pose.solve import Lost
from asterism.server.pose.track import MOST_EVIDENCE, TILT_MEMORY

FRAME_S = 1.0 / 60.0  # TILT_MEMORY is for
COMPARED_NS = 40_000_000  # from one comparison of the cameras' places to the next
KEPT_FILMS = 2  # from so many frames ago to now a robot's rays move
ELSEWHERE_M, ELSEWHERE = 0.01, 6.0  # m, and sigmas, from where a robot should be
KEPT_S = 3.0  # how long residuals count
USUAL_FREEDOM = 300.0  # of the belief that spots are as uncertain as they say
LEAST_SCALE, MOST_SCALE = 0.8, 4.0


def fuse(sightings: Sequence[Sighting], fleet: Fleet, before: Joint) -> tuple[Fused, Joint]:
    """Every robot at one exposure, from all cameras' newest frames; the same arguments give the same results.

    ``sightings`` are those of the cameras that exposed at exactly that time, one or more. ``before`` is what fusing
    the exposures before handed back, `Joint.none()` at first.
    """
    line = solved(sightings, fleet, before)
    return line.fused, line.memory()


def solved(sightings: Sequence[Sighting], fleet: Fleet, before: Joint) -> "Line":
    """The same in two steps, for who is in a hurry: an exposure with its poses, and its memory when it is asked for."""
    exposed_ns = sightings[0].exposed_ns
    joint = before.hearing(sightings, tuple(fleet.robots))
    current = joint.counting(exposed_ns)
    foresight = Foresight(joint, exposed_ns)
    courses = joint.courses_before(min(sighting.exposed_ns for sighting in current))
    sight = Sight(fleet, current, exposed_ns, courses)
    cameras = tuple(sorted(sighting.camera for sighting in sightings))
    claims = quick_claims(fleet, current, foresight, exposed_ns)
    if claims is not None:
        line = Line(joint, sight, foresight, claims, cameras)
        if not line.surprised:
            return line
    return Line(joint, sight, foresight, claims_of(fleet, current, foresight), cameras)


class Line:
    """One exposure being solved, of the ``cameras`` that exposed then: its answers, and what is known of robots and
    places after it.
    """

    def __init__(
        self, joint: Joint, sight: Sight, foresight: Foresight, claims: Mapping[str, Claim | Lost],
        cameras: tuple[str, ...],
    ) -> None:  # fmt: skip
        self.joint, self.sight, self.foresight, self.cameras = joint, sight, foresight, cameras
        self.surprised = False
        self.answers: dict[str, FusedPose] = {}
        self.known: dict[str, Known] = dict(joint.known)
        self.places: Places = joint.places
        self.spots: dict[str, Spots] = {}
        self._claims = claims
        self._joined: list[Wanted] = []
        self._solve([claim for claim in claims.values() if isinstance(claim, Claim)])

    @property
    def fused(self) -> Fused:
        """What is said of the exposure."""
        nothing = Lost(NO_POSE)
        answers = {
            robot: claim if isinstance(claim, Lost) else self.answers.get(robot, nothing)
            for robot, claim in self._claims.items()
        }
        return Fused(self.sight.exposed_ns, self.cameras, answers)

    def memory(self) -> Joint:
        """What is remembered for the exposures after it."""
        exposed_ns, films = self.sight.exposed_ns, films_of(self.cameras, self.spots, self.sight)
        after = self.joint.then(exposed_ns, self._followed(films))
        kept = {**self.joint.films, **_longer(self.joint.films, films)}
        return replace(after, known=self._known_after(), places=self._compared(), films=kept)

    def _known_after(self) -> dict[str, Known]:
        """What is known of the robots, once the LEDs of one whose turn it is were looked at again."""
        due = [wanted for wanted in self._joined if is_due(self.known[wanted.robot], self.sight.exposed_ns)]
        if not due:
            return self.known
        wanted = min(due, key=lambda one: self.known[one.robot].misfit_ns)
        start = self.answers[wanted.robot].pose
        again = looked_at(replace(wanted, start=start), self.sight, self.known[wanted.robot])
        return {**self.known, wanted.robot: again}

    def _solve(self, claims: Sequence[Claim]) -> None:
        """Answer for all robots that have spots."""
        alone: list[tuple[Claim, Wanted]] = []
        shared: list[tuple[Claim, Wanted]] = []
        for claim in claims:
            self.spots[claim.robot] = claim.spots
            wanted = self._wanted(claim)
            (alone if len(wanted.spots) == 1 else shared).append((claim, wanted))
        for claim, wanted in alone:
            self._pass(wanted, claim)
        found = solutions([wanted for _, wanted in shared], self.sight)
        for (claim, wanted), one in zip(shared, found, strict=True):
            self._join(wanted, claim, one)

    def _wanted(self, claim: Claim) -> Wanted:
        """The claim without cameras that are misplaced, if others see the robot."""
        known = self.known.get(claim.robot, Known())
        spots = claim.spots
        if self.places.misplaced:
            spots = {name: of for name, of in spots.items() if name not in self.places.misplaced}
        return Wanted(claim.robot, spots or claim.spots, claim.starts[0], known.misfit_m)

    def _pass(self, wanted: Wanted, claim: Claim) -> None:
        known = self.known.get(wanted.robot, Known())
        passed = passed_through(wanted, self.sight, self.foresight, self._evidence(known))
        if passed is not None:
            told, evidence = passed
            foreseen = self.foresight(wanted.robot, self.sight.exposed_ns)
            self.surprised |= foreseen is not None and _is_elsewhere(told, foreseen)
            self._tell(wanted.robot, self._with_misplaced(told, claim, None), None, evidence)

    def _join(self, wanted: Wanted, claim: Claim, found: Solution | None) -> None:
        known = self.known.get(wanted.robot, Known())
        if not known.misfit_ns:
            start = wanted.start if found is None else found.pose
            known = self.known[wanted.robot] = looked_at(replace(wanted, start=start), self.sight, known)
            wanted = replace(wanted, misfit_m=known.misfit_m)
            (found,) = solutions([wanted], self.sight)
        self._joined.append(wanted)
        starts = claim.starts if found is None else [one for one in claim.starts if are_unlike(one, found.pose)]
        best = found
        if starts:
            others = [replace(wanted, start=start) for start in unlike_starts(starts)]
            tried = [found, *solutions(others, self.sight)]
            best = likelier(tried, self._leaning(tried, known))
        if best is None:
            return
        told, rests = sorted_out(best, self.sight, _scale(known), self.foresight, self.places.apart is not None)
        self.surprised |= bool(told.left_out) or rests is None or is_surprising(rests.cost, rests.freedom)
        self._tell(wanted.robot, self._with_misplaced(told, claim, rests), rests, best.evidence)

    def _leaning(self, tried: Sequence[Solution | None], known: Known) -> list[float]:
        """Nats that what was known before has for each of a robot's tilts."""
        evidence, leaning = self._evidence(known), [0.0] * len(tried)
        if len(tried) < 2 or evidence == 0.0:
            return leaning
        for k, one in enumerate(tried):
            foreseen = self.foresight(one.wanted.robot, self.sight.exposed_ns) if one is not None else None
            if one is not None and foreseen is not None:
                leaning[k] = -min(0.5 * tilt_squares(foreseen.pose, one.pose), evidence)
        return leaning

    def _evidence(self, known: Known) -> float:
        """What is left of the evidence for the tilt that was known."""
        gone_s = (self.sight.exposed_ns - known.seen_ns) * 1e-9
        return known.evidence * TILT_MEMORY ** (gone_s / FRAME_S) if 0.0 < gone_s < 1.0 else 0.0

    def _with_misplaced(self, told: FusedPose, claim: Claim, rests: Solution | None) -> FusedPose:
        """With what is said of cameras that are misplaced and see the robot."""
        said = {name: misplaced_text(self.places.misplaced[name]) for name in claim.spots
                if name in self.places.misplaced and name not in told.cameras}  # fmt: skip
        if rests is not None and said:
            said |= off_of(sorted(said), claim.spots, rests, self.sight)
        return replace(told, left_out={**told.left_out, **said}) if said else told

    def _tell(self, robot: str, told: FusedPose, rests: Solution | None, evidence: float) -> None:
        self.answers[robot] = told
        known, exposed_ns = self.known.get(robot, Known()), self.sight.exposed_ns
        chi2, freedom = known.chi2, known.freedom
        if rests is not None:
            gone_s = (exposed_ns - known.seen_ns) * 1e-9
            keep = math.exp(-gone_s / KEPT_S) if 0.0 <= gone_s < KEPT_S else 0.0
            chi2, freedom = keep * chi2 + rests.cost, keep * freedom + rests.freedom
        evidence = min(evidence, MOST_EVIDENCE)
        self.known[robot] = Known(
            told.cameras, evidence, known.misfit_m, known.misfit_ns, chi2, freedom, seen_ns=exposed_ns
        )

    def _compared(self) -> Places:
        """What is known of the cameras' places, with what their rays tell, whether they are left out or not."""
        wanted = [
            Wanted(robot, self.spots[robot], told.pose, self.known[robot].misfit_m)
            for robot, told in self.answers.items()
            if len(self.spots[robot]) > 1
        ]
        sight, places = self.sight, self.places
        if len(sight.names) < 2 or not wanted or abs(sight.exposed_ns - places.at_ns) < COMPARED_NS:
            return places
        places = places.later(sight.names, sight.exposed_ns)
        bundle, motion, poses = sight.bundle(wanted)
        normal, right = places.normal.copy(), places.right.copy()
        count, stays = add_ties(sight.eyes, sight.bodies, bundle, motion, poses, normal, right)
        places = replace(places, normal=normal, right=right, ties=places.ties + count, stays=places.stays + stays)
        return judged(places, sight.eyes.places, len(wanted))

    def _followed(self, films: Mapping[str, Film]) -> Courses:
        """How the robots move after this exposure, whose frames are ``films``."""
        sight = self.sight
        courses = self.joint.courses_before(sight.exposed_ns).copied()
        robots = np.array([sight.robots[robot] for robot in self.answers], np.int64)
        if len(robots):
            told = list(self.answers.values())
            look = Look(
                robots, np.array([one.pose.rotation for one in told]), np.array([one.pose.position for one in told]),
                np.array([one.covariance for one in told]),
            )  # fmt: skip
            before = {name: some[0] for name, some in self.joint.films.items()}
            pairs, motion = pairs_of(robots, before, films, sight)
            follow(courses, look, sight.exposed_ns, sight.eyes, sight.bodies, pairs, motion)
        return courses


def _is_elsewhere(told: FusedPose, foreseen: Foreseen) -> bool:
    """Whether a robot is nowhere near where it should be."""
    off = told.pose.position - foreseen.pose.position
    variance = float(np.trace(told.covariance[:3, :3]) + np.trace(foreseen.covariance[:3, :3]))
    return float(off @ off) > ELSEWHERE_M**2 + ELSEWHERE**2 * variance


def _longer(before: Mapping[str, tuple[Film, ...]], now: Mapping[str, Film]) -> dict[str, tuple[Film, ...]]:
    """Every camera's films with the newest one."""
    return {name: (*before.get(name, ()), film)[-KEPT_FILMS:] for name, film in now.items()}


def _scale(known: Known) -> float:
    """What residuals so far say of variances that spots tell."""
    told = (known.chi2 + USUAL_FREEDOM) / (known.freedom + USUAL_FREEDOM)
    return min(max(told, LEAST_SCALE), MOST_SCALE)
