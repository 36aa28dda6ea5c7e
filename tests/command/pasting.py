"""Pasting the commands of an example's README.md into its folder, one after the other, in this process."""

import contextlib
import io
import re
import shlex
from pathlib import Path

from asterism.server.__main__ import main


def commands_of(folder: Path) -> list[list[str]]:
    """The words after `asterism` of every line of every sh block of the folder's README.md."""
    text = (folder / "README.md").read_text(encoding="utf-8")
    lines = [
        line
        for block in re.findall(r"^```sh\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
        for line in block.splitlines()
    ]
    words = [shlex.split(line) for line in lines]
    assert words
    assert all(line[0] == "asterism" for line in words)
    return [line[1:] for line in words]


def paste(words: list[str], folder: Path) -> str:
    """Run one command in the folder; returns what it printed. It must succeed."""
    told = io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(told), contextlib.redirect_stderr(told):
        code = main(words)
    assert code == 0, f"{shlex.join(words)}: exit code {code}\n{told.getvalue()}"
    return told.getvalue()
