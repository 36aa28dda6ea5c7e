"""What fusing remembers from exposure to exposure: a value that is passed in and handed back, never changed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from asterism.server.fusing.sighting import Sighting

KEPT = 5  # newest intervals between frames of a camera: their middle one is its frame period
UNKNOWN_PERIOD_NS = 33_400_000  # of a camera seen once whose rig tells no rate
LITTLE = 0.25  # of a frame period, by which the newest frame may be older


@dataclass(frozen=True, slots=True, eq=False)
class Pace:
    """A camera's newest frame, and the intervals, ns, between the newest ones."""

    newest: Sighting
    intervals_ns: tuple[int, ...] = ()

    @property
    def period_ns(self) -> float:
        """From one frame to the next."""
        if self.intervals_ns:
            return float(sorted(self.intervals_ns)[(len(self.intervals_ns) - 1) // 2])
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
        return abs(exposed_ns - self.newest.exposed_ns) <= (1.0 + LITTLE) * self.period_ns


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """``paces`` of all cameras heard, by their names."""

    paces: Mapping[str, Pace] = field(default_factory=dict)

    @staticmethod
    def none() -> "Joint":
        """No memory."""
        return Joint()

    def hearing(self, sightings: Sequence[Sighting]) -> "Joint":
        """With newer frames of some cameras."""
        paces = dict(self.paces)
        for sighting in sightings:
            pace = paces.get(sighting.camera)
            paces[sighting.camera] = Pace(sighting) if pace is None else pace.followed_by(sighting)
        return replace(self, paces=paces)

    def counting(self, exposed_ns: int) -> list[Sighting]:
        """The newest frames that count at that exposure, by the cameras' names in order."""
        return [pace.newest for _, pace in sorted(self.paces.items()) if pace.counts_at(exposed_ns)]
