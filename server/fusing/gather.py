"""Claims as the arrays that the compiled solution takes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats, Pose
from asterism.server.fusing.fleet import Fleet
from asterism.server.fusing.follow import ARM2, JERKS, UNKNOWN_RATES, Courses
from asterism.server.fusing.joint_rays import Bodies, Bundle, Eyes, Motion, Poses
from asterism.server.fusing.sighting import Sighting
from asterism.server.pose.lens import FX, FY
from asterism.server.pose.matched import LEAST_SIGMA_PX
from asterism.server.pose.spot_shift import OPTICS
from asterism.server.pose.track import FORGET_NS


@dataclass(frozen=True, slots=True, eq=False)
class Wanted:
    """A robot to be solved for: its ``spots`` by the cameras' names, rows of their sightings, -1 for LEDs not seen,
    from a ``start``, T_world_robot, with LEDs that are off by ``misfit_m``, one sigma.
    """

    robot: str
    spots: Mapping[str, NDArray[np.int64]]
    start: Pose
    misfit_m: float


class Sight:
    """What one exposure's solutions have in common: all rays of all cameras' newest frames, how the cameras stand, and
    how robots moved before any of the rays were seen.

    ``rays`` (n, 2), their ``covariances`` (n, 3), and the ``times`` (n,) s after the exposure at which they were seen;
    ``first`` of each camera's by its name, which is the ``number``-th of all; ``focal_px`` (c,).
    """

    def __init__(self, fleet: Fleet, sightings: Sequence[Sighting], exposed_ns: int, courses: Courses) -> None:
        self.fleet, self.exposed_ns, self.courses = fleet, exposed_ns, courses
        self.sightings = {sighting.camera: sighting for sighting in sightings}
        self.names = sorted(fleet.views)
        self.number = {name: k for k, name in enumerate(self.names)}
        self.robots = {robot: k for k, robot in enumerate(fleet.robots)}
        self.bodies, self.eyes = bodies_of(fleet), eyes_of(fleet, sightings)
        self.focal_px = focal_px(fleet)
        self.first: dict[str, int] = {}
        total = 0
        for sighting in sightings:
            self.first[sighting.camera] = total
            total += len(sighting.rays)
        self.rays = np.concatenate([sighting.rays for sighting in sightings])
        self.covariances = np.concatenate([with_floor(sighting) for sighting in sightings])
        self.times = np.concatenate([times_of(sighting, exposed_ns) for sighting in sightings])

    def bundle(self, wanted: Sequence[Wanted]) -> tuple[Bundle, Motion, Poses]:
        """The rays of robots, how they move, and poses with their starts in them."""
        spots = np.array([of for one in wanted for of in one.spots.values()])
        firsts = np.array([self.first[camera] for one in wanted for camera in one.spots])
        numbers = np.array([self.number[camera] for one in wanted for camera in one.spots], np.int64)
        group, leds = np.nonzero(spots >= 0)
        rows = spots[group, leds] + firsts[group]
        owner = np.repeat(np.arange(len(wanted)), [len(one.spots) for one in wanted])[group]
        robots = np.array([self.robots[one.robot] for one in wanted], np.int64)
        bundle = Bundle(
            np.searchsorted(owner, np.arange(len(wanted) + 1)),
            self.rays[rows],
            self.covariances[rows],
            numbers[group],
            np.ascontiguousarray(leds),  # a column of what is found; kernels take whole arrays
            self.times[rows],
            robots,
            np.array([one.misfit_m for one in wanted]),
        )
        poses = Poses.room(len(wanted), len(rows))
        for k, one in enumerate(wanted):
            poses.rotations[k], poses.ts[k] = one.start.rotation, one.start.position
        return bundle, motion_of(self.courses, robots, self.exposed_ns), poses


@lru_cache(maxsize=4)
def bodies_of(fleet: Fleet) -> Bodies:
    """The fleet's robots in its order; what shifts their spots, by the views in the order of their names."""
    robots, views = list(fleet.robots.values()), [fleet.views[name] for name in sorted(fleet.views)]
    nothing = np.zeros(OPTICS)
    return Bodies(
        np.array([robot.T_robot_plane.rotation for robot in robots]),
        np.array([robot.T_robot_plane.position for robot in robots]),
        np.array([robot.leds_plane for robot in robots]),
        np.array([[view.optics.get(robot.id, nothing) for robot in robots] for view in views]),
    )


@lru_cache(maxsize=4)
def _standing(fleet: Fleet) -> Eyes:
    """The fleet's cameras where their rigs have them, in the order of their names."""
    views = [view for _, view in sorted(fleet.views.items())]
    back = [view.T_world_camera.inverse() for view in views]
    return Eyes(
        np.array([T.rotation for T in back]),
        np.array([T.position for T in back]),
        np.array([view.T_world_camera.position for view in views]),
        np.array([view.place_covariance for view in views]),
    )


@lru_cache(maxsize=4)
def focal_px(fleet: Fleet) -> Floats:
    """Of the cameras (c,) in the order of their names."""
    return np.array([np.sqrt(view.lens[FX] * view.lens[FY]) for _, view in sorted(fleet.views.items())])


def eyes_of(fleet: Fleet, sightings: Sequence[Sighting]) -> Eyes:
    """The cameras in the order of all their names, where their newest frames have them."""
    eyes = _standing(fleet)
    elsewhere = [sighting for sighting in sightings if sighting.T_world_camera is not sighting.view.T_world_camera]
    if elsewhere:
        eyes = Eyes._make(column.copy() for column in eyes)
        names = sorted(fleet.views)
        for sighting in elsewhere:
            k, T = names.index(sighting.camera), sighting.T_world_camera
            turn = T.rotation
            eyes.rotations[k], eyes.ts[k], eyes.origins[k] = turn.T, -turn.T @ T.position, T.position
            eyes.places[k] = sighting.place_covariance
    return eyes


def motion_of(courses: Courses, robots: NDArray[np.int64], exposed_ns: int) -> Motion:
    """How robots, rows (m,) of the courses, move: as known before, or at any speed."""
    seen_ns = courses.seen_ns[robots]
    gone = exposed_ns - seen_ns
    known = (seen_ns > 0) & (gone >= 0) & (gone <= FORGET_NS)
    rates, covariances = courses.states[robots], courses.covariances[robots]
    densities = np.repeat((courses.weights[robots] @ JERKS)[:, None] * [1.0, ARM2], 3, axis=1)
    rates[~known], covariances[~known], densities[~known] = 0.0, UNKNOWN_RATES, JERKS[-1] * np.repeat([1.0, ARM2], 3)
    return Motion(np.where(known, gone * 1e-9, 0.0), rates, covariances, densities)


def with_floor(sighting: Sighting) -> Floats:
    """Covariances (n, 3) of the rays: no centre is known better than that."""
    lens = sighting.view.lens
    out: Floats = sighting.ray_covariances + LEAST_SIGMA_PX**2 / (lens[FX] * lens[FY]) * np.array([1.0, 0.0, 1.0])
    return out


def times_of(sighting: Sighting, exposed_ns: int) -> Floats:
    """When the rays were seen (n,), s after an exposure: a rolling shutter sees each at its row's time."""
    rig = sighting.view.rig
    times = np.full(len(sighting.rays), (sighting.exposed_ns - exposed_ns) * 1e-9)
    line_s = 1e-6 * rig.capture.line_time_us
    if line_s > 0.0:
        times += (sighting.centres_px[:, 1] - 0.5 * (rig.camera.height - 1)) * line_s
    return times
