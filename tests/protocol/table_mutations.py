"""Spreadsheets with something wrong: cells that are strange, gone, twice, in another row, and broken bytes."""

import numpy as np

from tests.protocol.mutations import STRANGE_VALUES, mutated_bytes

_CELLS = ("", "1,5", "1.5", "1.234,5", "1e400", "-", "nan", "٣", '"', "a;b", "\t", "x_mm", "robot", "\x00", "9" * 5000)


def mutated_table(data: bytes, rng: np.random.Generator) -> bytes:
    """The bytes of a table with one to three things wrong."""
    for _ in range(int(rng.integers(1, 4))):
        data = mutated_bytes(data, rng) if rng.integers(3) == 0 else _other_cell(data, rng)
    return data


def _other_cell(data: bytes, rng: np.random.Generator) -> bytes:
    lines = data.split(b"\n")
    k = int(rng.integers(len(lines)))
    mark = max((b";", b","), key=lines[k].count)
    cells = lines[k].split(mark)
    at = int(rng.integers(len(cells)))
    strange = (*_CELLS, *map(str, STRANGE_VALUES))
    match int(rng.integers(4)):
        case 0:
            cells[at] = strange[int(rng.integers(len(strange)))].encode("utf-8", "surrogatepass")
        case 1:
            del cells[at]
        case 2:
            cells.insert(at, cells[at])
        case _:
            other = lines[int(rng.integers(len(lines)))].split(mark)
            cells[at] = other[int(rng.integers(len(other)))]
    lines[k] = mark.join(cells)
    return b"\n".join(lines)
