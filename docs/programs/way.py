"""A frame's way through the rooms, followed in the source: who calls whom, with the kinds that annotations tell."""

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from docs.programs.tree import Defined, file_of, parsed, room_of, sentence_of


@dataclass(frozen=True)
class Door:
    """A step of a frame's way: a function of another room, or a method of something that was handed in."""

    room: str
    name: str
    sentence: str


class Place(NamedTuple):
    """A function, method (`Class.method`) or class, and the module that defines it."""

    module: str
    name: str


Kinds = dict[str, Place]  # the classes that variables are of


def way(module: str, function: str) -> list[Door]:
    """The doors that a call of the function or method of that name passes, in the order of the source.

    Compiled code is not looked into. Empty where the module has no such function.
    """
    doors: list[Door] = []
    for name in (function, *(f"{node.name}.{function}" for node in _classes(module))):
        start = Place(module, name)
        node = definition(start)
        if isinstance(node, ast.FunctionDef):
            seen = {start}
            for target in _called(start, node):
                _walk(target, room_of(module), seen, doors)
            break
    return doors


def definition(place: Place) -> Defined | None:
    """The function, class or method there."""
    body: list[ast.stmt] = parsed(file_of(place.module)).body
    found: Defined | None = None
    for part in place.name.split("."):
        found = next((node for node in body if isinstance(node, Defined) and node.name == part), None)
        if found is None:
            return None
        body = found.body
    return found


def _walk(place: Place, caller: str | None, seen: set[Place], doors: list[Door]) -> None:
    node, room = definition(place), room_of(place.module)
    if not isinstance(node, ast.FunctionDef) or place in seen or room in (None, "protocol"):
        return
    seen.add(place)
    if room != caller or ("." in place.name and not node.name.startswith("_")):
        doors.append(Door(str(room), place.name, sentence_of(node)))
    if not any(isinstance(word, ast.Name) and word.id.startswith("compiled") for word in node.decorator_list):
        for target in _called(place, node):
            _walk(target, room, seen, doors)


def _called(place: Place, function: ast.FunctionDef) -> Iterator[Place]:
    """Every function of asterism that is called, as far as names and annotations tell."""
    kinds = _kinds(place, function)
    for call in _in_source_order(function):
        match call.func:
            case ast.Name(id=name):
                yield _named(place.module, name)
            case ast.Attribute(value=value, attr=method) if (kind := _kind(place.module, value, kinds)) is not None:
                yield Place(kind.module, f"{kind.name}.{method}")


def _in_source_order(node: ast.AST) -> Iterator[ast.Call]:
    """Calls as they happen: arguments before the call, nested functions and lambdas not at all."""
    for child in ast.iter_child_nodes(node):
        if not isinstance(child, ast.FunctionDef | ast.Lambda):
            yield from _in_source_order(child)
    if isinstance(node, ast.Call):
        yield node


def _classes(module: str) -> Iterator[ast.ClassDef]:
    return (node for node in parsed(file_of(module)).body if isinstance(node, ast.ClassDef))


def _named(module: str, name: str) -> Place:
    """What a name in a module stands for: what it imports from asterism, or its own."""
    for node in ast.walk(parsed(file_of(module))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("asterism."):
            for alias in node.names:
                if name == (alias.asname or alias.name):
                    return Place(str(node.module), alias.name)
    return Place(module, name)


def _annotated(module: str, annotation: ast.expr | None) -> Place | None:
    """The class of asterism in an annotation such as `Recorder | None`."""
    for word in ast.walk(annotation) if annotation is not None else ():
        if isinstance(word, ast.Name) and isinstance(definition(place := _named(module, word.id)), ast.ClassDef):
            return place
    return None


def _kinds(place: Place, function: ast.FunctionDef) -> Kinds:
    """The classes of a function's arguments and of the variables that it fills from them."""
    kinds: Kinds = {}
    for argument in function.args.args:
        if argument.arg == "self" and "." in place.name:
            kinds["self"] = Place(place.module, place.name.rpartition(".")[0])
        elif (kind := _annotated(place.module, argument.annotation)) is not None:
            kinds[argument.arg] = kind
    for node in ast.walk(function):
        for target, value in _assigned(node):
            if isinstance(target, ast.Name) and (kind := _kind(place.module, value, kinds)) is not None:
                kinds[target.id] = kind
    return kinds


def _assigned(node: ast.AST) -> Iterator[tuple[ast.expr, ast.expr]]:
    """Targets and values of an assignment, pair by pair."""
    match node:
        case ast.Assign(targets=[ast.Tuple(elts=targets)], value=ast.Tuple(elts=values)):
            yield from zip(targets, values, strict=False)
        case ast.Assign(targets=[target], value=value):
            yield target, value


def _kind(module: str, value: ast.expr, kinds: Kinds) -> Place | None:
    """The class of an expression: a variable, an attribute, a new instance."""
    match value:
        case ast.Name(id=name):
            return kinds.get(name)
        case ast.Call(func=ast.Name(id=name)):
            place = _named(module, name)
            return place if isinstance(definition(place), ast.ClassDef) else None
        case ast.Attribute(value=inner, attr=name) if (owner := _kind(module, inner, kinds)) is not None:
            return _attribute(owner, name)
    return None


def _attribute(owner: Place, name: str) -> Place | None:
    """The class of an attribute: annotated in its class, or set from an argument of `__init__`."""
    node = definition(owner)
    for part in node.body if isinstance(node, ast.ClassDef) else ():
        if isinstance(part, ast.AnnAssign) and isinstance(part.target, ast.Name) and part.target.id == name:
            return _annotated(owner.module, part.annotation)
        if isinstance(part, ast.FunctionDef) and part.name == "__init__":
            known = _kinds(Place(owner.module, f"{owner.name}.__init__"), part)
            for statement in ast.walk(part):
                for target, value in _assigned(statement):
                    if isinstance(target, ast.Attribute) and target.attr == name:
                        return _kind(owner.module, value, known)
    return None
