"""What the source tree says about itself: its rooms, and who uses whom. Read with `ast` alone."""

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

REPOSITORY = Path(__file__).parent.parent.parent
TOP = ("clients", "recordings", "protocol")  # rooms beside those of the server
Defined = ast.FunctionDef | ast.ClassDef


@dataclass(frozen=True)
class Room:
    """A folder (or, at the bottom of the server, a file) with its one sentence."""

    name: str
    sentence: str
    uses: frozenset[str]  # names of rooms


@cache
def parsed(path: Path) -> ast.Module:
    """A module's syntax tree."""
    return ast.parse(path.read_text())


def sentence_of(node: ast.Module | Defined) -> str:
    """The first sentence of a docstring, on one line; empty without one."""
    text = " ".join((ast.get_docstring(node) or "").split("\n\n")[0].split())
    return re.split(r"[.;] ", text, maxsplit=1)[0].rstrip(".").replace("`", "")


def room_of(module: str) -> str | None:
    """The room of `asterism.<...>`; the command line's own module belongs to `command`, the package itself to none."""
    parts = module.split(".")[1:]
    if parts[:1] != ["server"]:
        return parts[0] if parts and parts[0] in TOP else None
    if len(parts) == 1:
        return None
    return "command" if parts[1] == "__main__" else parts[1]


def file_of(module: str) -> Path:
    """The file of `asterism.<...>`."""
    path = REPOSITORY.joinpath(*module.split(".")[1:])
    return path / "__init__.py" if path.is_dir() else path.with_suffix(".py")


def modules() -> dict[str, Path]:
    """Every module of the rooms by its dotted name."""
    found = {}
    for top in ("server", *TOP):
        for path in sorted((REPOSITORY / top).rglob("*.py")):
            parts = path.relative_to(REPOSITORY).with_suffix("").parts
            found[".".join(("asterism", *(part for part in parts if part != "__init__")))] = path
    return found


def imported(path: Path) -> Iterator[str]:
    """The modules of asterism that a file imports, wherever in it."""
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("asterism."):
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield inner if file_of(inner).exists() else str(node.module)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name.startswith("asterism."))


def rooms() -> list[Room]:
    """All rooms, each before those it uses."""
    uses: dict[str, set[str]] = {}
    for name, path in modules().items():
        room = room_of(name)
        if room is None:
            continue
        others = uses.setdefault(room, set())
        others.update(other for module in imported(path) if (other := room_of(module)) not in (None, room))
    return [Room(name, _sentence(name), frozenset(uses[name])) for name in _in_order(uses)]


def _sentence(room: str) -> str:
    return sentence_of(parsed(file_of(f"asterism.{room}" if room in TOP else f"asterism.server.{room}")))


def _in_order(uses: dict[str, set[str]]) -> list[str]:
    """Users before used: by the length of the longest chain of uses below a room, then by name."""

    @cache
    def height(room: str) -> int:
        return 1 + max((height(other) for other in uses[room]), default=-1)

    return sorted(uses, key=lambda room: (-height(room), room))
