"""How far robots' points are off each other, where they work on the same surface: what single robots' errors, such as a
tool that ends elsewhere, leave open of where the surface is.
"""

import numpy as np

from asterism.protocol.geometry import Floats

EXPECTED_M = 5e-5  # what a point of a robot is off, before anything is known
TRIED_M = np.concatenate([[0.0], np.geomspace(1e-6, 1e-2, 80)])


def spread_of(offsets: Floats, covariance: Floats) -> float:
    """One sigma, m, of what robots' offsets (r,) truly are, by how far they differ beside their ``covariance`` (r, r):
    the mean of what it may be. Of one robot there is nothing to tell it by.

    Source: Gelman, "Prior distributions for variance parameters in hierarchical models", 2006: half a Cauchy before.
    """
    count = len(offsets)
    if count < 2:
        return EXPECTED_M
    apart = np.linalg.svd(np.ones((1, count)))[2][1:]  # differences only: all of them together is the surface
    differences, noise = apart @ offsets, apart @ covariance @ apart.T
    values, vectors = np.linalg.eigh(noise)
    squared = (vectors.T @ differences) ** 2
    variances = np.maximum(values, 0.0) + TRIED_M[:, None] ** 2 + 1e-16
    likelihood = -0.5 * (np.log(variances) + squared / variances).sum(axis=1)
    density = np.exp(likelihood - likelihood.max()) / (1.0 + (TRIED_M / EXPECTED_M) ** 2)
    weights = density * np.gradient(TRIED_M)
    return float(weights @ TRIED_M / weights.sum())
