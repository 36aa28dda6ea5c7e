"""What fusing remembers from exposure to exposure: a value that is passed in and handed back, never changed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from asterism.protocol.geometry import Pose
from asterism.server.fusing.claims import Foreseen
from asterism.server.fusing.films import Film
from asterism.server.fusing.follow import Courses, foresee_poses
from asterism.server.fusing.places import Places
from asterism.server.fusing.sighting import Sighting

KEPT = 9  # newest intervals between frames of a camera, ...
PERIOD = 1  # ... of which, the least being 0, this one is its frame period: the others may be of frames that are lost
LONGEST_NS = 300_000_000  # after which no motion says where a robot is, however slow the camera is
UNKNOWN_PERIOD_NS = 33_400_000  # of a camera seen once whose rig tells no rate
LITTLE = 0.25  # of a frame period, by which the newest frame may be older


@dataclass(frozen=True, slots=True, eq=False)
class Pace:
    """A camera's newest frame, and the intervals, ns, between the newest ones."""

    newest: Sighting
    intervals_ns: tuple[int, ...] = ()
    period_ns: float = field(init=False)  # from one frame to the next

    def __post_init__(self) -> None:
        object.__setattr__(self, "period_ns", self._period_ns())

    def _period_ns(self) -> float:
        if self.intervals_ns:
            return float(sorted(self.intervals_ns)[min(PERIOD, len(self.intervals_ns) - 1)])
        rate = self.newest.view.rig.capture.rate_hz
        return 1e9 / rate if rate is not None else UNKNOWN_PERIOD_NS

    def followed_by(self, sighting: Sighting) -> "Pace":
        """With a newer frame; of another session, or where time ran backwards, it begins anew."""
        apart = sighting.exposed_ns - self.newest.exposed_ns
        if apart <= 0 or sighting.session != self.newest.session:
            return Pace(sighting)
        return Pace(sighting, (*self.intervals_ns, apart)[-KEPT:])

    def counts_at(self, exposed_ns: int) -> bool:
        """Whether the newest frame still counts at that exposure."""
        return abs(exposed_ns - self.newest.exposed_ns) <= min((1.0 + LITTLE) * self.period_ns, LONGEST_NS)


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """What is known of one robot: the ``cameras`` its pose rested on when it was ``seen_ns``, and the ``evidence`` for
    its tilt, nats; how far off its LEDs are, ``misfit_m``, one sigma, as found at ``misfit_ns`` (0: never); chi squared
    of its residuals and their degrees of ``freedom``, summed and slowly forgotten.
    """

    cameras: tuple[str, ...] = ()
    evidence: float = 0.0
    misfit_m: float = 0.0
    misfit_ns: int = 0
    chi2: float = 0.0
    freedom: float = 0.0
    seen_ns: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """``paces`` of all cameras heard, by their names; how robots moved, ``history``, after the newest exposures, oldest
    first; what is ``known`` of the ``robots``, by their ids; how cameras' ``places`` agree, and of each camera the
    newest ``films``, newest last.
    """

    paces: Mapping[str, Pace] = field(default_factory=dict)
    robots: tuple[str, ...] = ()
    history: tuple[tuple[int, Courses], ...] = ()
    known: Mapping[str, Known] = field(default_factory=dict)
    places: Places = field(default_factory=Places)
    films: Mapping[str, tuple[Film, ...]] = field(default_factory=dict)

    @staticmethod
    def none() -> "Joint":
        """No memory."""
        return Joint()

    def hearing(self, sightings: Sequence[Sighting], robots: tuple[str, ...]) -> "Joint":
        """With newer frames of some cameras; of other robots than before nothing is known."""
        paces = dict(self.paces)
        for sighting in sightings:
            pace = paces.get(sighting.camera)
            paces[sighting.camera] = Pace(sighting) if pace is None else pace.followed_by(sighting)
        if robots != self.robots:
            return Joint(paces, robots)
        return replace(self, paces=paces)

    def counting(self, exposed_ns: int) -> list[Sighting]:
        """The newest frames that count at that exposure, by the cameras' names in order."""
        return [pace.newest for _, pace in sorted(self.paces.items()) if pace.counts_at(exposed_ns)]

    def courses_before(self, at_ns: int) -> Courses:
        """How robots moved by exposures that were before that time, as the newest of them has it."""
        for exposed_ns, courses in reversed(self.history):
            if exposed_ns < at_ns:
                return courses
        return Courses.unknown(len(self.robots))

    def then(self, exposed_ns: int, courses: Courses) -> "Joint":
        """After one more exposure, with how robots move then. Of the history it keeps what newest frames may need."""
        oldest = min(pace.newest.exposed_ns for pace in self.paces.values() if pace.counts_at(exposed_ns))
        before = tuple(entry for entry in self.history if entry[0] < exposed_ns)
        some = [k for k, (at_ns, _) in enumerate(before) if at_ns < oldest - self._longest_ns()]
        return replace(self, history=(*before[some[-1] if some else 0 :], (exposed_ns, courses)))

    def _longest_ns(self) -> float:
        return max(pace.period_ns for pace in self.paces.values())


class Foresight:
    """Where robots should be at any time, by what was known before an exposure: calls tell it of a robot."""

    def __init__(self, joint: Joint, exposed_ns: int) -> None:
        self._robots = {robot: k for k, robot in enumerate(joint.robots)}
        self._courses = joint.courses_before(exposed_ns)
        self._at: dict[int, tuple[np.ndarray, ...]] = {}

    def __call__(self, robot: str, at_ns: int) -> Foreseen | None:
        """Where it should be at a time, none where nothing is known."""
        if at_ns not in self._at:
            r = len(self._robots)
            poses = np.empty((r, 3, 3)), np.empty((r, 3)), np.full((r, 6, 6), np.nan)
            foresee_poses(self._courses, at_ns, *poses)
            self._at[at_ns] = poses
        rotations, ts, covariances = self._at[at_ns]
        k = self._robots[robot]
        if np.isnan(covariances[k, 0, 0]):
            return None
        return Foreseen(Pose.from_matrix(rotations[k], ts[k]), covariances[k])
