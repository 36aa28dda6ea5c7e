"""Where else a drawing fits: a mould that looks the same turned, or seen from another side.

Places are compared by the likelihood of touches with how the mould may differ from its drawing, so that what a mould
differs by anyhow does not decide.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from asterism.protocol.geometry import Pose
from asterism.protocol.surface import Heights
from asterism.server.calibration.surface.contacts import Contacts
from asterism.server.calibration.surface.register_fit import Fit, Prior
from asterism.server.calibration.surface.register_laid import Laid
from asterism.server.calibration.surface.register_left import between, left_of, thinned

TOUCHES = 400
UNLIKELY = 1e4  # times less likely, from which on it need not be said
APART = 25.0  # squared sigmas between two places, by what touches tell
BEYOND = 9.0  # what a touch beyond the drawing costs
BESIDE = 1e-3  # m, and rad: two that are nearer are one


class Other(NamedTuple):
    """Another place of the drawing (of which of those given, its number): how many times less likely it is, ``odds``,
    1 and less for more likely.
    """

    which: int
    T_world_drawing: Pose
    odds: float


def others_of(
    best: tuple[int, Heights, Laid], rivals: Sequence[tuple[int, Heights, Fit]], contacts: Contacts, prior: Prior
) -> tuple[Other, ...]:
    """Those of the ``rivals`` that are another place than the best and nearly as likely, the likeliest first."""
    which, drawing, laid = best
    some = thinned(contacts[laid.used], TOUCHES)
    least = _chi2(drawing, laid.T_world_drawing, some, laid, prior)
    # Rivals rest on few touches, and are as far from the best as these tell: that is measured from the best of them.
    ranked = sorted(rivals, key=lambda rival: rival[2].cost)
    share = min(1.0, len(ranked[0][2].left.off) / int(laid.used.sum()))
    told = share * (np.linalg.inv(laid.joint.covariance[:6, :6]) - prior.information)
    first = next(fit.T_world_drawing for k, _, fit in ranked if k == which)
    found: list[Other] = []
    for k, heights, fit in ranked:
        away = between(drawing, first, fit.T_world_drawing)
        same = k == which and (away @ told @ away < APART or np.abs(away).max() < BESIDE)
        if same or any(k == one.which and _beside(heights, one.T_world_drawing, fit.T_world_drawing) for one in found):
            continue
        more = _chi2(heights, fit.T_world_drawing, some, laid, prior if k == which else None) - least
        if more < 2.0 * math.log(UNLIKELY):
            found.append(Other(k, fit.T_world_drawing, math.exp(0.5 * max(more, -100.0))))
    return tuple(sorted(found, key=lambda one: one.odds))


def _beside(drawing: Heights, T_world_a: Pose, T_world_b: Pose) -> bool:
    return bool(np.abs(between(drawing, T_world_a, T_world_b)).max() < 10.0 * BESIDE)


def _chi2(drawing: Heights, pose: Pose, some: Contacts, laid: Laid, prior: Prior | None) -> float:
    """-2 log of the likelihood of touches, but for a constant, with the pose free to move a little; a touch beyond the
    drawing is as unlikely as one that is far off.
    """
    left = left_of(drawing, pose, some, exact=False)
    inside = left.inside
    if inside.sum() < 7:
        return math.inf
    spread = laid.field.between(some.points[inside], some.points[inside])
    spread[np.diag_indices_from(spread)] += laid.field.noise**2 * left.variances[inside]
    factor = cho_factor(spread, lower=True)
    weighed = cho_solve(factor, np.column_stack([left.by_pose[inside], left.off[inside]]))
    normal, toward = left.by_pose[inside].T @ weighed[:, :-1], left.by_pose[inside].T @ weighed[:, -1]
    before = 0.0
    if prior is not None:
        at = prior.at(drawing, pose)
        normal, toward = normal + prior.information, toward - prior.information @ at
        before = float(at @ prior.information @ at)
    step = np.linalg.lstsq(normal, toward, rcond=1e-9)[0]
    return float(left.off[inside] @ weighed[:, -1] - toward @ step) + before + BEYOND * float((~inside).sum())
