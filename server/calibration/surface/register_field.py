"""Pose of a drawing and how the mould differs from it, jointly: what is off is noise, a pose, what robots are off in
all of their contacts, and a smooth field of which only is supposed how large and how wide its features are.

The field is a Gaussian process (Rasmussen and Williams, "Gaussian processes for machine learning", 2006; Matern's
kernel of 5/2), its size and width by the likelihood of the contacts with pose and robots integrated out (2.44 there).
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve, eigh
from scipy.spatial.distance import cdist

from asterism.protocol.geometry import Floats
from asterism.server.calibration.surface.register_units import Units

WIDTHS = (2.0, 0.2, 6)  # least, in patches; most, of the contacts' extent: wider would be the pose's; how many
SIZES = np.geomspace(1e-2, 1e3, 51)  # of the field over the noise that is typical
FAR = 0.1  # patches beside a place that count as much as the field's size by and large
ADAPTED = 6  # rounds
ALLOWED = 4.0  # of -2 log of the likelihood, two sigmas, by which a width may be less likely than the likeliest
NEAR = 0.4  # widths, over which the field's size is taken for the same
LEAST_TOLD = 0.05
LEAST_SIZE = 0.3  # of the field's size by and large
CHANCE = 3.0  # sigma of chi squared, beyond which the noise is larger than told


class Field(NamedTuple):
    """How a mould may differ: ``size_m``, one sigma along the normal, by and large; ``width_m``, over which it changes;
    how many times larger than told the contacts' ``noise`` is; and its ``sizes`` (u,) m near ``places`` (u, 3).
    """

    size_m: float
    width_m: float
    noise: float
    places: Floats
    sizes: Floats

    def at(self, places: Floats) -> Floats:
        """Its size (n,) m near places (n, 3); far from all that is known as large as by and large."""
        near = matern(cdist(places, self.places) / self.width_m)
        size2: Floats = (near @ self.sizes**2 + FAR * self.size_m**2) / (near.sum(axis=1) + FAR)
        return np.sqrt(size2)

    def between(self, a: Floats, b: Floats) -> Floats:
        """Covariance (n, m) m^2 of the field at places (n, 3) and (m, 3)."""
        return self.at(a)[:, None] * self.at(b) * matern(cdist(a, b) / self.width_m)


class Known(NamedTuple):
    """What is known beside contacts of six numbers of the pose, and of what robots share: ``information`` (q, q) and
    what it says, ``at`` (q,).
    """

    information: Floats
    at: Floats


class Joint(NamedTuple):
    """Pose and robots jointly: ``values`` (q,) with their ``covariance``; ``by`` (u, q) how patches depend on
    them; ``factor`` of the patches' covariance (noise and field), and the patches weighted by its inverse, less what
    values explain, ``weighted`` (u,); ``chi2`` of the whole, -2 log of the likelihood but for a constant.
    """

    values: Floats
    covariance: Floats
    by: Floats
    factor: tuple[Floats, bool]
    weighted: Floats
    chi2: float


def matern(over_width: Floats) -> Floats:
    """Correlation at distances in widths."""
    t = math.sqrt(5.0) * over_width
    correlation: Floats = (1.0 + t + t * t / 3.0) * np.exp(-t)
    return correlation


def by_all(units: Units) -> Floats:
    """How patches depend on pose and robots (u, q): the drawing moved out leaves less."""
    return np.concatenate([-units.by_pose, units.by_robots], axis=1)


def learned(units: Units, known: Known, like: Field | None = None) -> Field:
    """Size and width of the field that make what is off the likeliest, or those of one ``like`` it; adapted."""
    field = _likeliest(units, known) if like is None else like
    field = field._replace(places=units.places, sizes=field.at(units.places))
    for _ in range(ADAPTED):
        field = _adapted(units, field, known)
    return field


def _likeliest(units: Units, known: Known) -> Field:
    extent = float(np.linalg.norm(np.ptp(units.places, axis=0)))
    least, most, count = WIDTHS
    low = least * units.size_m
    widths = np.geomspace(low, max(most * extent, 2.0 * low), count)
    tried = [_sizes(units, known, width) for width in widths]
    likeliest = np.array([chi2.min() for chi2, _, _ in tried])
    best = int(np.argmax(likeliest < likeliest.min() + ALLOWED))  # the narrowest: a wide one flattens dents
    chi2, sizes, noises = tried[best]
    # The mean over what is likely and not the likeliest alone: that nothing was seen to differ is not that nothing may.
    likely = np.exp(-0.5 * (chi2 - chi2.min()))
    likely /= likely.sum()
    size = math.sqrt(float(likely @ sizes**2))
    return Field(size, float(widths[best]), float(likely @ noises), units.places, np.full(len(units.off), size))


def _adapted(units: Units, field: Field, known: Known) -> Field:
    """With its size where contacts were from what it is expected to be there: a mould that is as drawn but for a dent
    is known well beside the dent, and the dent is not flattened (a step of expectation and maximization; Tipping,
    "Sparse Bayesian learning", 2001, with neighbours taken together).
    """
    found = joint(units, field, known)
    mean, variance = posterior(units, field, found)
    near = matern(cdist(units.places, units.places) / (NEAR * field.width_m))
    told = np.clip(1.0 - variance / field.sizes**2, LEAST_TOLD, 1.0)
    sizes = np.sqrt(near @ mean**2 / (near @ told))
    return field._replace(sizes=np.maximum(sizes, LEAST_SIZE * field.size_m))


def posterior(units: Units, field: Field, found: Joint) -> tuple[Floats, Floats]:
    """The field (u,) m at the patches and its variance, m^2."""
    noise = field.noise**2 * units.variances
    inverse = cho_solve(found.factor, np.eye(len(noise)))
    by = found.by - noise[:, None] * (inverse @ found.by)
    variance = noise - noise**2 * np.diag(inverse) + np.einsum("ui,ij,uj->u", by, found.covariance, by)
    return units.off - found.by @ found.values - noise * found.weighted, variance


def _sizes(units: Units, known: Known, width: float) -> tuple[Floats, Floats, Floats]:
    """-2 log of the likelihood for every size of the field, those sizes in m, and the noise's factor for each."""
    typical = float(np.median(units.variances))
    root = 1.0 / np.sqrt(units.variances)
    values, vectors = eigh(matern(cdist(units.places, units.places) / width) * typical * np.outer(root, root))
    by, off = vectors.T @ (root[:, None] * by_all(units)), vectors.T @ (root * units.off)
    out = []
    freedom = max(len(off) - by.shape[1], 1)
    for size in SIZES:
        spread = 1.0 + size**2 * np.maximum(values, 0.0)
        normal = (by.T / spread) @ by + known.information
        toward = (by.T / spread) @ off + known.information @ known.at
        left = float(off**2 @ (1.0 / spread) + known.at @ known.information @ known.at)
        left -= float(toward @ np.linalg.solve(normal, toward))
        noise2 = left / freedom
        noise2 = noise2 if noise2 > 1.0 + CHANCE * math.sqrt(2.0 / freedom) else 1.0
        chi2 = np.log(spread).sum() + np.linalg.slogdet(normal)[1] + left / noise2 + freedom * math.log(noise2)
        out.append((chi2, size * math.sqrt(typical * noise2), math.sqrt(noise2)))
    chi2s, sizes, noises = np.array(out).T
    return chi2s, sizes, noises


def joint(units: Units, field: Field, known: Known) -> Joint:
    """Pose and robots by generalized least squares."""
    spread = field.between(units.places, units.places)
    spread[np.diag_indices_from(spread)] += field.noise**2 * units.variances
    factor = cho_factor(spread, lower=True)
    by = by_all(units)
    weighed = cho_solve(factor, np.column_stack([by, units.off]))
    normal = by.T @ weighed[:, :-1] + known.information
    covariance: Floats = np.asarray(np.linalg.inv(normal), np.float64)
    values: Floats = covariance @ (by.T @ weighed[:, -1] + known.information @ known.at)
    weighted: Floats = weighed[:, -1] - weighed[:, :-1] @ values
    away = values - known.at
    chi2 = float((units.off - by @ values) @ weighted + away @ known.information @ away)
    chi2 += 2.0 * float(np.log(np.diag(factor[0])).sum())
    return Joint(values, covariance, by, factor, weighted, chi2)


def field_at(places: Floats, units: Units, field: Field, found: Joint) -> Floats:
    """The field (n,) m, out of the material, at places (n, 3) m in the world."""
    at: Floats = field.between(places, units.places) @ found.weighted
    return at
