"""Drill plans: what is on the paper, in mm, read back from SVG and PDF."""

import re
from collections.abc import Iterator
from xml.etree import ElementTree

import numpy as np
import pytest

from asterism.protocol.geometry import Floats
from asterism.server.design.drill_plan import LARGEST_DISC, drill_plan
from asterism.server.design.page import Circle, Line, Page, Words, pdf, svg
from asterism.server.design.paper import BAR, PAPER
from tests.rigs import random_layout

SVG = "{http://www.w3.org/2000/svg}"
MM = 72 / 25.4  # points


@pytest.fixture
def layout(rng: np.random.Generator) -> Floats:
    return np.round(random_layout(rng, 0.046), 5)


def circles_of_svg(text: str) -> tuple[Floats, Floats]:
    """Centres and radii (n, 3) in mm, y up from the page's lower edge, and the page's size (2,) in mm."""
    root = ElementTree.fromstring(text)
    size = np.array([float(re.fullmatch(r"([\d.]+)mm", root.attrib[key])[1]) for key in ("width", "height")])  # type: ignore[index]
    left, top, width, height = (float(value) for value in root.attrib["viewBox"].split())
    assert (left, top) == (0.0, 0.0)
    scale = size / [width, height]
    assert scale[0] == scale[1]
    found = [
        [float(circle.attrib["cx"]), height - float(circle.attrib["cy"]), float(circle.attrib["r"])]
        for circle in root.iter(f"{SVG}circle")
    ]
    return np.array(found) * scale[0], size


def lines_of_pdf(data: bytes) -> tuple[list[str], float, Floats]:
    """The content stream, mm per unit of it, and the page's size in mm; every offset of the table is checked."""
    start = int(data.rsplit(b"startxref\n", 1)[1].split()[0])
    assert data[start:].startswith(b"xref\n")
    offsets = [int(line[:10]) for line in data[start:].split(b"trailer")[0].splitlines()[3:]]
    for number, offset in enumerate(offsets, start=1):
        assert data[offset:].startswith(b"%d 0 obj\n" % number)
    length = int(re.search(rb"/Length (\d+)", data)[1])  # type: ignore[index]
    stream = data.split(b"stream\n", 1)[1]
    assert stream[length:].startswith(b"\nendstream")
    box = np.array([float(v) for v in re.search(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", data).groups()])  # type: ignore[union-attr]
    lines = stream[:length].decode("ascii").splitlines()
    scale = re.fullmatch(r"([\d.]+) 0 0 \1 0 0 cm", lines[0])
    assert scale
    return lines[1:], float(scale[1]) / MM, box / MM


def circles_of_pdf(lines: list[str]) -> Iterator[list[float]]:
    """Centre and radius of every closed run of four curves."""
    for line in lines:
        if line.count(" c") == 4:
            path = np.array([float(v) for v in re.findall(r"-?[\d.]+", line.split(" w ")[1])]).reshape(-1, 2)
            ends = path[[0, 3, 6, 9]]
            centre = ends.mean(axis=0)
            assert np.ptp(np.linalg.norm(ends - centre, axis=1)) < 1e-3
            # A quarter of the way along the first curve is on the circle, too.
            quarter = np.array([27, 27, 9, 1]) / 64 @ path[[0, 1, 2, 3]]
            radius = float(np.linalg.norm(ends[0] - centre))
            assert np.linalg.norm(quarter - centre) == pytest.approx(radius, rel=5e-4)
            yield [*centre, radius]


def holes(circles: Floats, disc: float) -> Floats:
    """Centres (6, 2), mm, of the holes from the centre of the plate, whose outline is the first circle."""
    assert circles[0, 2] == pytest.approx(disc * 500, abs=1e-3)
    np.testing.assert_allclose(circles[1:, 2], 2.5, atol=1e-3)
    from_centre: Floats = circles[1:, :2] - circles[0, :2]
    return from_centre


def test_holes_of_the_svg_are_where_the_leds_are(layout: Floats) -> None:
    page = drill_plan("r001", layout, 0.1, 0.0025)
    circles, size = circles_of_svg(svg(page))
    np.testing.assert_allclose(size, [210, 297])
    np.testing.assert_allclose(holes(circles, 0.1), layout * 1e3, atol=1e-3)


def test_holes_of_the_pdf_are_where_the_leds_are(layout: Floats) -> None:
    page = drill_plan("r001", layout, 0.1, 0.0025)
    lines, scale, size = lines_of_pdf(pdf(page))
    assert scale == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(size, [210, 297], atol=1e-3)
    np.testing.assert_allclose(holes(np.array(list(circles_of_pdf(lines))), 0.1), layout * 1e3, atol=2e-3)


def test_both_show_a_bar_of_100_mm(layout: Floats) -> None:
    page = drill_plan("r001", layout, 0.1, 0.0025)
    lengths = [
        float(line.attrib["x2"]) - float(line.attrib["x1"])
        for line in ElementTree.fromstring(svg(page)).iter(f"{SVG}line")
    ]
    assert lengths.count(100.0) == 1
    lines, _, _ = lines_of_pdf(pdf(page))
    strokes = [re.fullmatch(r"[\d.]+ w ([\d.]+) ([\d.]+) m ([\d.]+) \2 l S", line) for line in lines]
    assert [float(found[3]) - float(found[1]) for found in strokes if found].count(100.0) == 1
    assert BAR == 100.0
    assert "100 mm: measure it before you drill" in svg(page)
    assert "(100 mm: measure it before you drill) Tj" in pdf(page).decode("ascii")


def test_holes_bear_their_numbers_and_stand_in_the_table(layout: Floats) -> None:
    page = drill_plan("r001", layout, 0.1, 0.0025)
    middle = next(np.array([mark.x, mark.y]) for mark in page.marks if isinstance(mark, Circle))
    numbers = {mark.text: np.array([mark.x, mark.y]) for mark in page.marks if isinstance(mark, Words)}
    for led, (x, y) in enumerate(layout * 1e3):
        digit = numbers[str(led)] + [1.1, 1.4]  # its middle
        away = np.linalg.norm(layout * 1e3 + middle - digit, axis=1)
        assert np.argmin(away) == led
        assert 2.5 < away[led] < 7.0
        assert 50 - np.linalg.norm(digit - middle) > 2  # off the rim
        rows = [text.split() for text in numbers if text.split()[0] == str(led) and len(text.split()) == 3]
        assert rows == [[str(led), f"{x:.2f}", f"{y:.2f}"]]
    assert {"x", "y", "r001"} <= set(numbers)
    arrow = [mark for mark in page.marks if isinstance(mark, Line) and mark.x0 > middle[0] + 50]
    assert len({(mark.x0, mark.y0) for mark in arrow}) == 2  # two wings from one tip, and the shaft
    assert numbers["x"][0] > middle[0] + 50


@pytest.mark.parametrize(("disc", "paper"), [(0.05, "A4"), (0.1, "A4"), (0.2, "A3"), (0.5, "A1"), (LARGEST_DISC, "A0")])
def test_every_plate_has_a_paper_on_which_nothing_overlaps(layout: Floats, disc: float, paper: str) -> None:
    page = drill_plan("r001", layout * disc / 0.1, disc, 0.0025)
    assert (paper, page.width, page.height) in PAPER
    assert f"{paper}: print at 100 %" in svg(page)
    outline = next(mark for mark in page.marks if isinstance(mark, Circle))
    bar = next(mark for mark in page.marks if isinstance(mark, Words) and "measure" in mark.text)
    title = min(mark.y for mark in page.marks if isinstance(mark, Words) and mark.y > page.height - 40)
    assert outline.y - outline.radius > bar.y + 4
    assert outline.y + outline.radius < title - 4
    for mark in page.marks:
        xs, ys = ([mark.x0, mark.x1], [mark.y0, mark.y1]) if isinstance(mark, Line) else ([mark.x], [mark.y])
        assert min(*xs, *ys) > 4 if len(xs) > 1 else min(xs[0], ys[0]) > 4
        assert max(xs) < page.width - 4
        assert max(ys) < page.height - 4


def test_words_are_written_as_they_are() -> None:
    page = Page(50.0, 50.0, "a (b) & <c>", (Words(1.0, 2.0, r"(x) \ & <y>"),))
    assert ElementTree.fromstring(svg(page)).findtext(f"{SVG}text") == r"(x) \ & <y>"
    assert rb"(\(x\) \\ & <y>) Tj" in pdf(page)
