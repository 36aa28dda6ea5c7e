"""What a rig says of a surface and of who stands on it; everything that is wrong gets one sentence."""

from pathlib import Path

import numpy as np
import pytest

from asterism.protocol.errors import InputError
from asterism.protocol.grid_holes import holes_of
from asterism.protocol.heights_file import heights_text, parse_heights
from asterism.protocol.rig import Rig, load_rig, parse_rig
from asterism.protocol.surface import Heights, crossing
from asterism.protocol.surface_sight import sight_of, surface_warnings
from tests.protocol.meshes import binary_stl, sheet, text_stl
from tests.protocol.mutated_targets import RIG
from tests.protocol.small_camera import CAMERA
from tests.protocol.test_stl import DOME, dome, tilted

RIGGED = RIG.replace(", offset: led.yaml", "").replace("[0.4, 0.9]", "[0.8, 2.0]")
STANDS = "    stands: {point: tool, sigma: 0.00005, tilt_sigma_deg: 0.1}\n"
PLANE = "surface: {plane: {point: [0, 0, 0], normal: [0, 0, 1]}}\n"


def rig_with(surface: str, stands: str = STANDS, files: dict[str, str] | None = None) -> Rig:
    return parse_rig(RIGGED + stands + surface, CAMERA, "fuzz", files=files)


def refused(surface: str, stands: str = STANDS, files: dict[str, str] | None = None) -> str:
    with pytest.raises(InputError) as problem:
        rig_with(surface, stands, files)
    assert str(problem.value).isprintable()
    return str(problem.value)


def with_files(folder: Path, surface: str, **files: bytes) -> Path:
    (folder / "camera.yaml").write_text(CAMERA)
    (folder / "rig.yaml").write_text(RIGGED + STANDS + surface)
    for name, data in files.items():
        (folder / name.replace("_", ".")).write_bytes(data)
    return folder / "rig.yaml"


@pytest.mark.parametrize("data", [binary_stl(1e3 * DOME), text_stl(1e3 * DOME, "\r\n")], ids=["binary", "text"])
def test_an_stl_is_kept_as_the_table_that_it_became(data: bytes, tmp_path: Path, rng: np.random.Generator) -> None:
    rig = load_rig(with_files(tmp_path, "surface: {stl: mould.stl, scale: 0.001, sigma: 1e-5}\n", mould_stl=data))
    kept = parse_rig(rig.rig_text, rig.camera_text, "kept", rig.offset_texts, rig.files)
    assert rig.surface is not None
    assert kept.surface is not None
    xy = rng.uniform([-0.29, -0.19], [0.29, 0.19], (100, 2))
    ground, again = rig.surface.ground(xy), kept.surface.ground(xy)
    assert ground.heights == pytest.approx(dome(*xy.T), abs=1e-4)
    assert all(np.array_equal(a, b) for a, b in zip(ground, again, strict=True)), "to the last bit"
    assert rig.files["mould.stl"].startswith("x,y,z,sigma\n")
    assert (ground.sigmas >= 1e-5).all()


def test_a_file_that_is_none_is_said_of_the_file(tmp_path: Path) -> None:
    for surface, data, words in (
        ("{stl: mould.stl}", binary_stl(1e3 * DOME), "mould.stl: is 600 x 400"),
        ("{stl: mould.stl, scale: 0}", binary_stl(DOME), "surface.scale: 0, expected a number above 0"),
        ("{stl: none.stl}", b"", "surface.stl: there is no file"),
        ("{stl: .}", b"", "is a folder, expected"),
        ("{heights: mould.stl}", text_stl(DOME), "is it an STL? Name it under `stl`"),
        ("{heights: mould.stl}", binary_stl(DOME), "is no text in UTF-8"),
        ("{stl: mould.stl}", b"x,y,z\n", "is a table of heights; name it under `heights`"),
    ):
        with pytest.raises(InputError) as problem:
            load_rig(with_files(tmp_path, f"surface: {surface}\n", mould_stl=data))
        assert words in str(problem.value)


GRID = "x,y,z\n0,0,0\n0,0.1,0\n0.1,0,0\n0.1,0.1,0\n"


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("", "begins with nothing, expected the header x,y,z or x,y,z,sigma"),
        ("x;y;z\n0;0;0\n", "columns are separated by commas"),
        ("x_mm,y_mm,z_mm\n0,0,0\n", "lengths are in m"),
        ("x,y\n0,0\n", "begins with x,y, expected the header"),
        ("x,y,z\n", "has no row behind its header"),
        (GRID + "0.2,0\n", "line 6: '0.2,0', expected 3 finite numbers x,y,z"),
        (GRID + "0.2,0,nan\n", "line 6: '0.2,0,nan'"),
        (GRID + "0.1,0.1,0.3\n", "lines 5 and 6 are the same node"),
        (GRID + "0.17,0,0\n0.31,0,0\n", "is not where the node of an even grid is"),
        ("x,y,z\n0,0,0\n0,0.1,0\n", "all rows have the same x"),
        ("x,y,z\n0,0,0\n0.1,0.1,0\n", "no four nodes of its grid are beside one another"),
        (GRID.replace("0.1", "100"), "is that mm? Divide x, y, z (and sigma) by 1000"),
        (GRID.replace(",0\n", ",0,-1e-5\n").replace("z\n", "z,sigma\n"), "a sigma of -1e-05, expected m, 0 to 0.05"),
        (GRID.replace(",0\n", ",0,1\n").replace("z\n", "z,sigma\n"), "a sigma of 1, expected m, 0 to 0.05"),
        (GRID.replace("0.1", "0.001") + "1,1,0\n", "is on a grid of 1001 x 1001 nodes"),
    ],
)
def test_a_table_that_is_no_grid_is_refused(table: str, words: str) -> None:
    with pytest.raises(InputError) as problem:
        parse_heights(table, "mould.csv")
    assert str(problem.value).startswith("mould.csv: ")
    assert words in str(problem.value)


def test_a_table_s_places_may_be_rounded_and_in_any_order(rng: np.random.Generator) -> None:
    i, j = np.meshgrid(np.arange(40), np.arange(30), indexing="ij")
    rows = [f"{x:.5f},{y:.5f},{x * 0.1:.6f}" for x, y in zip((i / 300).ravel(), (j / 700).ravel(), strict=True)]
    rng.shuffle(rows)
    read = parse_heights("x,y,z\n" + "\n".join(rows), "mould.csv")
    assert read.values.shape == (40, 30)
    assert read.step == pytest.approx([1 / 300, 1 / 700], rel=1e-3)
    assert np.isfinite(read.values).all()


@pytest.mark.parametrize(
    ("surface", "words"),
    [
        ("mould: {stl: a.stl}\n", "unknown key 'mould'; did you mean 'surface'?"),
        ("surface: {mesh: a.stl}\n", "surface: unknown key 'mesh'; did you mean 'stl'?"),
        ("surface: {}\n", "has none of plane, quadric, heights, stl, expected one"),
        (
            "surface: {plane: {point: [0, 0, 0], normal: [0, 0, 1]}, scale: 0.001}\n",
            "surface.scale: is of an `stl`",
        ),
        ("surface: {quadric: {terms: {one: 1, xx: 1}}}\n", "no z is among them"),
        ("surface: {quadric: {terms: {one: 1, xx: 1, zz: 1}}}\n", "there is no surface within 5 m of `about`"),
        (
            "surface: {quadric: {terms: {one: -0.01, xx: 1, yy: 1, zz: 1}}, edge: [[1, 1], [1, 2], [2, 2]]}\n",
            "surface.edge: there is no surface within it",
        ),
        (
            PLANE.replace("}}", "}, edge: [[0, 0], [1, 1], [1, 0], [0, 1]]}"),
            "surface.edge: its sides from corners 1 and 3 cross",
        ),
        (PLANE.replace("}}", "}, edge: [[0, 0], [300, 0], [0, 300]]}"), "is that mm?"),
        (PLANE.replace("}}", "}, edge: [[0, 0], [1, 0], [2, 0]]}"), "surface.edge: there is no surface within it"),
        (
            "surface: {heights: grid.csv, edge: [[1, 1], [1, 2], [2, 2]]}\n",
            "there is nothing of the grid within it, whose nodes are at x 0 to 0.1 and y 0 to 0.1 m",
        ),
        ("", "robots.alpha.stands: there is nothing to stand on, expected the rig's `surface`"),
    ],
)
def test_a_surface_that_is_none_is_refused(surface: str, words: str) -> None:
    assert words in refused(surface, files={"grid.csv": GRID})


def test_what_is_fixed_does_not_stand() -> None:
    fixed = STANDS + "    fixed: {position: [0, 0, 0], orientation: [0, 0, 0, 1]}\n"
    assert "alpha.stands: it does not move (`fixed`)" in refused(PLANE, fixed)


def test_what_is_hardly_meant_is_warned_of() -> None:
    assert surface_warnings(rig_with(PLANE)) == []
    assert "no robot of it `stands` on it" in surface_warnings(rig_with(PLANE, ""))[0]
    unseen = PLANE.replace("}}", "}, frame: {position: [0, 0, 2.5], orientation: [0, 0, 0, 1]}}")
    assert "the camera sees nothing of the surface" in surface_warnings(rig_with(unseen))[0]
    near = PLANE.replace("}}", "}, frame: {position: [0, 0, 1.0], orientation: [0, 0, 0, 1]}}")
    assert "is outside the rig's `range`" in surface_warnings(rig_with(near))[0]


def test_how_much_of_a_surface_is_seen_is_what_the_image_covers() -> None:
    # The image of 640 x 512 px at f = 700 covers 1.1886 x 0.9509 m of a plane 1.3 m away.
    edge = "[[-1, -1], [1, -1], [1, 1], [-1, 1]]"
    sight = sight_of(rig_with(PLANE.replace("}}", f"}}, edge: {edge}}}")))
    assert sight is not None
    assert sight.share == pytest.approx(1.1886 * 0.9509 / 4.0, rel=0.05)
    assert (sight.near_m, sight.far_m) == (pytest.approx(1.3), pytest.approx(1.3))


def test_holes_are_found_and_said() -> None:
    values = np.zeros((60, 40))
    whole = Heights(np.zeros(2), np.array([0.01, 0.01]), values, values)
    assert holes_of(whole) == []
    values = values.copy()
    values[:5], values[20:23, 10:14], values[50, 30] = np.nan, np.nan, np.nan  # an outline, and two holes
    values[30, 20:], values[55:, 5] = np.nan, np.nan  # open to the rim
    assert holes_of(Heights(np.zeros(2), np.array([0.01, 0.01]), values, np.zeros((60, 40)))) == [
        "the surface has 2 holes, the largest of 40 x 50 mm about x = 0.21, y = 0.115 of its frame (m): there is no "
        "surface in it"
    ]
    ring = np.hypot(*np.meshgrid(np.arange(-20, 21), np.arange(-20, 21), indexing="ij"))
    values = np.where((ring > 8) & (ring < 12), np.nan, 0.0)
    assert len(holes_of(Heights(np.zeros(2), np.array([0.01, 0.01]), values, np.zeros(values.shape)))) == 1


def test_sides_that_cross_are_found() -> None:
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
    assert crossing(square) is None
    assert crossing(square[[0, 2, 1, 3]]) == (0, 2)
    star = np.array([[np.cos(a), np.sin(a)] for a in np.arange(5) * 4 * np.pi / 5])
    assert crossing(star) is not None
    assert crossing(np.array([[np.cos(a), np.sin(a)] for a in np.arange(50) * 2 * np.pi / 50])) is None


def test_a_table_s_digits_turn_nothing(rng: np.random.Generator) -> None:
    shape = parse_heights(heights_text(grid := _grid()), "mould.csv")
    assert shape.values == pytest.approx(grid.values, abs=1e-7)
    rows = len(heights_text(grid).splitlines())
    assert len(heights_text(grid)) < 40 * rows


def _grid() -> Heights:
    from asterism.protocol.stl_heights import stl_heights

    return stl_heights(sheet(lambda x, y: tilted(x, y) + 0.01 * np.sin(20 * x), (121, 81)), "mould.stl")
