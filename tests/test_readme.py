"""The README: every command it shows is one, its rig loads, its Python runs."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from asterism.protocol.rig import parse_rig
from asterism.server.budget.uncertainty import KEYS, read_uncertainty
from asterism.server.command.parser import parser
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.helpers import REPOSITORY
from tests.servers import free_endpoint, running

README = (REPOSITORY / "README.md").read_text()


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", README, re.MULTILINE | re.DOTALL)


COMMANDS = [
    line.split("  #")[0].strip() for block in blocks("sh") for line in block.splitlines() if line.startswith("asterism")
]


def test_it_shows_commands() -> None:
    assert {shlex.split(command)[1] for command in COMMANDS} >= {"serve", "watch", "locate", "review", "replay"}


@pytest.mark.parametrize("command", COMMANDS)
def test_its_commands_are_commands(command: str) -> None:
    words = shlex.split(command)
    assert parser().parse_args(words[1:]).command == words[1]


def test_its_make_words_are_in_the_makefile() -> None:
    makefile = (REPOSITORY / "Makefile").read_text()
    words = re.findall(r"^make (\w+)", "\n".join(blocks("sh")), re.MULTILINE) + re.findall(r"`make (\w+)`", README)
    assert {"demo", "test", "bench"} <= set(words)
    for word in words:
        assert re.search(rf"^{word}:", makefile, re.MULTILINE), word


def test_its_measuring_programs_and_links_are_there() -> None:
    for module in re.findall(r"python -m ([\w.]+)", README):
        assert (REPOSITORY / (module.replace(".", "/") + ".py")).exists(), module
    for link in re.findall(r"\]\((?!https?:)([^)]+)\)", README):
        assert (REPOSITORY / link).exists(), link


def test_its_rig_is_a_rig() -> None:
    text, _ = blocks("yaml")
    rig = parse_rig(text, (DEMO_RIG.parent / "camera.yaml").read_text(), "README.md")
    assert [robot.id for robot in rig.robots] == ["alpha"]


def test_its_uncertainties_are_uncertainties(tmp_path: Path) -> None:
    _, text = blocks("yaml")
    (tmp_path / "uncertainty.yaml").write_text(text)
    assert read_uncertainty(tmp_path / "rig.yaml", "edge-model").given == set(KEYS)


def test_its_chain_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    code = next(block for block in blocks("python") if "localize" in block)
    for file in DEMO_RIG.parent.glob("*.yaml"):
        (tmp_path / file.name).write_text(file.read_text())
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "README.md", "exec"), {"image": np.zeros((1024, 1280), np.uint8)})
    assert "alpha Lost" in capsys.readouterr().out


def test_its_client_prints_poses() -> None:
    code = next(block for block in blocks("python") if "PoseClient" in block)
    endpoint = free_endpoint()
    assert "tcp/127.0.0.1:7447" in code
    with running("serve", DEMO_RIG, "sim", "--listen", endpoint):
        client = subprocess.Popen(
            [sys.executable, "-u", "-c", code.replace("tcp/127.0.0.1:7447", endpoint)],
            stdout=subprocess.PIPE,
            text=True,
        )
        assert client.stdout is not None
        line = client.stdout.readline()
        client.kill()
        client.communicate()
    numbers = [float(word) for word in re.findall(r"-?\d+\.\d*(?:e-?\d+)?", line)]
    assert len(numbers) == 8, line
    assert 0.0 < numbers[-1] < 5.0
