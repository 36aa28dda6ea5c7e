"""The pages that people read, and what is to be checked in them: blocks, commands, links."""

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

from tests.helpers import REPOSITORY

FENCE = re.compile(r"^```(?P<language>\w+)\n(?P<text>.*?)^```", re.M | re.S)


def pages() -> list[Path]:
    """README, the pages of docs/, the client in C, the wire format, the changelog."""
    return [
        REPOSITORY / "README.md",
        *sorted((REPOSITORY / "docs").glob("*.md")),
        REPOSITORY / "clients" / "c" / "README.md",
        REPOSITORY / "protocol" / "README.md",
        REPOSITORY / "CHANGELOG.md",
    ]


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    page: str
    language: str
    text: str

    @property
    def commands(self) -> list[list[str]]:
        """Its lines as words, without comments and empty lines."""
        return [words for line in self.text.splitlines() if (words := shlex.split(line, comments=True))]


def blocks(language: str) -> list[Block]:
    """All blocks in a language."""
    return [
        Block(str(page.relative_to(REPOSITORY)), language, found["text"])
        for page in pages()
        for found in FENCE.finditer(page.read_text())
        if found["language"] == language
    ]
