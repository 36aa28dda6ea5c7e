"""The rig's `z_correction`: a plane or quadric that is added to the camera's Z of every pose.

Everything is in the camera's frame and relative: a share of Z, by the place in the image and by 1 / Z. Where the
surveyed poses it was fitted to do not reach, it fades to nothing, and says so.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats, frozen_array
from asterism.protocol.yaml_file import Section

KINDS = {"plane": 4, "quadric": 7}  # and how many coefficients they have


@dataclass(frozen=True, slots=True, eq=False)
class Corrected:
    """What is to be added to n poses: ``dz`` (n,) m along the camera's z, ``variances`` (n,) m^2 of that, and where
    it was ``extrapolated`` (n,): faded or cut off, since no surveyed pose is near.
    """

    dz: Floats
    variances: Floats
    extrapolated: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class ZCorrection:
    """dz = Z beta . phi of the robot's place (X, Y, Z), m; with q = (X / Z, Y / Z, 1 / Z) and n = (q - centre) / scale,
    phi = (1, n) for a plane, for dz is one over X, Y, Z; a quadric has (n_x^2, n_x n_y, n_y^2) beside.

    ``coefficients`` (k,) are beta; ``spread`` (k, k) is the lower Cholesky factor of their covariance. ``region`` is
    the largest standard deviation that beta . phi has at a surveyed pose, that pose left out: where it is larger, the
    correction fades, to nothing where it is twice that. ``most`` caps |beta . phi|. ``misfit`` is what surveyed poses
    still disagree beyond the noise of their spots, one sigma. All are shares of Z.
    """

    kind: str
    centre: Floats
    scale: Floats
    coefficients: Floats
    spread: Floats
    region: float
    most: float
    misfit: float

    def __post_init__(self) -> None:
        count = KINDS[self.kind]
        for name, shape in (("centre", (3,)), ("scale", (3,)), ("coefficients", (count,)), ("spread", (count, count))):
            object.__setattr__(self, name, frozen_array(getattr(self, name), *shape))

    def at(self, places: Floats) -> Corrected:
        """What to add to poses at ``places`` (n, 3), camera's frame, m, in front of the camera.

        The variance is that of the fit and of its misfit, and where the correction is faded or capped, the square of
        what is kept back.
        """
        z = places[:, 2]
        phi = features(self.kind, (inverse_places(places) - self.centre) / self.scale)
        whole = phi @ self.coefficients
        variances = ((phi @ self.spread) ** 2).sum(axis=1)
        fade = np.clip(2.0 - np.sqrt(variances) / self.region, 0.0, 1.0)
        share = fade * np.clip(whole, -self.most, self.most)
        # Where survey and cap keep some back, nothing is known but that it may be as large as the cap.
        kept_back = np.minimum(np.abs(whole - share), self.most)
        shares = fade**2 * variances + kept_back**2 + self.misfit**2
        return Corrected(z * share, z**2 * shares, (fade < 1.0) | (np.abs(whole) > self.most))


def inverse_places(places: Floats) -> Floats:
    """q (n, 3) = (X / Z, Y / Z, 1 / Z) of places (n, 3)."""
    return np.column_stack([places[:, :2], np.ones(len(places))]) / places[:, 2:]


def features(kind: str, n: Floats) -> Floats:
    """phi (n, 4 or 7) of normalised q (n, 3), as in `ZCorrection`."""
    x, y, _ = n.T
    columns = [np.ones(len(n)), *n.T]
    if kind == "quadric":
        columns += [x * x, x * y, y * y]
    return np.column_stack(columns)


def read_correction(section: Section) -> ZCorrection:
    """The rig's `z_correction`. Raises InputError with key, what was found and what is accepted."""
    section.only(("kind", "centre", "scale", "coefficients", "spread", "region", "most", "misfit"))
    kind = section.text("kind", tuple(KINDS))
    count = KINDS[kind]
    scale = np.array(section.numbers("scale", 3, "above 0"))
    if not (scale > 0.0).all():
        raise section.error("scale", f"{scale.tolist()}, expected three numbers above 0")
    coefficients = np.array(section.numbers("coefficients", count, f"of a {kind}"))
    rows = section.rows("spread", count, f"{count} rows, the Cholesky factor of the coefficients' covariance")
    if len(rows) != count:
        raise section.error("spread", f"{len(rows)} rows, expected {count} for a {kind}")
    return ZCorrection(
        kind,
        np.array(section.numbers("centre", 3, "of X / Z, Y / Z, 1 / Z")),
        scale,
        coefficients,
        np.array(rows),
        section.number("region", above=0.0),
        section.number("most", above=0.0),
        section.number("misfit", least=0.0),
    )
