"""How robots stand on the rig's surface in a frame: solved again with it, and told (`pose.standing`)."""

import math
from typing import NamedTuple

import numpy as np

from asterism.protocol.geometry import Floats, Pose
from asterism.server.identity.plan import Plan
from asterism.server.pose.choose import Choices
from asterism.server.pose.matched import Matched, Measured
from asterism.server.pose.place import Place
from asterism.server.pose.solve import Alternative, OnSurface, Solutions
from asterism.server.pose.standing import stand_robots
from asterism.server.pose.stood import BEYOND, LIFTED, ON_SURFACE, SUNK, TILTED, Alone, Stood
from asterism.server.pose.track import Tracks

NAMES = {ON_SURFACE: "ON_SURFACE", LIFTED: "LIFTED", SUNK: "SUNK", TILTED: "TILTED", BEYOND: "BEYOND"}
NO_SURFACE = "there is no surface under it: beyond its edge, over a hole in it, or where its heights end"


class Seen(NamedTuple):
    """What the spots of m robots said: as they were ``measured``, the covariances ``commons`` (m, 3) of rays that they
    share, and what else is not known of the poses, ``terms`` (m, 6, 6), of the planes and in the camera's frame.
    """

    measured: Measured
    commons: Floats
    terms: Floats


def stand(
    plan: Plan, found: Matched, seen: Seen, solutions: Solutions, choices: Choices, exposed_ns: int,
    before: Tracks, known: Tracks,
) -> Stood | None:  # fmt: skip
    """How the robots stand; None where nobody does by the rig. Writes the tracks ``known``; ``before`` are those of the
    frame before.
    """
    if plan.underfoot is None:
        return None
    stood = Stood.room(len(found.robots))
    moves, variances = _correction(plan, choices)
    terms = seen.terms
    if variances is not None:
        terms = terms.copy()
        terms[:, 2, 2] += variances
    alone = Alone(plan.lens, plan.constellations, seen.measured, solutions, choices, seen.commons, terms, moves)
    stand_robots(found, alone, plan.underfoot, plan.mounts, exposed_ns, before.seen_ns, known.offs, stood)
    return stood


def _correction(plan: Plan, choices: Choices) -> tuple[Floats, Floats | None]:
    """What the rig's correction of the camera's Z adds to light's poses (m, 3) m, and its variances (m,)."""
    correction, moves = plan.rig.z_correction, np.zeros((len(choices.best), 3))
    if correction is None or not len(moves):
        return moves, None
    positions = np.where(choices.best[:, None] >= 0, choices.positions[:, 0], plan.mounts.camera_origin)
    found = correction.at((positions - plan.mounts.camera_origin) @ plan.mounts.camera_rotation)
    moves[:, 2] = found.dz
    return moves, found.variances


def of_place(place: Place, solutions: Solutions, choices: Choices) -> Floats:
    """What is not known of the poses (m, 6, 6) because of where the camera is, in its own axes."""
    best = np.maximum(choices.best, 0)
    ts = np.nan_to_num(solutions.ts[np.arange(len(best)), best])
    both = np.kron(np.eye(2), place.T_world_camera.rotation.T)
    own = both @ place.covariance @ both.T
    by_place = np.tile(np.eye(6), (len(ts), 1, 1))
    x, y, z = ts.T
    by_place[:, 0, 4], by_place[:, 0, 5] = z, -y
    by_place[:, 1, 3], by_place[:, 1, 5] = -z, x
    by_place[:, 2, 3], by_place[:, 2, 4] = y, -x
    told: Floats = by_place @ own @ np.swapaxes(by_place, 1, 2)
    return told


def told_of(
    plan: Plan, robot: int, row: int, stood: Stood, without: tuple[Pose, Floats, Alternative | None]
) -> OnSurface | None:
    """How a robot of the rig stands, from its row; ``without`` is what light alone says of it."""
    standing = int(stood.standing[row])
    if standing not in NAMES:
        return None
    off, off_sigma, tilt, tilt_sigma = stood.offs[row].tolist()
    if standing == ON_SURFACE:
        return OnSurface(NAMES[standing], "", off, off_sigma, tilt, tilt_sigma, *without, stood.by_spots[row])
    return OnSurface(NAMES[standing], _reason(plan, robot, standing, stood.offs[row]), off, off_sigma, tilt, tilt_sigma)


def _reason(plan: Plan, robot: int, standing: int, offs: Floats) -> str:
    """Why the surface was not used, and what a person can do."""
    stands = plan.rig.robots[robot].stands
    assert stands is not None
    off, off_sigma, tilt, tilt_sigma = offs.tolist()
    if standing == BEYOND:
        return NO_SURFACE
    if standing == TILTED:
        return (
            f"its axis is {math.degrees(tilt):.2f}° off the surface's normal (sigma {math.degrees(tilt_sigma):.2f}°): "
            "set it upright, or correct `stands: axis`"
        )
    where = "above" if standing == LIFTED else "below"
    what = "set it down" if standing == LIFTED else "correct where the rig has that point"
    return (
        f"its point '{stands.point}' is {abs(off) * 1e3:.2f} mm {where} the surface (sigma {off_sigma * 1e3:.2f} mm): "
        f"{what}, or measure the surface: asterism calibrate surface"
    )
