"""A surface as triangles, to be drawn: a grid over its x and y, cut off where the surface ends."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig
from asterism.protocol.surface import Heights, Surface

Ints = NDArray[np.int64]
Box = tuple[Floats, Floats]  # least and greatest x, y of the surface's frame, m

NODES = 128  # along the longer side
SEEN_NODES = 64
SEEN = 1.5  # of the farthest working distance: a surface without an end of its own is drawn as far as that
_HALVINGS = 16  # of a grid's step, to where the surface ends


class Mesh(NamedTuple):
    """``points`` and ``normals`` (n, 3) in the world, m; one sigma of the height at each, ``sigmas`` (n,) m;
    ``triangles`` (m, 3), anticlockwise seen from outside the material; the sides of them where the surface ends,
    ``edge`` (k, 2, 3) m.
    """

    points: Floats
    normals: Floats
    sigmas: Floats
    triangles: Ints
    edge: Floats


def surface_mesh(rig: Rig, nodes: int = NODES) -> Mesh | None:
    """The surface of a rig, None where it has none or nothing is left of it within its edge."""
    if rig.surface is None:
        return None
    mesh = mesh_of(rig.surface, box_of(rig.surface, rig), nodes)
    if not len(mesh.triangles):
        return None
    return mesh if ends(rig.surface) else mesh._replace(edge=mesh.edge[:0])


def ends(surface: Surface) -> bool:
    """Whether it has an end of its own: an edge, or that of a grid."""
    return len(surface.edge) > 0 or isinstance(surface.shape, Heights)


def mesh_of(surface: Surface, box: Box, nodes: int = NODES) -> Mesh:
    """The part of a surface that lies within a box, drawn by squares; where it ends their sides are cut there.

    Source: Lorensen, Cline: "Marching cubes", 1987, in two dimensions.
    """
    xy, inside = _grid(surface, box, nodes)
    counts = inside.shape
    place = np.arange(inside.size).reshape(counts)
    # Sides of squares along x, then along y: from a node to the next.
    starts = np.concatenate([place[:-1].ravel(), place[:, :-1].ravel()])
    ends = np.concatenate([place[1:].ravel(), place[:, 1:].ravel()])
    cut = inside.ravel()[starts] != inside.ravel()[ends]
    crossings = _where_it_ends(surface, xy[starts[cut]], xy[ends[cut]], inside.ravel()[starts[cut]])
    crossing = np.full(len(starts), -1)
    crossing[cut] = inside.size + np.arange(cut.sum())
    node = np.where(inside, place, -1)
    triangles = _triangles(node, crossing)
    used, triangles = np.unique(triangles, return_inverse=True)
    return _meshed(surface, np.concatenate([xy, crossings])[used], triangles.reshape(-1, 3))


def _grid(surface: Surface, box: Box, nodes: int) -> tuple[Floats, NDArray[np.bool_]]:
    """Nodes (nx * ny, 2) and which of them are on the surface (nx, ny); squares, as nearly as they fit."""
    least, greatest = box
    size = greatest - least
    counts = np.maximum(np.ceil(size / (size.max() / (nodes - 1)) - 1e-9).astype(int), 1) + 1
    axes = [np.linspace(a, b, n) for a, b, n in zip(least, greatest, counts, strict=True)]
    xy = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    return xy, surface.ground(xy).inside.reshape(counts)


def _where_it_ends(surface: Surface, starts: Floats, ends: Floats, start_inside: NDArray[np.bool_]) -> Floats:
    """The last places (n, 2) that are inside on the way between places of which one is."""
    inner = np.where(start_inside[:, None], starts, ends)
    outer = np.where(start_inside[:, None], ends, starts)
    for _ in range(_HALVINGS):
        middle = 0.5 * (inner + outer)
        inside = surface.ground(middle).inside[:, None]
        inner, outer = np.where(inside, middle, inner), np.where(inside, outer, middle)
    return inner


def _triangles(node: Ints, crossing: Ints) -> Ints:
    """Of every square what lies inside, as a fan (m, 3) of its corners and of where its sides are cut; -1 is none."""
    nx, ny = node.shape
    along_x, along_y = np.split(crossing, [(nx - 1) * ny])
    along_x, along_y = along_x.reshape(nx - 1, ny), along_y.reshape(nx, ny - 1)
    around = [
        node[:-1, :-1], along_x[:, :-1], node[1:, :-1], along_y[1:], node[1:, 1:], along_x[:, 1:], node[:-1, 1:],
        along_y[:-1],
    ]  # fmt: skip
    corners = np.stack([each.ravel() for each in around], axis=1)
    corners = np.take_along_axis(corners, np.argsort(corners < 0, axis=1, kind="stable"), axis=1)
    fans = [np.stack([corners[:, 0], corners[:, k], corners[:, k + 1]], axis=1) for k in range(1, 7)]
    fan = np.concatenate(fans)
    return fan[fan[:, 2] >= 0]


def _meshed(surface: Surface, xy: Floats, triangles: Ints) -> Mesh:
    ground = surface.ground(xy)
    place = surface.T_world_surface
    points = place.map(np.column_stack([xy, ground.heights]))
    sides = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    _, first, count = np.unique(np.sort(sides, axis=1), axis=0, return_index=True, return_counts=True)
    edge = points[sides[np.sort(first[count == 1])]]
    return Mesh(points, ground.normals @ place.rotation.T, ground.sigmas, triangles, edge)


def box_of(surface: Surface, rig: Rig) -> Box:
    """All of a rig's surface, or where it has no end of its own, as far as the camera sees it."""
    if len(surface.edge):
        return surface.edge.min(axis=0), surface.edge.max(axis=0)
    if isinstance(surface.shape, Heights):
        last = np.array(surface.shape.values.shape) - 1
        return surface.shape.origin, surface.shape.origin + surface.shape.step * last
    return _seen(rig, surface)


def _seen(rig: Rig, surface: Surface) -> Box:
    """What the camera sees of a surface; where it sees nothing, what is around the place below it."""
    camera, far = rig.camera, SEEN * (rig.range_m or (1.0, 1.5))[1]
    T_surface_camera = surface.T_world_surface.inverse() @ (rig.T_world_camera or Pose.identity())
    below = T_surface_camera.position[:2]
    square = below - far, below + far
    xy, inside = _grid(surface, square, SEEN_NODES)
    at = T_surface_camera.inverse().map(np.column_stack([xy, surface.ground(xy).heights]))
    size = np.array([camera.width, camera.height])
    near = inside.ravel() & (at[:, 2] > 0.0) & (np.linalg.norm(at, axis=1) < far)
    with np.errstate(all="ignore"):
        pixels = camera.project(at)
        # A lens's polynomial may turn back, and bring what is far outside into the image again.
        straight = at[:, :2] / at[:, 2:] * camera.focal_px + camera.matrix[:2, 2]
        seen = near & ((pixels >= 0) & (pixels < size) & (straight >= -size) & (straight < 2 * size)).all(axis=1)
    if not seen.any():
        return square
    step = 2.0 * far / (SEEN_NODES - 1)
    return xy[seen].min(axis=0) - step, xy[seen].max(axis=0) + step
