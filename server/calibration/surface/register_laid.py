"""A drawing that lies nearly right laid where it fits best, jointly with how the mould differs from it."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.spatial import cKDTree

from asterism.protocol.geometry import Pose
from asterism.protocol.surface import Heights
from asterism.server.calibration.surface.contacts import Contacts
from asterism.server.calibration.surface.register_field import Field, Joint, Known, field_at, joint, learned
from asterism.server.calibration.surface.register_fit import MEDIAN, Prior
from asterism.server.calibration.surface.register_left import Left, left_of, moved
from asterism.server.calibration.surface.register_units import Units, by_robots, units_of

FAR = 4.0  # sigmas from the mould as it is found, beyond which a touch is none
AROUND = 12  # touches, whose middle one is believed before anything else is known
ROUNDS = 5
SETTLED = 0.02  # sigmas that the pose still moves by


class Laid(NamedTuple):
    """Where a drawing lies, T_world_drawing, and what that leaves: ``used`` (n,) touches count; ``units``, ``field``
    and ``joint`` are how the mould differs.
    """

    T_world_drawing: Pose
    used: NDArray[np.bool_]
    left: Left
    units: Units
    field: Field
    joint: Joint


def settled(
    drawing: Heights, contacts: Contacts, may: NDArray[np.bool_], start: tuple[Pose, Prior], offset_m: float
) -> Laid:
    """The drawing where it fits best, from a pose near by, with what is known of it; ``may`` (n,): which touches may
    count; ``offset_m``: one sigma of what each robot's point is off along the normal.
    """
    pose, prior = start
    near = _agreeing(left_of(drawing, pose, contacts), may)
    field = None
    for _ in range(ROUNDS):
        laid = _laid(drawing, contacts, may & near, (pose, prior), offset_m, field)
        field = laid.field
        step, sigmas = laid.joint.values[:6], np.sqrt(np.diag(laid.joint.covariance)[:6])
        now = _near(laid, contacts)
        done = bool((now == near).all()) and bool((np.abs(step) < SETTLED * sigmas).all())
        if done:
            break
        pose, near = moved(drawing, pose, step), now
    return laid


def _laid(
    drawing: Heights, contacts: Contacts, may: NDArray[np.bool_], at: tuple[Pose, Prior], offset_m: float,
    like: Field | None,
) -> Laid:  # fmt: skip
    pose, prior = at
    left = left_of(drawing, pose, contacts)
    used = may & left.inside
    units = units_of(left, contacts, used)
    own = np.ones((len(contacts.ids), contacts.shared.shape[2] + 1))
    own[:, -1] = offset_m**-2
    robots = own.ravel()
    known = Known(
        block_diag(prior.information, np.diag(robots)), np.concatenate([prior.at(drawing, pose), 0.0 * robots])
    )
    field = learned(units, known, like)
    return Laid(pose, used, left, units, field, joint(units, field, known))


def _agreeing(left: Left, may: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which touches (n,) those around them do not contradict: lifted robots are alone, a dent is there for all."""
    near = may & left.inside
    rows = np.flatnonzero(near)
    if len(rows) > AROUND:
        around = cKDTree(left.xy[rows]).query(left.xy[rows], AROUND)[1]
        told = np.median(left.off[rows][around], axis=1)
        spread = MEDIAN * np.median(np.abs(left.off[rows] - told))
        near[rows] = np.abs(left.off[rows] - told) < FAR * np.hypot(spread, np.sqrt(left.variances[rows]))
    return near


def _near(laid: Laid, contacts: Contacts) -> NDArray[np.bool_]:
    """Which touches (n,) are where the mould is."""
    left = laid.left
    told = np.concatenate([-left.by_pose, by_robots(left, contacts)], axis=1) @ laid.joint.values
    told += field_at(contacts.points, laid.units, laid.field, laid.joint)
    near: NDArray[np.bool_] = np.abs(left.off - told) < FAR * laid.field.noise * np.sqrt(left.variances)
    return near | ~left.inside
