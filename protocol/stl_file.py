"""STL files: triangles of a drawing, binary or as text.

A binary file is 80 bytes of anything, the number of triangles, and 50 bytes of each: its normal, three corners (little
endian float32) and two bytes of attributes. Its length says that it is one, also where it begins with `solid`. Normals
and attributes are not read: which side of a triangle is outside is told by the order of its corners.
"""

import re
from pathlib import Path

import numpy as np

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats
from asterism.protocol.text_file import read_bytes

WHAT = "an STL, binary or as text"
MOST_BYTES = 128 << 20  # 2.7 million triangles in binary, half a million as text
_HEAD, _EACH = 84, 50
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")])
_VERTEX = re.compile(rb"\bvertex\b([^\r\n]*)")
_OTHERS = (  # how files begin that people take for a drawing's triangles, and what they are
    (b"%PDF", "a PDF"),
    (b"PK\x03\x04", "a ZIP archive (a 3MF?)"),
    (b"\x1f\x8b", "packed by gzip"),
    (b"ISO-10303-21", "a STEP file; export it as STL"),
    (b"ply", "a PLY file; export it as STL"),
    (b"# Blender", "an OBJ file; export it as STL"),
    (b"v ", "an OBJ file; export it as STL"),
    (b"x,y,z", "a table of heights; name it under `heights` instead of `stl`"),
    (b"\x89PNG", "a picture"),
    (b"\xff\xd8\xff", "a picture"),
)


def load_triangles(path: Path) -> Floats:
    """The corners of an STL file's triangles, (n, 3, 3) in the file's unit.

    Raises InputError: no file, a folder, too large, no STL, cut off, without triangles, or with corners that are no
    numbers.
    """
    try:
        if path.is_file() and path.stat().st_size > MOST_BYTES:
            raise InputError(
                f"{path}: has {path.stat().st_size >> 20} MB, expected an STL of at most {MOST_BYTES >> 20} MB; let "
                "the program that wrote it make fewer triangles (decimate it, or a coarser tolerance)"
            )
        data = read_bytes(path, WHAT, MOST_BYTES)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except ValueError:
        raise InputError(f"{str(path)!r}: is no name of a file, expected {WHAT}") from None
    return parse_triangles(data, str(path))


def parse_triangles(data: bytes, name: str) -> Floats:
    """The corners (n, 3, 3) of the triangles that the bytes of an STL file hold. Raises InputError as `load_triangles`
    does.
    """
    for begin, what in _OTHERS:
        if data.startswith(begin):
            raise InputError(f"{name}: is {what}, expected {WHAT}")
    told = int.from_bytes(data[80:_HEAD], "little") if len(data) >= _HEAD else -1
    if told >= 0 and len(data) == _HEAD + _EACH * told:
        with np.errstate(invalid="ignore"):  # a signalling nan is told of below
            triangles = np.frombuffer(data, _TRIANGLE, offset=_HEAD)["corners"].astype(np.float64)
    elif data[:512].lstrip()[:5].lower() == b"solid" and b"\0" not in data:
        triangles = _of_text(data.lower(), name)
    else:
        raise _not_whole(data, told, name)
    if not len(triangles):
        raise InputError(f"{name}: holds no triangle, expected the triangles of a surface")
    finite = np.isfinite(triangles).all(axis=(1, 2))
    if not finite.all():
        first = int(np.argmin(finite))
        raise InputError(
            f"{name}: triangle {first + 1} of {len(triangles)} has a corner that is no finite number, as have "
            f"{int((~finite).sum())} in all, expected finite numbers; write the file anew"
        )
    return triangles


def _not_whole(data: bytes, told: int, name: str) -> InputError:
    if told < 0:
        return InputError(f"{name}: is {len(data)} bytes long, expected {WHAT}")
    expected = _HEAD + _EACH * told
    if told * _EACH > 100 * MOST_BYTES:  # no number of triangles
        return InputError(f"{name}: is no STL, expected {WHAT}")
    if len(data) < expected:
        return InputError(
            f"{name}: is cut off: it tells of {told} triangles, which take {expected} bytes, and has {len(data)}; copy "
            "or write it again"
        )
    return InputError(
        f"{name}: is {len(data)} bytes long, expected {expected} for the {told} triangles that it tells of; is it an "
        "STL? Write it again"
    )


def _of_text(data: bytes, name: str) -> Floats:
    """The corners (n, 3, 3) of triangles as text, in small letters."""
    found = _VERTEX.findall(data)
    facets = data.count(b"endfacet")
    ends = data.rstrip().splitlines()[-1].lstrip() if data.strip() else b""
    if not ends.startswith(b"endsolid"):
        raise InputError(
            f"{name}: is cut off after {facets} triangles: no line endsolid ends it; copy or write it again"
        )
    if len(found) != 3 * facets:
        raise InputError(
            f"{name}: has {len(found)} lines vertex and {facets} lines endfacet, expected three of a facet: an STL "
            "holds triangles only"
        )
    try:
        numbers = np.fromstring(b" ".join(found).decode("latin-1"), sep=" ")
    except ValueError:
        raise _bad_vertex(found, name) from None
    if len(numbers) != 9 * facets or any(len(line.split()) != 3 for line in found):
        raise _bad_vertex(found, name)
    return numbers.reshape(-1, 3, 3)


def _bad_vertex(found: list[bytes], name: str) -> InputError:
    for index, line in enumerate(found):
        parts = line.decode("latin-1").split()
        try:
            good = len([float(part) for part in parts]) == 3
        except ValueError:
            good = False
        if not good:
            shown = " ".join(parts)[:60]
            text = shown if shown.isprintable() else repr(shown)
            return InputError(f"{name}: vertex {index + 1} is '{text}', expected three numbers x y z")
    return InputError(f"{name}: its vertices are not three numbers each, expected x y z")
