"""Triangles of surfaces that are known, and the STL files that hold them."""

import struct
from collections.abc import Callable

import numpy as np

from asterism.protocol.geometry import Floats

_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")])
Height = Callable[[Floats, Floats], Floats]


def sheet(
    height: Height, count: tuple[int, int], size: tuple[float, float] = (0.6, 0.4),
    rng: np.random.Generator | None = None,
) -> Floats:  # fmt: skip
    """Triangles (n, 3, 3) whose corners lie on a height over x and y, facing up; with ``rng`` the inner ones anywhere
    within a third of a step of their places.
    """
    x, y = np.meshgrid(*(np.linspace(-s / 2, s / 2, n) for s, n in zip(size, count, strict=True)), indexing="ij")
    if rng is not None:
        for values, s, n in zip((x, y), size, count, strict=True):
            values[1:-1, 1:-1] += rng.uniform(-0.33, 0.33, (count[0] - 2, count[1] - 2)) * s / n
    at = np.stack([x, y, height(x, y)], axis=-1)
    a, b, c, d = at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]
    halves = [np.stack(corners, axis=2).reshape(-1, 3, 3) for corners in ((a, b, c), (a, c, d))]
    return np.concatenate(halves)


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Floats:
    """The twelve triangles of a box, their outside outside."""
    quads = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for side, ends in enumerate((low, high)):
            corners = np.tile(np.array(ends), (4, 1))
            corners[:, u] = [low[u], high[u], high[u], low[u]]
            corners[:, v] = [low[v], low[v], high[v], high[v]]
            quads.append(corners if side else corners[::-1])
    return np.concatenate([np.stack([q[[0, 1, 2]], q[[0, 2, 3]]]) for q in quads])


def turned_over(triangles: Floats) -> Floats:
    """The same triangles, inside out."""
    return triangles[:, ::-1]


def binary_stl(triangles: Floats, header: bytes = b"solid of a binary file", attributes: int = 0) -> bytes:
    """A binary file of triangles (n, 3, 3)."""
    rows = np.zeros(len(triangles), _TRIANGLE)
    rows["corners"], rows["attributes"] = triangles, attributes
    return header.ljust(80)[:80] + struct.pack("<I", len(rows)) + rows.tobytes()


def text_stl(triangles: Floats, end: str = "\n", digits: int = 9) -> bytes:
    """A file of triangles (n, 3, 3) as text, with those ends of lines."""
    lines = ["solid mould"]
    for corners in triangles:
        lines += ["facet normal 0 0 0", "  outer loop"]
        lines += [f"    vertex {x:.{digits}e} {y:.{digits}e} {z:.{digits}e}" for x, y, z in corners]
        lines += ["  endloop", "endfacet"]
    return end.join([*lines, "endsolid mould", ""]).encode()
