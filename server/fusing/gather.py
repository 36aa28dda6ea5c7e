"""Claims as the arrays that the compiled solution takes."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from asterism.protocol.geometry import Floats, Pose
from asterism.server.fusing.claims import Claim
from asterism.server.fusing.fleet import Fleet
from asterism.server.fusing.joint_solve import Bodies, Bundle, Eyes, Poses
from asterism.server.fusing.sighting import Sighting
from asterism.server.pose.lens import FX, FY
from asterism.server.pose.matched import LEAST_SIGMA_PX
from asterism.server.pose.spot_shift import OPTICS


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


def eyes_of(fleet: Fleet, sightings: Sequence[Sighting]) -> Eyes:
    """The cameras in the order of all their names; those that are not among the sightings stand anywhere."""
    names = sorted(fleet.views)
    c = len(names)
    eyes = Eyes(np.tile(np.eye(3), (c, 1, 1)), np.zeros((c, 3)), np.zeros((c, 3)), np.zeros((c, 6, 6)))
    for sighting in sightings:
        k, T = names.index(sighting.camera), sighting.T_world_camera
        turn = T.rotation
        eyes.rotations[k], eyes.ts[k], eyes.origins[k] = turn.T, -turn.T @ T.position, T.position
        eyes.places[k] = sighting.place_covariance
    return eyes


class Rays:
    """All rays of some sightings, one after the other: ``rays`` (n, 2), their ``covariances`` (n, 3), and the times
    (n,) s after an exposure at which they were seen; ``first`` of each camera's by its name.
    """

    def __init__(self, sightings: Sequence[Sighting], names: Sequence[str], exposed_ns: int) -> None:
        self.first: dict[str, int] = {}
        self.number = {name: k for k, name in enumerate(names)}
        total = 0
        for sighting in sightings:
            self.first[sighting.camera] = total
            total += len(sighting.rays)
        self.rays = np.concatenate([sighting.rays for sighting in sightings])
        self.covariances = np.concatenate([with_floor(sighting) for sighting in sightings])
        self.times = np.concatenate([times_of(sighting, exposed_ns) for sighting in sightings])


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


def bundle_of(wanted: Sequence[tuple[Claim, Pose, float]], fleet: Fleet, rays: Rays) -> tuple[Bundle, Poses]:
    """The rays of claims, each with a start T_world_robot and how far off its LEDs are, one sigma, m; and its poses
    with the starts in them.
    """
    robots = {robot: k for k, robot in enumerate(fleet.robots)}
    counts, rows, cameras, leds = [0], [], [], []
    for claim, _, _ in wanted:
        count = 0
        for camera, spots in claim.spots.items():
            seen = np.flatnonzero(spots >= 0)
            rows.append(spots[seen] + rays.first[camera])
            leds.append(seen)
            cameras.append(np.full(len(seen), rays.number[camera]))
            count += len(seen)
        counts.append(count)
    which = np.concatenate(rows)
    bundle = Bundle(
        np.cumsum(counts),
        rays.rays[which],
        rays.covariances[which],
        np.concatenate(cameras),
        np.concatenate(leds),
        rays.times[which],
        np.array([robots[claim.robot] for claim, _, _ in wanted]),
        np.array([misfit for _, _, misfit in wanted]),
    )
    poses = Poses.room(len(wanted), len(which))
    for k, (_, start, _) in enumerate(wanted):
        poses.rotations[k], poses.ts[k] = start.rotation, start.position
    return bundle, poses
