"""A block whose top is a grid of heights, as a binary STL, which drawings of moulds come as."""

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.protocol.surface import Heights

_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")])


def block_stl(top: Heights, bottom: float) -> bytes:
    """The block between the nodes of ``top``, which are all there, and z = ``bottom``, in m; its normals point out."""
    nx, ny = top.values.shape
    x, y = (top.origin[axis] + top.step[axis] * np.arange(n) for axis, n in ((0, nx), (1, ny)))
    upper = np.stack([*np.meshgrid(x, y, indexing="ij"), top.values], axis=-1)
    lower = np.stack([*np.meshgrid(x, y, indexing="ij"), np.full((nx, ny), bottom)], axis=-1)
    sheets = [upper, lower[::-1], *_walls(upper, lower)]
    return _binary(np.concatenate([_triangles(sheet) for sheet in sheets]))


def _walls(upper: Floats, lower: Floats) -> list[Floats]:
    """Four sheets (n, 2, 3) from the bottom's border to the top's."""
    borders = [
        (upper[:, 0], lower[:, 0]),
        (upper[-1], lower[-1]),
        (upper[::-1, -1], lower[::-1, -1]),
        (upper[0, ::-1], lower[0, ::-1]),
    ]
    return [np.stack([below, above], axis=1) for above, below in borders]


def _triangles(sheet: Floats) -> Floats:
    """Corners (k, 3, 3) of a sheet of nodes (n, m, 3), seen with its first axis to the right, its second upwards."""
    a, b, c, d = sheet[:-1, :-1], sheet[1:, :-1], sheet[1:, 1:], sheet[:-1, 1:]
    both: Floats = np.stack([np.stack([a, b, c], axis=-2), np.stack([a, c, d], axis=-2)]).reshape(-1, 3, 3)
    return both


def _binary(triangles: Floats) -> bytes:
    facets = np.zeros(len(triangles), _FACET)
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    facets["normal"] = across / np.linalg.norm(across, axis=1, keepdims=True)
    facets["corners"] = triangles
    head = b"a mould as it was drawn, m".ljust(80) + len(triangles).to_bytes(4, "little")
    return head + facets.tobytes()
