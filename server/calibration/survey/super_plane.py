"""The super-plane: what is left of Z's error after all physics, as a plane or quadric (`protocol.z_correction`).

Weighted least squares of z_true - z_found as a share of Z. Errors of the lens, of the scale and of LED positions make
shares that depend on the place in the image, hardly on the distance; hence the quadric is one in the image's place.
Which of both, or none, is decided by leaving out one slab of Z after the other: a function that only follows its own
data fails there. Weights are the poses' own variances and a misfit, found such that the residuals are as large as they
should be.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from asterism.protocol.geometry import Floats
from asterism.protocol.z_correction import KINDS, ZCorrection, features, inverse_places

SLABS = 5
LEAST_GAIN = 0.10  # of the error, by which a correction must better leaving Z alone, held out
SIMPLER = 0.05  # what the quadric must gain over the plane
FEWEST = {"plane": 20, "quadric": 30}  # poses
CAP = 1.5  # times the largest correction of a surveyed pose
RIDGE = 1e-6
LEAST_SCALE = 1e-3
ROUNDS = 8


@dataclass(frozen=True, slots=True, eq=False)
class SuperPlane:
    """``correction`` is None where nothing gains enough. ``scores``: held-out RMS of Z's error as a share of the
    distance, by kind, `none` among them; ``rms_m`` the same in m.
    """

    correction: ZCorrection | None
    scores: dict[str, float]
    rms_m: dict[str, float]


def choose_plane(places: Floats, errors: Floats, variances: Floats) -> SuperPlane:
    """The correction for poses at ``places`` (n, 3), camera's frame, m, whose true z is ``errors`` (n,) m more, with
    ``variances`` (n,) m^2 of their z.
    """
    scores, rms = {}, {}
    for kind in ("none", *KINDS):
        if kind != "none" and len(places) < FEWEST[kind]:
            continue
        left = held_out(kind, places, errors, variances)
        scores[kind] = float(np.sqrt(((left / places[:, 2]) ** 2).mean()))
        rms[kind] = float(np.sqrt((left**2).mean()))
    best = "none"
    if scores.get("plane", np.inf) < (1.0 - LEAST_GAIN) * scores["none"]:
        best = "plane"
    needed = (1.0 - LEAST_GAIN) * scores["none"] if best == "none" else (1.0 - SIMPLER) * scores["plane"]
    if scores.get("quadric", np.inf) < needed:
        best = "quadric"
    correction = None if best == "none" else fit_plane(best, places, errors, variances)
    return SuperPlane(correction, scores, rms)


def held_out(kind: str, places: Floats, errors: Floats, variances: Floats) -> Floats:
    """Errors (n,) m that are left of every slab of Z when the function is fitted to the others."""
    left = errors.copy()
    if kind == "none":
        return left
    for slab in np.array_split(np.argsort(places[:, 2], kind="stable"), SLABS):
        others = np.ones(len(places), np.bool_)
        others[slab] = False
        found = fit_plane(kind, places[others], errors[others], variances[others])
        left[slab] -= places[slab, 2] * (_features(found, places[slab]) @ found.coefficients)
    return left


def fit_plane(kind: str, places: Floats, errors: Floats, variances: Floats) -> ZCorrection:
    """A plane or quadric, whether it gains or not; arguments as for `choose_plane`."""
    z = places[:, 2]
    q = inverse_places(places)
    low, high = q.min(axis=0), q.max(axis=0)
    centre, scale = 0.5 * (low + high), np.maximum(0.5 * (high - low), LEAST_SCALE)
    phi = features(kind, (q - centre) / scale)
    shares, noise = errors / z, variances / z**2
    freedom = max(len(places) - phi.shape[1], 1)
    misfit = 0.0
    for _ in range(ROUNDS):
        weights = 1.0 / (noise + misfit**2)
        normal = phi.T @ (weights[:, None] * phi)
        ridge = RIDGE * np.trace(normal) / len(normal) * np.eye(len(normal))
        ridge[0, 0] = 0.0
        coefficients = np.linalg.solve(normal + ridge, phi.T @ (weights * shares))
        misfit = _misfit(shares - phi @ coefficients, noise, freedom)
    spread = np.linalg.cholesky(np.linalg.inv(normal + ridge))
    deviations2 = ((phi @ spread) ** 2).sum(axis=1)
    # As uncertain as the most remote surveyed pose is to a fit without it.
    remote = np.sqrt(deviations2 / np.maximum(1.0 - weights * deviations2, 0.1)).max()
    most = CAP * float(np.abs(phi @ coefficients).max())
    return ZCorrection(kind, centre, scale, coefficients, spread, float(remote), most, misfit)


def _features(correction: ZCorrection, places: Floats) -> Floats:
    return features(correction.kind, (inverse_places(places) - correction.centre) / correction.scale)


def _misfit(left: Floats, noise: Floats, freedom: int) -> float:
    """One sigma with which the squared residuals (n,) are ``freedom`` sigmas; 0 if they are without."""

    def surplus(sigma: float) -> float:
        return float((left**2 / (noise + sigma**2)).sum()) - freedom

    if surplus(0.0) <= 0.0:
        return 0.0
    return float(brentq(surplus, 0.0, 10.0 * float(np.abs(left).max()), rtol=1e-6))
