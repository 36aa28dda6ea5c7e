"""Bash completes commands, their options and choices, and files where one is expected."""

import subprocess
from pathlib import Path

import pytest

from tests.command.completion import FILE, script
from tests.helpers import REPOSITORY

ASK = """
compopt() { echo FILES; }  # readline's own completion of files, which needs a terminal
source "$1"; shift
COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1))
_asterism
printf '%s\\n' "${COMPREPLY[@]}"
"""


def completed(*words: str) -> list[str]:
    """What TAB offers behind the last of the words, which has been begun."""
    asked = ["bash", "--norc", "-c", ASK, "bash", str(FILE), "asterism", *words]
    return subprocess.run(asked, capture_output=True, text=True, check=True).stdout.split()


def test_the_file_is_that_of_the_commands() -> None:
    assert FILE.read_text(encoding="utf-8") == script(), "write it anew: python -m tests.command.completion"


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (["lo"], ["locate"]),
        (["re"], ["reload", "record", "replay", "review", "recover", "report"]),
        (["calibrate", "w"], ["world"]),
        (["locate", "--ind"], ["--independent"]),
        (["calibrate", "camera", "boards/", "--mo"], ["--model"]),
        (["calibrate", "camera", "--model", "p"], ["plumb_bob"]),
        (["serve", "rig.yaml", "--rate", ""], []),
        (["serve", "rig.yaml", "--record", ""], ["FILES"]),
        (["serve", "r"], ["FILES"]),
        (["locate", "rig.yaml", "frames/", "-o", ""], ["FILES"]),
        (["report", "rig.yaml", "--truth", "truth.jsonl", ""], ["FILES"]),
        (["--ver"], ["--version"]),
        (["check", "--l"], ["--log"]),
        (["router", "--li"], ["--listen"]),
    ],
)
def test_tab_offers(words: list[str], offered: list[str]) -> None:
    assert completed(*words) == offered


def test_every_command_is_offered() -> None:
    assert {"demo", "serve", "calibrate"} <= set(completed(""))
    assert {"camera", "leds", "world", "offset", "point", "z"} <= set(completed("calibrate", ""))


def test_it_is_installed_where_bash_looks_for_it() -> None:
    data = (REPOSITORY / "pyproject.toml").read_text(encoding="utf-8")
    assert f'"share/bash-completion/completions" = ["{FILE.relative_to(REPOSITORY).as_posix()}"]' in data
    assert Path(FILE).name == "asterism"
