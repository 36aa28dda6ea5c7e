"""Surfaces with something wrong: rigs that name them, tables of heights, STL files."""

import struct

import numpy as np

from asterism.protocol.heights_file import heights_text, parse_heights
from asterism.protocol.rig import parse_rig
from asterism.protocol.stl_file import parse_triangles
from asterism.protocol.stl_heights import stl_heights
from asterism.protocol.surface_sight import surface_warnings
from tests.protocol.meshes import binary_stl, box, sheet, text_stl
from tests.protocol.mutations import mutated_bytes
from tests.protocol.small_camera import CAMERA

_RIG = """\
camera: camera.yaml
world: {position: [0.0, 0.0, 1.3], orientation: [1.0, 0.0, 0.0, 0.0]}
robots:
  alpha:
    leds: [[0.02923, 0.03294, 0.0], [-0.01279, 0.04273, 0.0], [-0.04582, 0.004, 0.0],
      [-0.01981, -0.01067, 0.0], [-0.03314, -0.0269, 0.0], [0.01278, -0.04416, 0.0]]
    points: {tool: [0.0, 0.0, -0.03]}
    stands: {point: tool, sigma: 0.00005, tilt_sigma_deg: 0.1, axis: [0, 0, 1]}
surface:
  frame: {position: [0, 0, 0.01], orientation: [0, 0, 0, 1]}
  sigma: 0.00005
  tilt_sigma_deg: 0.05
"""
RIGS = tuple(
    _RIG + text
    for text in (
        "  plane: {point: [0, 0, 0], normal: [0, 0.1, 1]}\n  edge: [[-0.2, -0.2], [0.2, -0.2], [0.2, 0.2]]\n",
        "  quadric: {about: [0, 0, -1], terms: {one: -1, xx: 1, yy: 1, zz: 1}}\n",
        "  heights: mould.csv\n  edge: [[-0.2, -0.2], [0.2, -0.2], [0.2, 0.2]]\n",
        "  stl: mould.csv\n  scale: 0.001\n",
    )
)
_DOME = sheet(lambda x, y: -0.4 * x * x - 0.2 * y * y, (5, 4))
_TABLE = "x,y,z,sigma\n" + "".join(
    f"{x / 10:g},{y / 10:g},{0.01 * x * y:g},2e-05\n" for x in range(-3, 4) for y in range(-2, 3)
)
TABLES = (_TABLE.encode(), _TABLE.replace(",sigma", "").replace(",2e-05", "").encode())


def rig(text: str) -> object:
    """A rig with a surface, and what is odd of it."""
    return surface_warnings(parse_rig(text, CAMERA, "fuzz", files={"mould.csv": _TABLE}))


def heights(data: bytes) -> object:
    """A table, and what is written of it read again."""
    grid = parse_heights(data.decode("utf-8", "replace"), "fuzz")
    return parse_heights(heights_text(grid), "again")


def stl(data: bytes) -> object:
    """A file, and the grid that it becomes."""
    grid = stl_heights(parse_triangles(data, "fuzz"), "fuzz")
    assert np.isfinite(grid.sigmas).all()
    return grid


def files() -> tuple[bytes, ...]:
    """Small STL files of every kind."""
    return binary_stl(_DOME), text_stl(_DOME), text_stl(box((-0.1, -0.1, -0.1), (0.1, 0.1, 0.0)), "\r\n")


def mutated_stl(data: bytes, rng: np.random.Generator) -> bytes:
    """Broken bytes; and of a binary file numbers that are strange, or another number of triangles."""
    if rng.integers(2) or data[-10:].isascii():
        return mutated_bytes(data, rng)
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        triangle, number = int(rng.integers(len(_DOME))), int(rng.integers(3, 12))
        value = float(rng.choice([np.nan, np.inf, -1e38, 1e-40, 0.0, 1e3, -0.05, 15.0]))
        struct.pack_into("<f", changed, 84 + 50 * triangle + 4 * number, value)
    return bytes(changed)
