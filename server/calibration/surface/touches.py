"""Touches in the frame of a surface: heights over its x and y, and what of them noise, robots and causes may be."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from asterism.protocol.geometry import Floats, Pose
from asterism.server.calibration.surface.contacts import Contacts
from asterism.server.calibration.surface.shapes import Shape


@dataclass(frozen=True, slots=True, eq=False)
class Touches:
    """n touches of ``count`` robots: ``xy`` (n, 2) and ``z`` (n,) m, ``covariances`` (n, 3, 3) m^2, ``shared``
    (n, 3, k) m, all along the surface's axes; ``robots`` (n,), ``times_s`` (n,).
    """

    count: int
    robots: NDArray[np.int64]
    times_s: Floats
    xy: Floats
    z: Floats
    covariances: Floats
    shared: Floats

    @staticmethod
    def of(contacts: Contacts, T_world_surface: Pose) -> "Touches":
        """Those contacts."""
        turn = T_world_surface.rotation
        points = (contacts.points - T_world_surface.position) @ turn
        return Touches(
            len(contacts.ids),
            contacts.robots,
            contacts.times_s,
            points[:, :2],
            points[:, 2],
            turn.T @ contacts.covariances @ turn,
            turn.T @ contacts.shared,
        )

    def __len__(self) -> int:
        return len(self.z)

    def __getitem__(self, rows: "NDArray[np.bool_] | NDArray[np.int64]") -> "Touches":
        return Touches(self.count, *(getattr(self, name)[rows] for name in list(self.__dataclass_fields__)[1:]))

    @property
    def causes(self) -> int:
        """Of each robot: what its touches share, and its own offset."""
        return int(self.shared.shape[2]) + 1


@dataclass(frozen=True, slots=True, eq=False)
class Equations:
    """What n touches say of a shape's p numbers and of r robots' k causes: ``rows`` (n, p + r k), ``heights`` (n,) m
    over the shape's base, the ``variances`` (n,) m^2 of these by the touches' own noise. The last of a robot's causes
    is its offset, 1 m a unit; the others are of one sigma.
    """

    shape: Shape
    rows: csr_array
    heights: Floats
    variances: Floats

    @staticmethod
    def of(touches: Touches, shape: Shape, numbers: Floats | None) -> "Equations":
        """About a surface with those numbers (p,), None for a level one: by its slopes, what moves a touch aside moves
        it up.
        """
        by, by_x, by_y = shape.columns(touches.xy)
        base, slopes = shape.base(touches.xy)
        if numbers is not None:
            slopes = slopes + np.column_stack([by_x @ numbers, by_y @ numbers])
        up = np.column_stack([-slopes, np.ones(len(touches))])
        variances = np.einsum("ni,nij,nj->n", up, touches.covariances, up)
        causes = np.concatenate([np.einsum("ni,nik->nk", up, touches.shared), np.ones((len(touches), 1))], axis=1)
        k = touches.causes
        own = csr_array(
            (
                causes.ravel(),
                (touches.robots[:, None] * k + np.arange(k)).ravel(),
                np.arange(0, causes.size + 1, k),
            ),
            shape=(len(touches), touches.count * k),
        )
        return Equations(shape, _beside(by, own), touches.z - base, variances)


def _beside(a: csr_array, b: csr_array) -> csr_array:
    from scipy.sparse import hstack

    return csr_array(hstack([a, b], format="csr"))
