"""What a pose of a drawing leaves of touches: how far each is off, and how that changes as the drawing is moved."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats, Pose, exp_rotation, log_rotation
from asterism.protocol.surface import Heights, Surface
from asterism.server.calibration.surface.contacts import Contacts


class Left(NamedTuple):
    """What a pose of the drawing leaves of n touches: ``off`` (n,) m along the ``normals`` (n, 3) of the world, out of
    the material; its ``variances`` (n,) m^2; how it changes, ``by_pose`` (n, 6), as the drawing's centre is moved and
    it is turned about that, m and rad of the world, and with what a robot's touches share, ``by_causes`` (n, k);
    ``xy`` (n, 2) m, where in the drawing's frame they are; ``inside`` (n,) whether the drawing is there. What is not
    inside is 0.
    """

    off: Floats
    variances: Floats
    by_pose: Floats
    by_causes: Floats
    normals: Floats
    xy: Floats
    inside: NDArray[np.bool_]


def thinned(contacts: Contacts, most: int) -> Contacts:
    """At most so many of them, evenly."""
    n = len(contacts)
    return contacts if n <= most else contacts[np.linspace(0, n - 1, most).round().astype(np.int64)]


def extent_of(drawing: Heights) -> tuple[Floats, Floats]:
    """From where to where (2,) m a drawing is, in its own x and y."""
    there = np.argwhere(np.isfinite(drawing.values))
    return drawing.origin + drawing.step * there.min(axis=0), drawing.origin + drawing.step * there.max(axis=0)


def centre_of(drawing: Heights) -> Floats:
    """The middle (3,) m of a drawing, in its own frame: what it is moved and turned about."""
    low, high = extent_of(drawing)
    return np.array([*(0.5 * (low + high)), float(np.nanmean(drawing.values))])


def left_of(drawing: Heights, T_world_drawing: Pose, contacts: Contacts, *, exact: bool = True) -> Left:
    """What a pose leaves; ``exact``: to the nearest point, else along the drawing's z, shortened by its slope, which
    is the same near the surface and a tenth of the work.
    """
    if exact:
        touch = Surface(drawing, T_world_drawing).touch(contacts.points)
        off, normals, inside = touch.distances, touch.normals, touch.inside
        xy = T_world_drawing.inverse().map(touch.points)[:, :2]
    else:
        own = (contacts.points - T_world_drawing.position) @ T_world_drawing.rotation
        xy = own[:, :2]
        ground = Surface(drawing).ground(xy)
        up = ground.normals
        off, normals, inside = (own[:, 2] - ground.heights) * up[:, 2], up @ T_world_drawing.rotation.T, ground.inside
    off, normals, xy = np.where(inside, off, 0.0), np.where(inside[:, None], normals, 0.0), np.nan_to_num(xy)
    variances = np.einsum("ni,nij,nj->n", normals, contacts.covariances, normals)
    by_pose = -moves(normals, contacts.points - T_world_drawing.map(centre_of(drawing)))
    by_causes = np.einsum("ni,nik->nk", normals, contacts.shared)
    return Left(off, variances, by_pose, by_causes, normals, xy, inside)


def moves(normals: Floats, arms: Floats) -> Floats:
    """How far (n, 6) places at ``arms`` (n, 3) m from a centre go along normals (n, 3) as that is moved and turned."""
    return np.concatenate([normals, np.cross(arms, normals)], axis=1)


def moved(drawing: Heights, T_world_drawing: Pose, by: Floats) -> Pose:
    """The drawing with its centre moved and itself turned about that by (6,), m and rad of the world."""
    centre = centre_of(drawing)
    turn = exp_rotation(by[3:]) @ T_world_drawing.rotation
    return Pose.from_matrix(turn, T_world_drawing.map(centre) + by[:3] - turn @ centre)


def between(drawing: Heights, T_world_a: Pose, T_world_b: Pose) -> Floats:
    """What `moved` takes (6,) to bring the drawing from a to b."""
    centre = centre_of(drawing)
    turn = log_rotation(T_world_b.rotation @ T_world_a.rotation.T)
    return np.concatenate([T_world_b.map(centre) - T_world_a.map(centre), turn])
