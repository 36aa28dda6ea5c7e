"""STL files: what they hold, whatever way it is written; and the grid of heights that they become."""

from pathlib import Path

import numpy as np
import pytest

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats
from asterism.protocol.stl_file import load_triangles, parse_triangles
from asterism.protocol.stl_heights import stl_heights
from asterism.protocol.surface import STEEPEST, Heights, Surface
from tests.protocol.meshes import binary_stl as stl
from tests.protocol.meshes import box, sheet, text_stl, turned_over


def dome(x: Floats, y: Floats) -> Floats:
    return np.sqrt(1.0 - x * x - y * y) - 1.0


def arch(x: Floats, y: Floats) -> Floats:
    return np.sqrt(0.25 - x * x) - 0.5 + 0.0 * y


def tilted(x: Floats, y: Floats) -> Floats:
    return 0.1 * x - 0.05 * y + 0.02


DOME = sheet(dome, (25, 17))


@pytest.mark.parametrize(
    "data",
    [
        stl(DOME),
        stl(DOME, b"made by a program", attributes=0x7FFF),
        text_stl(DOME),
        text_stl(DOME, "\r\n"),
        text_stl(DOME, "\r"),
        text_stl(DOME).upper(),
        text_stl(DOME).replace(b"  ", b"\t"),
    ],
    ids=["binary", "attributes", "text", "crlf", "cr", "capitals", "tabs"],
)
def test_triangles_are_read_however_they_are_written(data: bytes) -> None:
    assert parse_triangles(data, "mould.stl") == pytest.approx(DOME, abs=1e-7)


def ground_error(triangles: Floats, height: object, rng: np.random.Generator) -> tuple[Surface, Floats, Floats]:
    surface = Surface(stl_heights(triangles, "mould.stl"))
    ground = surface.ground(rng.uniform([-0.3, -0.2], [0.3, 0.2], (5000, 2)) * 0.95)
    assert ground.inside.mean() > 0.999
    return surface, ground, ground.inside


def test_a_plane_is_exact(rng: np.random.Generator) -> None:
    for triangles in (sheet(tilted, (2, 2)), sheet(tilted, (40, 30), rng=rng)):
        xy = rng.uniform([-0.3, -0.2], [0.3, 0.2], (2000, 2))
        ground = Surface(stl_heights(triangles, "mould.stl")).ground(xy)
        assert ground.inside.all(), "up to its very edge"
        assert ground.heights == pytest.approx(tilted(*xy.T), abs=1e-12)
        assert ground.slopes == pytest.approx(np.tile([0.1, -0.05], (2000, 1)), abs=1e-10)
        assert ground.sigmas.max() < 1e-12


@pytest.mark.parametrize(
    ("height", "count", "most_m", "most_deg"),
    [(dome, (25, 17), 4e-6, 0.05), (arch, (41, 2), 2e-6, 0.01), (dome, (130, 90), 2e-7, 0.005)],
    ids=["25 mm facets", "strips over the whole length", "4.5 mm facets"],
)
def test_facets_are_the_surface_that_they_were_made_from(
    height: object, count: tuple[int, int], most_m: float, most_deg: float, rng: np.random.Generator
) -> None:
    assert callable(height)
    xy = rng.uniform([-0.3, -0.2], [0.3, 0.2], (5000, 2)) * 0.97
    triangles = sheet(height, count)
    ground = Surface(stl_heights(triangles, "mould.stl")).ground(xy)
    off = ground.heights - height(*xy.T)
    h = 1e-6
    steps = h * np.eye(2)
    slopes = np.column_stack([(height(*(xy + s).T) - height(*(xy - s).T)) / (2 * h) for s in steps])
    turned = np.degrees(np.sqrt(np.mean((ground.slopes - slopes) ** 2)))
    assert np.sqrt(np.mean(off**2)) < most_m
    assert turned < most_deg
    # What the flat facets themselves are off is known of the grid, and more than it is wrong.
    assert np.sqrt(np.mean(off**2)) < np.sqrt(np.mean(ground.sigmas**2))
    assert np.mean(np.abs(off) <= 2.0 * ground.sigmas + 1e-8) > 0.99


def test_of_a_solid_the_topmost_sheet_counts() -> None:
    stairs = np.concatenate([box((-0.3, -0.2, -0.05), (0.0, 0.2, 0.0)), box((0.0, -0.2, -0.05), (0.3, 0.2, -0.02))])
    surface = Surface(stl_heights(stairs, "mould.stl"))
    ground = surface.ground(np.array([[-0.1, 0.0], [0.1, 0.0], [0.0003, 0.0], [-0.31, 0.0]]))
    assert ground.inside.tolist() == [True, True, False, False], "a wall is no surface"
    assert ground.heights[:2] == pytest.approx([0.0, -0.02], abs=1e-9)
    assert ground.slopes[:2] == pytest.approx(0.0, abs=1e-9)


def test_a_low_step_is_in_the_sigmas_around_it() -> None:
    low = np.concatenate([box((-0.3, -0.2, -0.05), (0.0, 0.2, 0.0)), box((0.0, -0.2, -0.05), (0.3, 0.2, -0.0005))])
    ground = Surface(stl_heights(low, "mould.stl")).ground(np.array([[-0.1, 0.0], [0.0, 0.0], [0.1, 0.0]]))
    assert ground.inside.all()
    assert ground.sigmas[[0, 2]] == pytest.approx(0.0, abs=1e-9)
    assert 1e-4 < ground.sigmas[1] < 5e-4


def test_what_is_too_steep_is_no_surface(rng: np.random.Generator) -> None:
    def ridge(x: Floats, y: Floats) -> Floats:
        return (STEEPEST + 0.5) * np.maximum(x - 0.1, 0.0) + 0.0 * y

    ground = Surface(stl_heights(sheet(ridge, (13, 9)), "mould.stl")).ground(np.array([[0.0, 0.0], [0.2, 0.0]]))
    assert ground.inside.tolist() == [True, False]


def test_a_hole_is_no_surface_and_the_rest_is() -> None:
    plate = sheet(tilted, (61, 41))
    middle = plate.mean(axis=1)[:, :2]
    holed = plate[np.linalg.norm(middle - [0.1, 0.05], axis=1) > 0.03]
    shape = stl_heights(holed, "mould.stl")
    assert isinstance(shape, Heights)
    ground = Surface(shape).ground(np.array([[0.1, 0.05], [0.1, 0.1], [0.15, 0.05]]))
    assert ground.inside.tolist() == [False, True, True]


def test_cracks_between_triangles_are_no_holes(rng: np.random.Generator) -> None:
    plate = sheet(tilted, (61, 41))
    shaken = plate + rng.uniform(-2e-7, 2e-7, plate.shape)
    assert np.isfinite(stl_heights(shaken, "mould.stl").values).all()


def wrong(triangles: Floats, scale: float = 1.0) -> str:
    with pytest.raises(InputError) as refused:
        stl_heights(scale * triangles, "mould.stl")
    return str(refused.value)


def test_a_drawing_that_is_no_surface_is_refused_with_what_to_do() -> None:
    assert "is it in mm? Then add `scale: 0.001` beside `stl`" in wrong(DOME, 1e3)
    assert "is it in m already? Then leave out `scale`" in wrong(DOME, 1e-3)
    assert "no triangle of it faces +z" in wrong(turned_over(DOME))
    solid = box((-0.3, -0.2, -0.05), (0.3, 0.2, 0.0))
    assert "100% of what is seen of it from +z faces down: its triangles are inside out" in wrong(turned_over(solid))
    mixed = np.concatenate([DOME[:500], turned_over(DOME[500:])])
    assert "not all its triangles have their outside on the same side" in wrong(mixed)
    standing = DOME[:, :, [0, 2, 1]][:, ::-1]  # its y is up
    assert "most of it faces +y; turn it" in wrong(standing[:, ::-1][:, ::-1])


def test_what_is_no_stl_is_refused_with_what_it_is(tmp_path: Path) -> None:
    whole, text = stl(DOME), text_stl(DOME)
    holed = DOME.copy()
    holed[7, 1, 2] = np.nan
    for data, words in (
        (whole[:-1], f"is cut off: it tells of {len(DOME)} triangles"),
        (whole + b"\n", "expected"),
        (text[: len(text) // 2], "is cut off after"),
        (text.replace(b"endloop", b"vertex 0 0 0\nendloop", 1), "expected three of a facet"),
        (text.replace(b"e-0", b"ez0", 1), "vertex 1 is '"),
        (stl(DOME[:0]), "holds no triangle"),
        (b"solid nothing\nendsolid nothing\n", "holds no triangle"),
        (stl(holed), f"triangle 8 of {len(DOME)} has a corner that is no finite number"),
        (b"", "is 0 bytes long"),
        (b"%PDF-1.7 ...", "is a PDF"),
        (b"ISO-10303-21;\nHEADER;", "is a STEP file; export it as STL"),
        (b"x,y,z\n0,0,0\n", "name it under `heights`"),
        (bytes(range(256)) * 3, "is no STL"),
    ):
        with pytest.raises(InputError) as refused:
            parse_triangles(data, "mould.stl")
        assert str(refused.value).startswith("mould.stl: "), words
        assert words in str(refused.value)
    with pytest.raises(InputError, match="is a folder, expected an STL"):
        load_triangles(tmp_path)
    large = tmp_path / "large.stl"
    with large.open("wb") as file:
        file.truncate(300 << 20)  # of which nothing is on the disk
    with pytest.raises(InputError, match=r"has 300 MB, expected an STL of at most 128 MB; .* fewer triangles"):
        load_triangles(large)
