"""The pages that people read: every command they show is one, rigs load, Python runs, links lead somewhere."""

import argparse
import contextlib
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import zenoh
from docs.programs import architecture, spots
from docs.programs.drawing import needed
from docs.programs.tree import rooms
from docs.programs.way import way

from asterism.protocol.rig import parse_rig
from asterism.protocol.yaml_file import parse_yaml
from asterism.server.budget.uncertainty import KEYS, read_uncertainty
from asterism.server.command.parser import COMMANDS, parser
from asterism.server.simulation.demo_rig import DEMO_RIG, DEMO_WORKPIECE
from tests.documents import Block, blocks, pages
from tests.helpers import REPOSITORY
from tests.servers import asterism, free_endpoint, running, wait_for_line

CAMERA = (DEMO_RIG.parent / "camera.yaml").read_text()
ENDPOINT = "tcp/127.0.0.1:7447"
RECORDING = "recordings/demo-20261123T101500Z"
OTHERS = (
    "make",
    "pip",
    "git",
    "cc",
    "cd",
    "cmake",
    "v4l2-ctl",
    ".venv/bin/python",
    "openssl",
    "printf",
    "apt",
    "arv-tool-0.8",
    "ip",
    "sysctl",
    "evo_ape",
)  # what pages run beside asterism
SHELL = blocks("sh")


def parses(words: list[str]) -> bool:
    """Whether the command line takes these words."""
    with contextlib.redirect_stderr(None):
        try:
            options: argparse.Namespace = parser(words).parse_args(words)
        except SystemExit as end:
            return end.code == 0  # --help, --version
    return bool(options.command == words[0])


def is_command(words: list[str]) -> bool:
    """Whether a line of a shell block can be run: of another program, only that it is one that pages may use."""
    if words[0] == "asterism":
        return parses(words[1:])
    if words[0] == "source":
        return (REPOSITORY / words[1]).exists()
    return words[0] in OTHERS


def lines(chosen: list[Block]) -> list[tuple[str, list[str]]]:
    return [(block.page, words) for block in chosen for words in block.commands]


def test_they_show_every_command() -> None:
    shown = {words[1] for _, words in lines(SHELL) if words[0] == "asterism"}
    assert shown >= COMMANDS.keys() - {"demo"}  # that is `make demo`


@pytest.mark.parametrize(("page", "words"), lines(SHELL), ids=" ".join)
def test_their_commands_are_commands(page: str, words: list[str]) -> None:
    assert is_command(words), f"{page}: {' '.join(words)}"


def test_commands_named_in_a_sentence_exist() -> None:
    for page in pages():
        if page.name == "CHANGELOG.md":
            continue
        for name in re.findall(r"`(?:\.venv/bin/)?asterism ([a-z]+)", page.read_text()):
            assert parses([name, "--help"]), f"{page.name}: asterism {name}"


def test_make_words_are_in_the_makefile() -> None:
    makefile = (REPOSITORY / "Makefile").read_text()
    used = {words[1] for _, words in lines(SHELL) if words[0] == "make"}
    for page in pages():
        used.update(re.findall(r"`make (\w+)", page.read_text()))
    assert {"demo", "test", "bench", "docs"} <= used
    for word in used:
        assert re.search(rf"^{word}:", makefile, re.MULTILINE), word


def test_installed_packages_are_ours() -> None:
    for page in pages():
        for package in re.findall(r"pip install (?:-\S+ )*'?([^\s'`]+)", page.read_text()):
            assert re.fullmatch(r"(asterism-localization|\.)(\[\w+(,\w+)*\])?", package), f"{page.name}: {package}"


def test_every_measuring_program_is_listed() -> None:
    page = (REPOSITORY / "docs" / "work.md").read_text()
    for path in (REPOSITORY / "tests" / "measure").glob("*.py"):
        if '__name__ == "__main__"' in path.read_text():
            assert f"`python -m tests.measure.{path.stem}`" in page, f"docs/work.md lists no tests.measure.{path.stem}"


@pytest.mark.parametrize("block", [block for block in SHELL if "asterism example" in block.text])
def test_the_examples_commands_are_those_of_its_folder(block: Block, tmp_path: Path) -> None:
    (first, *_), (_, name), *rest = block.commands
    assert asterism("example", tmp_path / name).returncode == 0, first
    readme = (tmp_path / name / "README.md").read_text()
    for words in rest:
        assert " ".join(words) in readme


def test_programs_files_and_links_are_there() -> None:
    for page in pages():
        text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
        for module in re.findall(r"python -m ((?:tests|docs)[\w.]+)", text):
            assert (REPOSITORY / (module.replace(".", "/") + ".py")).exists(), f"{page.name}: {module}"
        for file in re.findall(r"`((?:server|protocol|clients|recordings|tests|docs)/[\w/.-]*)`", text):
            assert (REPOSITORY / file).exists(), f"{page.name}: {file}"
        for link in re.findall(r"\]\((?!https?:)([^)#]+)(?:#[^)]*)?\)", text):
            assert (page.parent / link).exists(), f"{page.name}: {link}"


def test_they_speak_of_this_repository_only() -> None:
    for page in pages():
        assert not re.search(r"\.\./shared|/work/|/tmp/|/home/|/root/", page.read_text()), page.name


@pytest.mark.parametrize("block", blocks("yaml"), ids=lambda block: f"{block.page}: {block.text.splitlines()[0]}")
def test_their_yaml_is_a_rig_or_a_part_of_one_or_uncertainties(block: Block, tmp_path: Path) -> None:
    if re.search(r"^robots:", block.text, re.MULTILINE):
        assert [robot.id for robot in parse_rig(block.text, CAMERA, block.page).robots] == ["alpha"]
        return
    if set(parse_yaml(block.text, block.page).values) & set(KEYS):
        (tmp_path / "uncertainty.yaml").write_text(block.text)
        assert read_uncertainty(tmp_path / "rig.yaml", "edge-model").given == set(KEYS)
        return
    keys = "|".join(parse_yaml(block.text, block.page).values)
    rest = re.sub(rf"^({keys}):.*\n", "", DEMO_RIG.read_text(), flags=re.MULTILINE)
    assert parse_rig(rest + block.text, CAMERA, block.page).robots


def test_their_zenoh_options_are_zenoh_options() -> None:
    assert blocks("json5")
    for block in blocks("json5"):
        assert zenoh.Config.from_json5(block.text).get_json("listen/endpoints"), block.page


def python_blocks(with_client: bool) -> list[Block]:
    others = [block for block in blocks("python") if "Coverage" not in block.text]
    return [block for block in others if ("PoseClient" in block.text) == with_client]


def test_what_robots_left_to_do_is_heard() -> None:
    """On the demonstration's own surface."""
    (block,) = [block for block in blocks("python") if "Coverage" in block.text]
    endpoint = free_endpoint()
    code = block.text.replace(ENDPOINT, endpoint)
    with running("serve", DEMO_WORKPIECE, "sim", "--listen", endpoint) as server:
        wait_for_line(server, "serving")
        with subprocess.Popen([sys.executable, "-u", "-c", code], stdout=subprocess.PIPE, text=True) as client:
            assert client.stdout is not None
            line = client.stdout.readline()
            client.kill()
    told = re.match(r"(\w+): (\d+) patches changed, at x (\S+), y (\S+) m ([\d.]+) s so far", line)
    assert told is not None, line
    assert abs(float(told[3])) < 0.55
    assert abs(float(told[4])) < 0.45


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what pages take for granted: the rig, its camera, a recording."""
    path = tmp_path_factory.mktemp("reader")
    for file in DEMO_RIG.parent.glob("*.yaml"):
        (path / file.name).write_text(file.read_text())
    assert asterism("simulate", DEMO_RIG, path / "out", "--frames", 3).returncode == 0
    made = asterism("serve", DEMO_RIG, path / "out/frames", "--record", path / "new", "--listen", free_endpoint())
    assert made.returncode == 0, made.stderr
    (path / RECORDING).parent.mkdir()
    next((path / "new").iterdir()).rename(path / RECORDING)
    exported = asterism("export", path / RECORDING, "--to", "parquet", "-o", path / "poses.parquet")
    assert exported.returncode == 0, exported.stderr
    return path


@pytest.mark.parametrize("block", python_blocks(with_client=False), ids=lambda block: block.page)
def test_their_python_runs(
    block: Block, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    exec(compile(block.text, block.page, "exec"), {"image": np.zeros((1024, 1280), np.uint8)})
    printed = capsys.readouterr().out
    expected = {"localize": "alpha Lost", "pandas": "speed, mm/s"}
    assert next((text for word, text in expected.items() if word in block.text), "(1024, 1280)") in printed


@pytest.fixture(scope="module")
def served() -> Iterator[str]:
    """The endpoint of a running server."""
    endpoint = free_endpoint()
    with running("serve", DEMO_RIG, "sim", "--listen", endpoint):
        yield endpoint


@pytest.mark.parametrize("block", python_blocks(with_client=True), ids=lambda block: block.page)
def test_their_clients_print_poses(block: Block, served: str) -> None:
    assert ENDPOINT in block.text
    code = block.text.replace(ENDPOINT, served)
    with subprocess.Popen([sys.executable, "-u", "-c", code], stdout=subprocess.PIPE, text=True) as client:
        assert client.stdout is not None
        # "stop" is what a loop that steers says before the first pose.
        line = next(line for line in client.stdout if line != "stop\n")
        client.kill()
    numbers = [float(word) for word in re.findall(r"-?\d+\.\d*(?:e-?\d+)?", line)]
    assert len(numbers) in (3, 8), line
    assert np.all(np.abs(numbers[:3]) < 2.0)  # m: on the simulated surface
    assert all(0.0 < age_s < 5.0 for age_s in numbers[7:])


def test_the_table_of_spots_is_what_the_bounds_say() -> None:
    assert spots.PAGE.read_text() == spots.made(), "run: python -m docs.programs.spots"


def test_the_architecture_is_that_of_the_tree() -> None:
    for name, text in architecture.made().items():
        assert (architecture.DOCS / name).read_text() == text, f"docs/{name}; run: python -m docs.programs.architecture"


def test_rooms_are_drawn_with_every_use_that_does_not_follow() -> None:
    found = rooms()
    names = [room.name for room in found]
    assert {"command", "chain", "pose", "protocol", "clients", "recordings"} <= set(names)
    reached: dict[str, set[str]] = {}
    for room in reversed(found):
        assert all(names.index(other) > names.index(room.name) for other in room.uses), "an arrow would point up"
        drawn = needed(room, found)
        reached[room.name] = drawn.union(*(reached[other] for other in drawn))
        assert reached[room.name] >= room.uses


def test_a_frames_way_leads_from_a_source_through_the_rooms_to_the_recorder() -> None:
    passed = iter([door.room for door in way(*architecture.START)])
    for room in ("sources", "chain", "centres", "segmentation", "identity", "pose", "chain", "service", "recordings"):
        assert room in passed, room  # in this order: the iterator goes on where it was


def test_every_plot_stands_beside_the_command_that_draws_it() -> None:
    text = (REPOSITORY / "docs" / "light.md").read_text()
    plots = list((REPOSITORY / "docs").glob("light-*.svg"))
    assert plots
    for plot in plots:
        assert f"]({plot.name})" in text
        assert re.search(rf"`python -m tests\.measure\.\w+ [^`]*docs/{plot.name}`", text), plot.name


class Loaded(HTMLParser):
    """What a browser fetches for a page."""

    def __init__(self) -> None:
        super().__init__()
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        if tag in ("script", "img", "iframe", "source"):
            self.addresses.append(values.get("src") or "")
        if tag == "link" and values.get("rel") != "canonical":
            self.addresses.append(values.get("href") or "")


def test_they_build_and_ask_no_other_host(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    built = subprocess.run(
        command,
        cwd=REPOSITORY,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert built.returncode == 0, built.stderr
    for page in tmp_path.glob("*.html"):
        loaded = Loaded()
        loaded.feed(page.read_text())
        assert loaded.addresses
        assert not [address for address in loaded.addresses if "//" in address], page.name
