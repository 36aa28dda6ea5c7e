"""Hints name the program as it was started."""

import subprocess
import sys
from pathlib import Path

import pytest

from asterism.protocol.program import program_of, typed


@pytest.fixture
def script(tmp_path: Path) -> Path:
    path = tmp_path / "my venv" / "bin" / "asterism"
    path.parent.mkdir(parents=True)
    path.write_text("#!/bin/sh\n")
    path.chmod(0o755)
    return path


def test_a_script_that_no_path_leads_to_is_named_as_it_was_typed(
    script: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert program_of(".venv/bin/asterism", "python") == ".venv/bin/asterism"
    assert program_of(str(script), "python") == f"'{script}'"


def test_a_script_that_the_path_finds_has_its_plain_name_and_another_of_that_name_has_not(
    script: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(script.parent))
    assert program_of(str(script), "python") == "asterism"
    monkeypatch.chdir(script.parent)
    assert program_of("./asterism", "python") == "asterism"
    other = tmp_path / "asterism"
    other.write_text("")
    assert program_of(str(other), "python") == str(other)


def test_a_module_is_named_with_its_python() -> None:
    assert program_of("/x/site-packages/asterism/__main__.py", ".venv/bin/python") == ".venv/bin/python -m asterism"
    assert program_of("/x/asterism/server/__main__.py", "python3") == "python3 -m asterism"


def test_other_programs_are_told_the_plain_name() -> None:
    assert program_of("/usr/bin/pytest", "python") == "asterism"
    assert program_of("", "python") == "asterism"


def test_arguments_are_quoted_where_a_shell_needs_it() -> None:
    assert typed("replay", Path("my recordings/a"), "--loop").endswith(" replay 'my recordings/a' --loop")


def test_a_refusal_says_how_to_ask_for_help() -> None:
    done = subprocess.run([sys.executable, "-m", "asterism", "nonsense"], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert f"see {sys.executable} -m asterism --help" in done.stderr
