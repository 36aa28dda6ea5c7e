"""How every robot stands on a surface that is fitted: how far off its point is, its play, how its axis leans."""

import math
from collections.abc import Sequence

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.protocol.surface_file import Stands
from asterism.server.calibration.surface.contacts import Contacts
from asterism.server.calibration.surface.fitting import Fitted
from asterism.server.calibration.surface.surface_fit import Stood
from asterism.server.calibration.surface.touches import Touches

LEAST_SIGMA_M = 1e-5
LEAST_TILT_RAD = math.radians(0.02)
LEANS = 4.0  # sigmas, from which on an axis is said to lean
NORMAL_MAD = 1.4826


def stood(
    contacts: Contacts, touches: Touches, fit: Fitted, axes: Sequence[Floats], normals: Floats
) -> tuple[Stood, ...]:
    """Of every robot; ``axes`` (r) of (3,), each in its robot's frame; ``normals`` (n, 3) in the world at all
    touches.
    """
    assert fit.covariance is not None
    offsets, covariance = offsets_of(touches, fit)
    out = []
    for k, robot in enumerate(contacts.ids):
        mine = fit.used & (contacts.robots == k)
        play = _excess(fit.residuals[mine], fit.variances[mine] / fit.noise.factors[k], fit.noise.stays)
        lean, axis, sway = _leaning(contacts[mine], normals[mine], axes[k], fit.noise.stays)
        sigma_m = math.sqrt(play[1] ** 2 + offsets[k] ** 2 + covariance[k, k] + LEAST_SIGMA_M**2)
        out.append(
            Stood(
                robot,
                int(contacts.frames[contacts.robots == k].sum()),
                int(contacts.frames[mine].sum()),
                float(offsets[k]),
                math.sqrt(max(covariance[k, k], 0.0)),
                play[0],
                lean,
                sway[0],
                Stands(contacts.names[k], axis, sigma_m, math.hypot(sway[1], LEAST_TILT_RAD)),
            )
        )
    return tuple(out)


def offsets_of(touches: Touches, fit: Fitted) -> tuple[Floats, Floats]:
    """How far every robot's point is off the mean of all, on average over its touches, by all its causes (r,) m, and
    the covariance (r, r) of that.
    """
    assert fit.covariance is not None
    r, k, p = touches.count, touches.causes, fit.shape.numbers
    mean = np.zeros((r, r * k))
    _, slopes = fit.heights(touches.xy)
    up = np.column_stack([-slopes, np.ones(len(touches))])
    moved = np.einsum("ni,nik->nk", up, touches.shared)
    for robot in range(r):
        mine = fit.used & (touches.robots == robot)
        if mine.any():
            mean[robot, robot * k : (robot + 1) * k] = [*moved[mine].mean(axis=0), 1.0]
    apart = (np.eye(r) - 1.0 / r) @ mean
    return apart @ fit.causes.ravel(), apart @ fit.covariance[p:, p:] @ apart.T


def _excess(values: Floats, told: Floats, stays: float) -> tuple[float, float]:
    """What values (n,) scatter beside the variances (n,) that are told of them, one sigma, 0 where these explain it;
    and the same as a person may rely on it, with what so many values leave open.
    """
    if len(values) < 2:
        return 0.0, 0.0
    own = float((NORMAL_MAD * np.median(np.abs(values - np.median(values)))) ** 2)
    expected = float(np.median(told))
    chance = expected * math.sqrt(2.0 * stays / len(values))
    excess = own - expected
    return math.sqrt(excess) if excess > 2.0 * chance else 0.0, math.sqrt(max(excess, 0.0) + chance)


def _leaning(
    contacts: Contacts, normals: Floats, axis: Floats, stays: float
) -> tuple[float, Floats, tuple[float, float]]:
    """By how much a robot's ``axis`` (3,) leans from the normal on average, rad; the one to be used, in its frame; and
    what it scatters about that, as `_excess`.
    """
    if len(contacts) < 2:
        return 0.0, axis, (0.0, 0.0)
    seen = np.einsum("nji,nj->ni", contacts.rotations, normals)  # in the robot's frame
    across = np.linalg.svd(axis[None])[2][1:]
    aside = seen @ across.T
    turned = np.swapaxes(contacts.rotations, 1, 2)
    spread = across @ turned @ contacts.axis_covariances @ contacts.rotations @ across.T
    told = np.einsum("nii->ni", spread)
    weights = 1.0 / told.mean(axis=1)
    mean = weights @ aside / weights.sum()
    sigma = math.sqrt(2.0 * stays / weights.sum())
    lean = float(np.linalg.norm(mean))
    if lean > max(LEANS * sigma, LEAST_TILT_RAD):
        axis = axis + mean @ across
        axis = axis / np.linalg.norm(axis)
    else:
        mean = np.zeros(2)
    return lean, axis, _excess((aside - mean).ravel(), told.ravel(), stays)
