"""A map's folder, read back with other people's readers: page, tables, arrays, and the surface in rerun."""

import csv
import io
import sys
from collections.abc import Iterator
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pandas
import pytest

from asterism.protocol.geometry import Pose, exp_rotation
from asterism.server.coverage.added import added_by
from asterism.server.coverage.folder import PAGE, RRD, write_folder
from asterism.server.coverage.grid import Box
from asterism.server.coverage.in_rerun import write_rrd
from asterism.server.coverage.page import page
from asterism.server.coverage.pictures import pictures_of
from asterism.server.coverage.summary import Summary
from asterism.server.coverage.tables import patches_csv
from tests.coverage.made_maps import DAY_NS, EDGE, FLAT, SINCE_NS, between, made, nothing_but, visited
from tests.on_surface import BENT, height
from tests.recordings.test_drawing import contents

PLACE = Pose.from_matrix(exp_rotation(np.array([0.1, -0.2, 0.5])), np.array([0.3, 0.1, 0.2]))
SURFACE = replace(BENT, edge=EDGE, T_world_surface=PLACE)


def told() -> Summary:
    """Two days: alpha on the left, bravo on the right and long at one place; a gap between."""
    start = nothing_but(made(SURFACE), "alpha", {"not tracked": 30, "lifted": 7})
    first = visited(start, "alpha", between(start, (-1, -0.05), (-1, 1)), 1.0, turn=0.0)
    second = visited(first, "bravo", between(first, (0.05, 1), (-1, 1)), 1.0, at_s=90_000.0, turn=np.pi)
    second = visited(second, "bravo", between(second, (0.1, 0.15), (0.0, 0.05)), 9.0, at_s=90_005.0)
    added = [
        added_by("monday", SINCE_NS, SINCE_NS + 10**9, made(SURFACE), first),
        added_by("tuesday <2>", SINCE_NS + DAY_NS, SINCE_NS + DAY_NS + 10**9, first, second),
    ]
    return Summary.of("demo", second, added)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Summary, Path]:
    summary, folder = told(), tmp_path_factory.mktemp("coverage")
    assert write_folder(summary, folder) == ""
    return summary, folder


class Parsed(HTMLParser):
    """Tables as texts of their cells, the words of paragraphs, and what the page would load."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tables: list[list[list[str]]] = []
        self.words, self.loads, self._open = "", list[str](), list[str]()
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.loads += [value or "" for name, value in attrs if name in ("src", "href", "srcset")]
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("td", "th"):
            self.tables[-1][-1].append("")
        if tag not in ("img", "meta"):
            self._open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag, f"</{tag}> closes nothing"

    def handle_data(self, data: str) -> None:
        if {"td", "th"} & set(self._open):
            self.tables[-1][-1][-1] += data
        elif "style" not in self._open:
            self.words += f"{data} "

    def table(self, first: str) -> Iterator[dict[str, str]]:
        """The rows of the table whose head begins with those words."""
        head, *rows = next(table for table in self.tables if f"{table[0][0]} {table[0][1]}" == first)
        return (dict(zip(head, row, strict=True)) for row in rows)


def test_the_page_holds_the_numbers_and_needs_nothing_but_itself(written: tuple[Summary, Path]) -> None:
    summary, folder = written
    parsed = Parsed((folder / PAGE).read_text("utf-8"))
    assert len(parsed.loads) == 8
    assert all(each.startswith("data:image/png;base64,") for each in parsed.loads)
    left_out = {row["robot"]: row for row in parsed.table("robot counted")}
    assert (left_out["alpha"]["not tracked"], left_out["alpha"]["lifted"], left_out["bravo"]["lifted"]) == (
        "30", "7", "0",
    )  # fmt: skip
    assert "17.1%" in parsed.words  # 37 of 37 + 180
    monday, tuesday = parsed.table("recording from")
    assert (monday["recording"], tuesday["recording"]) == ("monday", "tuesday <2>")
    assert monday["left out"] == "37"
    assert monday["for the first time"] == f"{summary.added[0].new_m2:.3f} m²"
    shares = {row["robot"]: float(row["share"].rstrip("%")) for row in parsed.table("robot tool, mm")}
    assert shares["all"] == pytest.approx(shares["alpha"] + shares["bravo"], abs=0.11)
    assert shares["all"] == pytest.approx(100.0 * summary.visited_m2 / summary.covered.grid.area_m2, abs=0.051)
    gap, overworked = (list(table) for table in (parsed.table("no. area"), _regions(parsed)[1]))
    assert gap[0]["area"] == f"{summary.gaps.found[0].area_m2 * 1e4:.1f} cm²"
    assert (gap[0]["by"], gap[0]["last"]) == ("nobody", "never")
    assert overworked[0]["most dwell"] == "10 s"
    assert "tuesday <2>" not in parsed.words


def _regions(parsed: Parsed) -> list[list[dict[str, str]]]:
    return [
        [dict(zip(table[0], row, strict=True)) for row in table[1:]] for table in parsed.tables if table[0][0] == "no."
    ]


def test_the_rows_of_patches_sum_to_the_map(written: tuple[Summary, Path]) -> None:
    summary, folder = written
    rows = pandas.read_csv(folder / "patches.csv")
    grid, whole = summary.covered.grid, summary.whole
    assert len(rows) == grid.inside.sum()
    assert rows.area_m2.sum() == pytest.approx(grid.area_m2, rel=1e-5)
    assert rows.dwell_s.sum() == pytest.approx(whole.dwell_s.sum(), rel=1e-5)
    assert rows.passes.sum() == whole.passes.sum()
    assert rows.alpha_dwell_s.sum() + rows.bravo_dwell_s.sum() == pytest.approx(rows.dwell_s.sum(), rel=1e-5)
    assert rows.alpha_last_ns.dropna().astype("int64").unique().tolist() == [pytest.approx(SINCE_NS, abs=1000)]
    assert np.allclose(rows.alpha_speed_m_s.dropna(), 0.1)
    assert np.allclose(rows.alpha_direction_rad.dropna(), 0.0)
    last = {row["last_ns"] for row in csv.DictReader(io.StringIO((folder / "patches.csv").read_text()))}
    assert last == {"", str(SINCE_NS), str(SINCE_NS + 90_000 * 10**9), str(SINCE_NS + 90_005 * 10**9)}
    inner = PLACE.inverse().map(rows[["x_m", "y_m", "z_m"]].to_numpy())
    for x, y, z in inner[::997]:
        assert z == pytest.approx(height(SURFACE, x, y), abs=3e-6)
    arrays = np.load(folder / "coverage.npz")
    np.testing.assert_array_equal(arrays["dwell_s"], whole.dwell_s)
    np.testing.assert_array_equal(arrays["robot_passes"].sum(axis=0), whole.passes)
    assert arrays["robots"].tolist() == ["alpha", "bravo"]
    gaps = pandas.read_csv(folder / "gaps.csv")
    assert gaps.area_m2.tolist() == [pytest.approx(each.area_m2, rel=1e-5) for each in summary.gaps.found]
    assert gaps.area_m2[0] == pytest.approx(grid.areas[arrays["gap"] == 1].sum(), rel=1e-5)


def test_in_rerun_the_surface_has_its_heights_and_the_colours_of_its_patches(written: tuple[Summary, Path]) -> None:
    _, folder = written
    entities = contents(folder / RRD)
    mesh = entities["/dwell/mesh"]
    points = PLACE.inverse().map(np.array(mesh["Mesh3D:vertex_positions"][0][1]))
    for x, y, z in points[::499]:
        assert z == pytest.approx(height(SURFACE, x, y), abs=1e-6)
    places = np.array(mesh["Mesh3D:vertex_texcoords"][0][1])
    assert ((places >= -1e-6) & (places <= 1.0 + 1e-6)).all()
    np.testing.assert_allclose(np.polyfit(points[:, 0], places[:, 0], 1)[0], 1.0 / 0.6, rtol=0.02)
    for robot in ("", "/robots/alpha", "/robots/bravo"):
        assert {f"{robot}/{what}/mesh" for what in ("dwell", "passes", "speed", "last")} <= set(entities)
    assert entities["/dwell/gaps"]["Points3D:labels"][0][1][0].startswith("gap 1: ")


def test_every_picture_is_one_and_shows_where_tools_were(written: tuple[Summary, Path]) -> None:
    _, folder = written
    for name in ("dwell", "passes", "speed", "last"):
        for path in (folder / f"{name}.png", folder / f"{name}-by-robot.png"):
            image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
            assert image is not None
            assert image.shape[2] == 4  # no ground of its own
            assert len(np.unique(image.view(np.uint32))) > 20


def test_without_rerun_all_else_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    monkeypatch.setattr("asterism.server.coverage.folder.pictures_of", lambda _: [])  # they take a second
    said = write_folder(told(), tmp_path)
    assert said.startswith("coverage.rrd was not written: rerun is not installed; pip install ")
    assert {path.name for path in tmp_path.iterdir()} == {
        PAGE, "patches.csv", "gaps.csv", "overworked.csv", "coverage.npz",
    }  # fmt: skip
    assert RRD not in (tmp_path / PAGE).read_text("utf-8")


def test_an_empty_map_and_one_of_a_single_patch_are_pages_too(tmp_path: Path) -> None:
    empty = made(replace(FLAT, edge=np.zeros((0, 2))), ("alpha",), Box(0, 0, 0, 0))
    one = made(FLAT, ("alpha",))
    one = visited(one, "alpha", between(one, (0.0, 0.005), (0.0, 0.005)), 0.5)
    for covered in (empty, one):
        summary = Summary.of("demo", covered, [added_by("monday", 0, 0, covered, covered)])
        pictures = pictures_of(summary)
        assert len(pictures) == 8
        Parsed(page(summary, pictures, []))
        assert len(list(patches_csv(summary))) == 1 + covered.grid.inside.sum()
    write_rrd(Summary.of("demo", empty, []), tmp_path / RRD)


def test_a_film_counts_from_nought(written: tuple[Summary, Path]) -> None:
    summary, _ = written
    film = replace(summary, covered=replace(summary.covered, since_ns=0, until_ns=24_900_000_000))
    assert "0 s to 24.90 s" in Parsed(page(film, pictures_of(film), [])).words
    nothing = replace(summary, covered=replace(summary.covered, since_ns=0, until_ns=0))
    assert "no frames" in Parsed(page(nothing, pictures_of(nothing), [])).words
