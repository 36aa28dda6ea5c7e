"""Reading the YAML files that people write, so that every mistake gets one sentence.

YAML 1.2 by ruamel.yaml: `no` is a word, `5e-3` a number, duplicate keys are refused.
"""

import difflib
import math
import re
from collections.abc import Collection, Mapping, Sequence
from itertools import accumulate
from pathlib import Path
from types import MappingProxyType
from typing import Any

from asterism.protocol.errors import InputError
from asterism.protocol.text_file import read_text

MOST = 1e30  # of any unit: what is computed from such numbers stays finite
_LONG = 200
_DEEPEST = 100
_BRACKETS = re.compile(r"[\[\]{}]")


def read_yaml(path: Path) -> "Section":
    """The mapping that the file holds.

    Raises InputError when the file is missing, unreadable, no YAML or no mapping.
    """
    return parse_yaml(read_text(path, "a YAML file"), str(path))


def parse_yaml(text: str, name: str) -> "Section":
    """The mapping that ``text`` holds; ``name`` is what sentences call it. Raises InputError as `read_yaml` does."""
    from ruamel.yaml import YAML
    from ruamel.yaml.constructor import DuplicateKeyError
    from ruamel.yaml.error import MarkedYAMLError, YAMLError

    too_deep = f"{name}: is nested too deeply, expected a YAML mapping of a few levels"
    if _is_deep(text):
        raise InputError(too_deep)
    try:
        values = YAML(typ="safe", pure=True).load(text)
    except DuplicateKeyError as error:
        key = shortened(str(error.problem).split('"')[1])
        raise InputError(f"{name}: line {_line(error)}: key '{key}' is given twice, expected once") from None
    except MarkedYAMLError as error:
        problem = shortened(" ".join(str(error.problem).split()), _LONG)
        raise InputError(f"{name}: line {_line(error)}: is no YAML: {problem}") from None
    except YAMLError as error:
        raise InputError(f"{name}: is no YAML: {shortened(' '.join(str(error).split()), _LONG)}") from None
    except RecursionError:
        raise InputError(too_deep) from None
    except Exception as error:  # dates, numbers, escapes and directives that its constructors trip over
        problem = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{name}: holds a value that is none in YAML ({shortened(problem)})") from None
    if values is None:
        raise InputError(f"{name}: is empty, expected a YAML mapping")
    return Section(values, name, "")


def _is_deep(text: str) -> bool:
    """Whether so many brackets are open at once that the parser would take seconds to give up."""
    steps = (1 if bracket in "[{" else -1 for bracket in _BRACKETS.findall(text))
    return max(accumulate(steps), default=0) > _DEEPEST


def _line(error: Any) -> int:
    mark = error.problem_mark or error.context_mark
    return int(mark.line) + 1 if mark else 1


class Section:
    """One mapping of a file, with where it stands; its methods return checked values or raise InputError."""

    def __init__(self, values: object, file: str, where: str) -> None:
        self.file = file
        self.where = where
        if not isinstance(values, dict):
            raise self.error(None, f"{describe(values)}, expected a mapping of keys to values")
        for key in values:
            if not isinstance(key, str):
                raise self.error(None, f"key {describe(key)} is no text, expected text; put it in quotes")
        self.values: dict[str, Any] = values

    def __contains__(self, key: str) -> bool:
        return key in self.values

    def path(self, key: str | None) -> str:
        """The dotted path of a key, for sentences."""
        return ".".join(shortened(part) for part in (self.where, key) if part)

    def error(self, key: str | None, text: str) -> InputError:
        """An InputError that names file and key."""
        path = self.path(key)
        return InputError(f"{self.file}: {path}: {text}" if path else f"{self.file}: {text}")

    def only(self, allowed: Collection[str], words: Mapping[str, str] = MappingProxyType({})) -> None:
        """Refuse keys that are not in ``allowed``, suggesting what ``words`` has for them, else the nearest."""
        for given in self.values:
            if given not in allowed:
                key = shortened(given)
                meant = words.get(key.lower().replace("-", "_").replace(" ", "_"))
                near = [meant] if meant else difflib.get_close_matches(key.lower(), allowed, n=1, cutoff=0.5)
                hint = f"did you mean '{near[0]}'? " if near else ""
                raise self.error(None, f"unknown key '{key}'; {hint}Accepted: {', '.join(allowed)}")

    def section(self, key: str) -> "Section":
        """The mapping under ``key``."""
        return Section(self._get(key, "a mapping"), self.file, self.path(key))

    def sections(self) -> dict[str, "Section"]:
        """Every value of this mapping as a mapping."""
        return {key: self.section(key) for key in self.values}

    def text(self, key: str, choices: Sequence[str] | None = None) -> str:
        """A text, one of ``choices`` if they are given."""
        value = self._get(key, "text")
        if choices is not None and value not in choices:
            raise self.error(key, f"{describe(value)}, expected one of {', '.join(choices)}")
        if not isinstance(value, str) or not value:
            raise self.error(key, f"{describe(value)}, expected text")
        return value

    def number(self, key: str, *, above: float = -math.inf, least: float = -math.inf) -> float:
        """A number up to `MOST`, greater than ``above`` and not less than ``least``."""
        if above > -math.inf:
            wanted = f"a number above {above:g}"
        elif least > -math.inf:
            wanted = f"a number, {least:g} or more"
        else:
            wanted = "a number"
        value = self._get(key, wanted)
        if not _is_number(value) or not value > above or not value >= least:
            raise self.error(key, f"{describe(value)}, expected {wanted}")
        return float(value)

    def integer(self, key: str, low: int, high: int) -> int:
        """A whole number from ``low`` to ``high``."""
        wanted = f"a whole number from {low} to {high}"
        value = self._get(key, wanted)
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise self.error(key, f"{describe(value)}, expected {wanted}")
        return value

    def boolean(self, key: str) -> bool:
        """`true` or `false`."""
        value = self._get(key, "true or false")
        if not isinstance(value, bool):
            raise self.error(key, f"{describe(value)}, expected true or false")
        return value

    def numbers(self, key: str, count: int, what: str) -> list[float]:
        """A list of ``count`` finite numbers; ``what`` says what they are."""
        wanted = f"{count} numbers ({what})"
        value = self._get(key, wanted)
        return self._numbers(value, key, wanted, count)

    def rows(self, key: str, count: int, what: str) -> list[list[float]]:
        """A list of lists of ``count`` finite numbers each."""
        wanted = f"a list of {what}"
        value = self._get(key, wanted)
        if not isinstance(value, list):
            raise self.error(key, f"{describe(value)}, expected {wanted}")
        return [
            self._numbers(row, f"{key}[{index}]", f"{count} numbers ({what})", count) for index, row in enumerate(value)
        ]

    def _numbers(self, value: object, key: str, wanted: str, count: int) -> list[float]:
        if not isinstance(value, list):
            raise self.error(key, f"{describe(value)}, expected {wanted}")
        if len(value) != count:
            raise self.error(key, f"{len(value)} values, expected {wanted}")
        for item in value:
            if not _is_number(item):
                raise self.error(key, f"{describe(item)} is among the values, expected {wanted}")
        return [float(item) for item in value]

    def _get(self, key: str, wanted: str) -> Any:
        if key not in self.values:
            raise self.error(key, f"is missing, expected {wanted}")
        return self.values[key]


def _is_number(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return -MOST <= value <= MOST


def _is_beyond(value: object) -> bool:
    return isinstance(value, int | float) and MOST < abs(value) < math.inf


def describe(value: object) -> str:
    """A value as a sentence shows it."""
    if value is None:
        return "nothing"
    if isinstance(value, dict):
        return f"a mapping of {len(value)} keys"
    if isinstance(value, list):
        return f"a list of {len(value)} values"
    try:
        told = shortened(repr(value))
        return f"{told} (beyond {MOST:g})" if _is_beyond(value) else told
    except ValueError:  # a whole number of more than 4300 digits
        return "a number of thousands of digits"


def shortened(text: str, most: int = 60) -> str:
    """At most so many characters of a text."""
    return text if len(text) <= most else text[: most - 3] + "..."
