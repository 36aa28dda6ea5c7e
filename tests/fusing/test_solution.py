"""The fast joint solution beside a slow and obvious one: everything that may be off an unknown of its own."""

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.optimize import least_squares

from asterism.protocol.geometry import Floats, Pose, exp_rotation, log_rotation
from asterism.server.fusing.fleet import Fleet, View
from asterism.server.fusing.follow import Courses
from asterism.server.fusing.gather import Sight, Wanted
from asterism.server.fusing.sighting import Sighting
from asterism.server.fusing.solution import Solution, solutions
from asterism.server.pose.place import moved
from tests.fusing.drawn import SIGMA_PX, Seen, sighting
from tests.helpers import conic_centres
from tests.several import Drive, facing_pair, rigs_at

NOW = 1_000_000_000
MISFIT_M = 2e-4
PLACE = np.diag([0.3e-3] * 3 + [4e-4] * 3) ** 2


def seen_by_both(rng: np.random.Generator) -> tuple[Fleet, list[Sighting], Pose]:
    """Two cameras that are not quite where their rigs say, and a robot whose LEDs are not either."""
    fleet = Fleet.of([View(rig, PLACE) for rig in rigs_at(facing_pair(), 1)])
    poses, errors = Drive(("r00",))(1.0), {"r00": MISFIT_M * rng.normal(size=(6, 3))}
    found = []
    for view in fleet.views.values():
        place = moved(view.T_world_camera, np.sqrt(np.diag(PLACE)) * rng.normal(size=6))
        found.append(sighting(view, poses, NOW, rng, Seen(place, errors)))
    return fleet, found, poses["r00"]


def wanted_of(found: Sequence[Sighting], start: Pose) -> Wanted:
    """All of a robot's spots, which the sightings hold in the LEDs' order."""
    return Wanted("r00", {one.camera: np.arange(6) for one in found}, start, MISFIT_M)


def slow(fleet: Fleet, found: Sequence[Sighting], start: Pose) -> tuple[Pose, Floats]:
    """The pose and its covariance, with the cameras' places and all LEDs unknown as well."""
    robot = fleet.robots["r00"]
    places = np.sqrt(np.diag(PLACE))

    def off(x: Floats) -> Floats:
        pose = Pose.from_matrix(exp_rotation(x[3:6]) @ start.rotation, start.position + x[:3])
        leds, parts = x[6:24].reshape(6, 3), [x[6:24] / MISFIT_M]
        for k, one in enumerate(found):
            place = x[24 + 6 * k : 30 + 6 * k]
            T = moved(one.view.T_world_camera, place).inverse() @ pose
            shown = T.map(robot.leds + leds)
            T_plane = T @ robot.T_robot_plane
            middle = T_plane.map(robot.leds_plane)
            shift = conic_centres(T_plane, robot.leds_plane, robot.led_radius or 0.0) - middle[:, :2] / middle[:, 2:]
            pixels = one.view.rig.camera.project(np.column_stack([shown[:, :2] / shown[:, 2:] + shift, np.ones(6)]))
            parts += [((pixels - one.centres_px) / np.hypot(SIGMA_PX, 1e-3)).ravel(), place / places]
        return np.concatenate(parts)

    scale = np.concatenate([[1e-4] * 3, [1e-3] * 3, [MISFIT_M] * 18, np.tile(places, len(found))])
    best = least_squares(lambda x: off(x * scale), np.zeros(len(scale)), xtol=1e-14, ftol=1e-14, gtol=1e-12)
    x = best.x * scale
    covariance = np.linalg.inv(best.jac.T @ best.jac) * np.outer(scale, scale)
    return Pose.from_matrix(exp_rotation(x[3:6]) @ start.rotation, start.position + x[:3]), covariance[:6, :6]


def fast(fleet: Fleet, found: Sequence[Sighting], start: Pose) -> Solution:
    """The same by the compiled solution."""
    sight = Sight(fleet, found, NOW, Courses.unknown(len(fleet.robots)))
    (one,) = solutions([wanted_of(found, start)], sight)
    assert one is not None
    return one


def test_it_is_what_all_unknowns_together_give(rng: np.random.Generator) -> None:
    fleet, found, true = seen_by_both(rng)
    pose, covariance = slow(fleet, found, true)
    one = fast(fleet, found, true)
    sigmas = np.sqrt(np.diag(covariance))
    turn = log_rotation(one.pose.rotation @ pose.rotation.T)
    assert np.abs(np.concatenate([one.pose.position - pose.position, turn]) / sigmas).max() < 0.02
    assert np.abs((one.covariance - covariance) / np.outer(sigmas, sigmas)).max() < 0.03


@pytest.mark.parametrize("turned_rad", [0.02, 0.2])
def test_from_where_it_starts_does_not_matter(rng: np.random.Generator, turned_rad: float) -> None:
    fleet, found, true = seen_by_both(rng)
    one = fast(fleet, found, true)
    start = Pose.from_matrix(
        exp_rotation(np.array([turned_rad, -turned_rad, turned_rad])) @ true.rotation, true.position + 0.01
    )
    other = fast(fleet, found, start)
    sigmas = np.sqrt(np.diag(one.covariance))
    turn = log_rotation(one.pose.rotation @ other.pose.rotation.T)
    assert np.abs(np.concatenate([one.pose.position - other.pose.position, turn]) / sigmas).max() < 0.01
