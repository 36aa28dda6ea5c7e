"""Changing single values of a rig.yaml, with every other character as the person wrote it.

ruamel.yaml's composer says where in the text every value stands; numbers are replaced in their places, so comments,
order, indentation and the style of all other numbers survive, also where a dump would lay them out anew.
"""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np

from asterism.protocol.errors import InputError

SURFACES = (("surface", "heights"), ("surface", "stl"))  # that are in a file

Value = str | float | Sequence["Value"] | Mapping[str, "Value"]


def rewrite(text: str, changes: Mapping[tuple[str, ...], Value], name: str) -> str:
    """The YAML ``text`` with the values at the paths changed: ``{("robots", "alpha", "leds"): [[x, y, z], ...]}``.

    Where a list or mapping has the shape of what stands there, its scalars are replaced one by one, comments between
    them stay; one of another shape is replaced as a whole. A key that is not there is added to its mapping, with the
    mappings above it. Numbers are written as they are given (round them first). ``name`` is what sentences call the
    file. Raises InputError where a value is shared by an anchor, since changing it would change another's.
    """
    for path, value in changes.items():
        root = _compose(text)
        edits: list[tuple[int, int, str]] = []
        _change(text, root, path, value, edits, _shared(root), name)
        for start, end, new in sorted(edits, reverse=True):
            text = text[:start] + new + text[end:]
    return text


def without(text: str, key: str) -> str:
    """The YAML ``text`` without a key of its outermost mapping, a block; as it is where it has no such key."""
    root = _compose(text)
    for name, node in root.value:
        if name.value == key and not root.flow_style:
            start, end = name.start_mark.index, text.find("\n", _end(node))
            return text[:start] + (text[end + 1 :] if end >= 0 else "")
    return text


def annotate(text: str, path: tuple[str, ...], tag: str, comments: Sequence[str]) -> str:
    """The YAML ``text`` with a line ``# tag: comment`` for each above the key at ``path``, in place of those with the
    same tag among the comments that stand there.
    """
    mapping = _find(_compose(text), path[:-1])
    line = next(key.start_mark.line for key, _ in mapping.value if key.value == path[-1])
    lines = text.splitlines(keepends=True)
    first = line
    while first > 0 and lines[first - 1].lstrip().startswith("#"):
        first -= 1
    others = [each for each in lines[first:line] if not each.lstrip().startswith(f"# {tag}: ")]
    indent = lines[line][: len(lines[line]) - len(lines[line].lstrip())]
    return "".join([*lines[:first], *others, *(f"{indent}# {tag}: {comment}\n" for comment in comments), *lines[line:]])


def relocate(text: str, old: Path, new: Path) -> str:
    """The rig's ``text``, written at ``old``, for the place ``new``: relative paths (`camera`, `robots` of a file,
    the `surface`'s, every robot's `led.offset`) lead to the same files.
    """
    root = _compose(text)
    offsets = [("robots", robot, "led", "offset") for robot in _keys(root, ("robots",))]
    return _relocated(text, old, new, [("camera",), ("robots",), *SURFACES, *offsets])


def relocate_robots(text: str, old: Path, new: Path) -> str:
    """The same for a file of robots that rigs share."""
    return _relocated(text, old, new, [(robot, "led", "offset") for robot in _keys(_compose(text), ())])


def _relocated(text: str, old: Path, new: Path, paths: Sequence[tuple[str, ...]]) -> str:
    before, after = old.parent.resolve(), new.parent.resolve()
    if before == after:
        return text
    root = _compose(text)
    changes: dict[tuple[str, ...], Value] = {}
    for path in paths:
        node = _find(root, path)
        if node is not None and isinstance(node.value, str) and not Path(node.value).is_absolute():
            changes[path] = Path(os.path.relpath(before / node.value, after)).as_posix()
    return rewrite(text, changes, str(old))


def _compose(text: str) -> Any:
    from ruamel.yaml import YAML

    return YAML(typ="safe", pure=True).compose(text)


def _is_mapping(node: Any) -> bool:
    return node is not None and node.id == "mapping"


def _find(node: Any, path: tuple[str, ...]) -> Any:
    """The node at a path, or None."""
    for key in path:
        if not _is_mapping(node):
            return None
        node = next((value for name, value in node.value if name.value == key), None)
    return node


def _keys(root: Any, path: tuple[str, ...]) -> list[str]:
    node = _find(root, path)
    return [key.value for key, _ in node.value] if _is_mapping(node) else []


def _shared(root: Any) -> set[int]:
    """The nodes that stand in more than one place, by anchor and alias."""
    seen: set[int] = set()
    twice: set[int] = set()

    def visit(node: Any) -> None:
        if id(node) in seen:
            twice.add(id(node))
            return
        seen.add(id(node))
        if node.id == "mapping":
            for _, value in node.value:
                visit(value)
        elif node.id == "sequence":
            for value in node.value:
                visit(value)

    visit(root)
    return twice


def _change(
    text: str,
    root: Any,
    path: tuple[str, ...],
    value: Value,
    edits: list[tuple[int, int, str]],
    shared: set[int],
    name: str,
) -> None:
    node = root
    for depth, key in enumerate(path):
        if id(node) in shared:
            raise _anchored(name, path[:depth])
        below = _find(node, (key,))
        if below is None:
            for missing in reversed(path[depth + 1 :]):
                value = {missing: value}
            edits.append(_inserted(text, node, key, value))
            return
        node = below
    _replace(node, value, path, edits, shared, name)


def _replace(
    node: Any,
    value: Value,
    path: tuple[str, ...],
    edits: list[tuple[int, int, str]],
    shared: set[int],
    name: str,
) -> None:
    if id(node) in shared:
        raise _anchored(name, path)
    if isinstance(value, Mapping) and node.id == "mapping" and {key.value for key, _ in node.value} == set(value):
        for key, below in node.value:
            _replace(below, value[key.value], (*path, key.value), edits, shared, name)
    elif _is_list(value) and node.id == "sequence" and len(node.value) == len(value):
        for item, below in zip(value, node.value, strict=True):
            _replace(below, item, path, edits, shared, name)
    else:
        edits.append((node.start_mark.index, _end(node), _flow(value)))


def _end(node: Any) -> int:
    """Where a value ends; the mark of a block is only where the next thing begins."""
    if node.id == "scalar" or node.flow_style:
        return int(node.end_mark.index)
    last = node.value[-1]
    return _end(last[1] if node.id == "mapping" else last)


def _inserted(text: str, mapping: Any, key: str, value: Value) -> tuple[int, int, str]:
    """The edit that adds a key to a mapping: behind the last entry that ends on its own line, else as the first."""
    entry = f"{_scalar(key)}: {_flow(value)}"
    if mapping.flow_style:
        last = mapping.end_mark.index - 1
        return last, last, f", {entry}" if mapping.value else entry
    first = mapping.value[0][0]
    indent = " " * first.start_mark.column
    for _, below in reversed(mapping.value):
        if below.id == "scalar" or below.flow_style:
            end = text.find("\n", below.end_mark.index)
            if end < 0:
                return len(text), len(text), f"\n{indent}{entry}\n"
            return end + 1, end + 1, f"{indent}{entry}\n"
    return first.start_mark.index, first.start_mark.index, f"{entry}\n{indent}"


def _anchored(name: str, path: tuple[str, ...]) -> InputError:
    return InputError(
        f"{name}: {'.'.join(path)}: is shared by an anchor (&, *), expected values of its own that can be changed"
    )


def _is_list(value: object) -> TypeGuard[Sequence[Value]]:
    return isinstance(value, Sequence) and not isinstance(value, str)


def _flow(value: Any) -> str:
    """A value in YAML's flow style."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_scalar(key)}: {_flow(below)}" for key, below in value.items()) + "}"
    if _is_list(value):
        return "[" + ", ".join(_flow(item) for item in value) + "]"
    if isinstance(value, str):
        return _scalar(value)
    return str(value) if isinstance(value, int) else number(value)


def number(value: float) -> str:
    """A number as YAML files that people read have it: no exponent, no more digits than it takes."""
    return np.format_float_positional(value, trim="0")


def _scalar(text: str) -> str:
    """A text as a YAML scalar, quoted where it needs it."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        plain = YAML(typ="safe", pure=True).load(f"[{text}]") == [text] and "\n" not in text
    except YAMLError:
        plain = False
    return text if plain else "'" + text.replace("'", "''") + "'"
