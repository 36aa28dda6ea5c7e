"""A drawing registered to touches of robots that drive on the mould: where it lies, how sure that is, what it leaves.

Found from nothing (`register_start`), fitted robustly (`register_fit`), then jointly with how the mould differs
(`register_field`), so that a dent neither draws the drawing aside nor makes it look surer than it is.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.surface import Heights
from asterism.server.calibration.surface.contacts import Contacts
from asterism.server.calibration.surface.register_fit import Fit, Prior, fitted
from asterism.server.calibration.surface.register_laid import Laid, settled
from asterism.server.calibration.surface.register_left import centre_of, extent_of, thinned
from asterism.server.calibration.surface.register_others import Other, others_of
from asterism.server.calibration.surface.register_start import starts

FRAME_SIGMA_M, FRAME_SIGMA_RAD = (
    0.02,
    math.radians(5.0),
)  # of a frame that a rig has for a drawing: measured with a tape
FEWEST = 30
STARTS, START_TOUCHES, FIT_TOUCHES = 12, 300, 3000
LEAST_INSIDE = 0.5  # of the touches
LARGEST_MISFIT_M = 2e-3  # most touches farther off than that: it is another drawing


class Placed(NamedTuple):
    """A drawing's heights, and the rig's own idea of where they lie, T_world_drawing, if it has one."""

    heights: Heights
    frame: Pose | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """The one of several drawings that fits, ``which``, where it lies, ``laid`` among the ``contacts``; ``prior`` is
    what was known before; ``others``: where it fits as well, or nearly.
    """

    drawing: Heights
    which: int
    laid: Laid
    contacts: Contacts
    prior: Prior
    others: tuple[Other, ...]

    @property
    def T_world_drawing(self) -> Pose:
        """Where it lies."""
        return self.laid.T_world_drawing

    @property
    def centre(self) -> Floats:
        """Of the drawing, in the world (3,) m."""
        return self.T_world_drawing.map(centre_of(self.drawing))

    @property
    def about_centre(self) -> Floats:
        """Covariance (6, 6) of the drawing's centre and of its turn about that, m and rad of the world's axes."""
        return self.laid.joint.covariance[:6, :6]

    @property
    def covariance(self) -> Floats:
        """Of T_world_drawing (6, 6): x, y, z, rotation about x, y, z of the world, m and rad."""
        x, y, z = self.T_world_drawing.rotation @ -centre_of(self.drawing)
        by = np.eye(6)
        by[:3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
        covariance: Floats = by @ self.about_centre @ by.T
        return covariance

    @property
    def rms_m(self) -> float:
        """Of touches that are used, above and below the drawing."""
        return float(np.sqrt((self.laid.left.off[self.laid.used] ** 2).mean()))


def register(
    drawings: Sequence[Placed], contacts: Contacts, used: NDArray[np.bool_], offset_m: float, name: str
) -> Registration:
    """Where the one of ``drawings`` lies that fits best: the same one as seen from several sides, the likeliest first.

    ``used`` (n,) touches may count; ``offset_m`` is one sigma of what each robot's point is off along the normal.
    Raises InputError, which calls the drawing ``name``, where it fits no place.
    """
    if used.sum() < FEWEST:
        raise InputError(f"{name}: {used.sum()} touches are to tell where it lies, expected {FEWEST} at least")
    few = thinned(contacts[used], START_TOUCHES)
    tried = [(k, fit) for k, placed in enumerate(drawings) for fit in _tried(placed, few)]
    which, best = min(tried, key=lambda one: (one[1].cost, one[0]))
    placed = drawings[which]
    prior = prior_of(placed, best.T_world_drawing)
    fit = fitted(placed.heights, thinned(contacts[used], FIT_TOUCHES), best.T_world_drawing, prior)
    _refuse_other(fit, name)
    laid = settled(placed.heights, contacts, used, (fit.T_world_drawing, prior), offset_m)
    rivals = [(k, drawings[k].heights, one) for k, one in tried]
    others = others_of((which, placed.heights, laid), rivals, contacts, prior)
    return Registration(placed.heights, which, laid, contacts, prior, others)


def _tried(placed: Placed, few: Contacts) -> list[Fit]:
    """Fits from all places where it may lie, and from that which the rig has."""
    poses = starts(placed.heights, few, STARTS).poses
    if placed.frame is None:
        return [fitted(placed.heights, few, pose, None) for pose in poses]
    prior = prior_of(placed, placed.frame)
    return [fitted(placed.heights, few, pose, prior) for pose in (placed.frame, *poses)]


def prior_of(placed: Placed, pose: Pose) -> Prior:
    """What is known of where a drawing lies: by the rig's frame, or that touches are somewhere on it."""
    if placed.frame is not None:
        sigmas = np.repeat([FRAME_SIGMA_M, FRAME_SIGMA_RAD], 3)
        return Prior(placed.frame, np.diag(sigmas**-2.0), True)
    low, high = extent_of(placed.heights)
    sigmas = np.repeat([0.5 * float(np.linalg.norm(high - low)), math.pi / math.sqrt(3.0)], 3)
    return Prior(pose, np.diag(sigmas**-2.0), False)


def _refuse_other(fit: Fit, name: str) -> None:
    """Raise InputError where the drawing is not that of what robots drove on."""
    share = float(fit.left.inside.mean())
    if share < LEAST_INSIDE:
        raise InputError(
            f"{name}: at best {share:.0%} of the touches are on it, expected {LEAST_INSIDE:.0%} at least: it is not "
            "what the robots drove on, or not in m (is it in mm?)"
        )
    if fit.misfit_m > LARGEST_MISFIT_M:
        raise InputError(
            f"{name}: at best most touches are {1e3 * fit.misfit_m:.2g} mm off it, expected {1e3 * LARGEST_MISFIT_M:g} "
            "mm at most: it is not what the robots drove on"
        )
