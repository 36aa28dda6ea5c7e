"""Films of drawn sightings: cameras as their rigs have them, and as they are."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from asterism.protocol.codec import set_report_pose
from asterism.protocol.geometry import Floats, Pose, log_rotation
from asterism.server.fusing.fleet import Fleet, View
from asterism.server.fusing.follow import Courses
from asterism.server.fusing.fuse import fuse
from asterism.server.fusing.fused import Fused, FusedPose
from asterism.server.fusing.gather import Sight, Wanted
from asterism.server.fusing.memory import Joint
from asterism.server.fusing.sighting import Sighting
from asterism.server.fusing.solution import solutions
from asterism.server.pose.place import moved
from tests.fusing.drawn import Seen, sighting
from tests.several import Drive, rigs_at

START_NS, PERIOD_NS = 1_000_000_000, 16_666_667


@dataclass
class Film:
    """Cameras at ``places``; some of them truly ``moved`` (6,) m and rad from there, by their names; ``late_ns`` of
    some; LEDs elsewhere by ``led_errors``; a camera shows frames ``from_frame`` ``to_frame`` on.
    """

    places: Sequence[Pose]
    moved: Mapping[str, Floats] = field(default_factory=dict)
    late_ns: Mapping[str, int] = field(default_factory=dict)
    led_errors: Mapping[str, Floats] = field(default_factory=dict)
    place_covariance: Floats = field(default_factory=lambda: np.zeros((6, 6)))
    shown: Mapping[str, range] = field(default_factory=dict)
    seed: int = 0
    own: bool = False  # cameras' own poses are those of their spots

    def lines(self, frames: int, rng: np.random.Generator) -> Iterator[tuple[Fused, dict[str, Pose], Joint]]:
        """What fusing makes of it, and where robots truly are."""
        views = [View(rig, self.place_covariance) for rig in rigs_at(self.places, 2, self.seed)]
        fleet, joint = Fleet.of(views), Joint.none()
        drive = Drive(tuple(fleet.robots), self.seed)
        times: dict[int, list[View]] = {}
        for k in range(frames):
            for view in views:
                if k in self.shown.get(view.camera, range(frames)):
                    at_ns = START_NS + k * PERIOD_NS + self.late_ns.get(view.camera, 0)
                    times.setdefault(at_ns, []).append(view)
        for at_ns in sorted(times):
            true = drive(at_ns * 1e-9)
            seen = [sighting(view, true, at_ns, rng, self._seen(view)) for view in times[at_ns]]
            if self.own:
                for one in seen:
                    tell_own(one, fleet, true)
            fused, joint = fuse(seen, fleet, joint)
            yield fused, true, joint

    def _seen(self, view: View) -> Seen:
        place = moved(view.T_world_camera, self.moved.get(view.camera, np.zeros(6)))
        return Seen(place, self.led_errors)


def tell_own(seen: Sighting, fleet: Fleet, true: Mapping[str, Pose]) -> None:
    """Let a camera tell of its robots what its own six spots of each say."""
    sight = Sight(fleet, [seen], seen.exposed_ns, Courses.unknown(len(fleet.robots)))
    for number, robot in enumerate(seen.told.values()):
        (found,) = solutions([Wanted(robot.id, {seen.camera: 6 * number + np.arange(6)}, true[robot.id], 0.0)], sight)
        assert found is not None
        set_report_pose(robot.pose, found.pose)
        robot.covariance[:] = found.covariance.ravel().tolist()


def error_of(answer: object, truth: Pose) -> tuple[Floats, float]:
    """Error (6,) of a pose, m and rad, and its square weighted by the covariance."""
    assert isinstance(answer, FusedPose)
    turn = log_rotation(answer.pose.rotation @ truth.rotation.T)
    error = np.concatenate([answer.pose.position - truth.position, turn])
    return error, float(error @ np.linalg.solve(answer.covariance, error))
