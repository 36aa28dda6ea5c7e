"""asterism report: the page, its terminal table, and what it reads and refuses."""

import base64
import contextlib
import io
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from asterism.protocol.errors import InputError
from asterism.server.__main__ import main
from asterism.server.budget.budget import (
    SOURCES,
)
from asterism.server.budget.uncertainty import KEYS, Uncertainty, read_uncertainty
from asterism.server.simulation.demo_rig import DEMO_RIG


def demo_rig(folder: Path) -> Path:
    """A copy of the demonstration's rig, whose folder a test may write to."""
    for file in ("rig.yaml", "camera.yaml"):
        (folder / file).write_text((DEMO_RIG.parent / file).read_text())
    return folder / "rig.yaml"


class _Links(HTMLParser):
    """Every address that a page names, its tags, and for each table what encloses it; tags that end are balanced."""

    def __init__(self) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.narrow: list[str] = []
        self.tags: list[str] = []
        self.around_tables: list[tuple[str, str | None]] = []
        self._open: list[tuple[str, str | None]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag == "table":
            self.around_tables.append(self._open[-1])
        if tag not in ("meta", "img", "source"):
            self._open.append((tag, dict(attrs).get("class")))
        if tag == "source":
            self.narrow.append(dict(attrs)["srcset"] or "")
            return
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "data", "action")]

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop()[0] == tag

    def close(self) -> None:
        super().close()
        assert not self._open


@pytest.fixture(scope="module")
def reported(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder of a report with surveyed truth, and what the command printed. The simulator makes none of the
    systematic errors; what is left is noise, at the light of the frames.
    """
    folder = tmp_path_factory.mktemp("rig")
    rig, film, out = demo_rig(folder), folder / "film", folder / "report"
    given = "".join(f"{key}: {1e-7 if key == 'led_position_m' else 0}\n" for key in KEYS[2:])
    (folder / "uncertainty.yaml").write_text(given)
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        assert main(["simulate", str(rig), str(film), "--frames", "8"]) == 0
        truth, frames = str(film / "truth.jsonl"), str(film / "frames")
        assert main(["report", str(rig), "--truth", truth, frames, "-o", str(out)]) == 0
    return out, printed.getvalue()


def test_the_page_needs_nothing_but_itself(reported: tuple[Path, str]) -> None:
    out, printed = reported
    assert all(name in printed for name in SOURCES)
    page = (out / "report.html").read_text()
    links = _Links()
    links.feed(page)
    links.close()
    assert links.tags.count("img") == len(links.addresses) == 5
    plots = sorted(out.glob("*.png"))
    inlined = {base64.b64decode(address.removeprefix("data:image/png;base64,")) for address in links.addresses}
    assert inlined == {path.read_bytes() for path in plots}
    assert all(png.startswith(b"\x89PNG") for png in inlined)
    assert not {"script", "link", "iframe", "object"} & set(links.tags)
    assert "http" not in page
    assert not re.search(r"url\(|@import", page)


def test_the_page_fits_a_phone(reported: tuple[Path, str]) -> None:
    page = (reported[0] / "report.html").read_text()
    links = _Links()
    links.feed(page)
    assert '<meta name="viewport" content="width=device-width, initial-scale=1">' in page
    # What is wider than the page scrolls by itself; nothing has a width of its own.
    assert set(links.around_tables) == {("div", "wide")}
    assert ".wide { overflow-x: auto;" in page
    style = page.partition("<style>")[2].partition("</style>")[0]
    assert re.findall(r"(?<![-\w])(?:min-)?width: *([^;})]+)", style) == ["100%"]
    assert "width=" not in page.partition("</head>")[2]
    assert len(links.narrow) == len(links.addresses) == 5
    for wide, narrow in zip(links.addresses, links.narrow, strict=True):
        wide_px, narrow_px = _width_px(wide), _width_px(narrow)
        # Letters of the same size in px on a sheet as wide as the page.
        assert wide_px == 1200
        assert narrow_px < 700


def _width_px(address: str) -> int:
    png = base64.b64decode(address.removeprefix("data:image/png;base64,"))
    return int.from_bytes(png[16:20])


def test_the_page_tells_what_is_given_what_assumed_and_what_the_frames_told(reported: tuple[Path, str]) -> None:
    page = (reported[0] / "report.html").read_text()
    assert '0.0001 mm per axis</td><td class="text given">given' in page
    assert '0.001 px per axis</td><td class="text assumed">assumed' in page
    assert page.count('<td class="text given">from the frames') == 2


def test_measured_beside_predicted_on_simulated_frames(reported: tuple[Path, str]) -> None:
    told = re.search(r"(\d+) sightings, 0 lost, (\d+) with the wrong tilt.*covariance ([\d.]+)", reported[1], re.DOTALL)
    assert told is not None
    assert int(told[1]) + int(told[2]) == 5 * 8
    # 40 of them: one sigma of the mean is 0.55.
    assert 4.0 < float(told[3]) < 8.5
    assert "Measured beside predicted" in (reported[0] / "report.html").read_text()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("led_position: 0.1\n", "unknown key 'led_position'; did you mean 'led_position_m'?"),
        ("focal_relative: -0.1\n", "focal_relative: -0.1, expected a number, 0 or more"),
        ("offset_m: small\n", "offset_m: 'small', expected a number, 0 or more"),
        ("", "is empty, expected a YAML mapping"),
    ],
)
def test_a_wrong_uncertainty_file_is_refused(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "uncertainty.yaml").write_text(text)
    with pytest.raises(InputError, match=re.escape(words)) as refusal:
        read_uncertainty(tmp_path / "rig.yaml", "edge-model")
    assert "uncertainty.yaml" in str(refusal.value)


def test_a_calibrations_report_says_how_sure_the_lens_is(tmp_path: Path) -> None:
    camera = tmp_path / "mine.yaml"
    camera.write_text((DEMO_RIG.parent / "camera.yaml").read_text())
    assert read_uncertainty(tmp_path / "rig.yaml", "edge-model", camera) == Uncertainty(bias_px=0.001)
    (tmp_path / "mine.report.yaml").write_text(
        "sigmas: {fx: 0.7, fy: 0.7, cx: 0.2, cy: 0.4, k1: 0.01, k2: 0.01, p1: 0.001, p2: 0.001, k3: 0.01}\n"
    )
    (tmp_path / "uncertainty.yaml").write_text("principal_point_px: 0.1\n")
    told = read_uncertainty(tmp_path / "rig.yaml", "edge-model", camera)
    assert told.focal_relative == pytest.approx(0.7 / 1400.0)
    assert told.principal_point_px == 0.1
    assert (told.measured, told.given) == ({"focal_relative": "calibrate camera"}, {"principal_point_px"})


def test_a_folder_that_holds_something_is_refused_before_any_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "report"
    out.mkdir()
    (out / "notes.txt").write_text("mine")
    assert main(["report", "there is no such rig.yaml", "-o", str(out)]) == 2
    assert capsys.readouterr().err.startswith(f"asterism: {out}: exists already, expected a new or empty folder, or --")
    assert main(["report", str(DEMO_RIG), "-o", str(out / "notes.txt")]) == 2
    assert "expected a new or empty folder" in capsys.readouterr().err
    assert [path.name for path in out.iterdir()] == ["notes.txt"]
