"""Writes what bash completes: `python -m tests.command.completion`, after commands or their options have changed."""

import argparse
from collections.abc import Iterator
from pathlib import Path

from asterism.server.command import parser
from asterism.server.command.shared_arguments import named
from tests.helpers import REPOSITORY

FILE = REPOSITORY / "server" / "command" / "completion" / "asterism"

SCRIPT = """\
# What bash completes after `asterism`; written by tests/command/completion.py.
# Where bash-completion does not find it by itself: source it in ~/.bashrc.
_asterism() {{
    local cur=${{COMP_WORDS[COMP_CWORD]}} prev=${{COMP_WORDS[COMP_CWORD-1]}} command= word words= files=
    COMPREPLY=()
    for word in "${{COMP_WORDS[@]:1:COMP_CWORD-1}}"; do
        case "$command/$word" in
            {commands}) command=${{command:+$command }}$word ;;
        esac
    done
    case $command in
{words}
    esac
    case "$command/$prev" in
{values}
    esac
    if [[ $cur == -* || -z $files ]]; then
        COMPREPLY=($(compgen -W "$words" -- "$cur"))
    else
        compopt -o default 2>/dev/null
    fi
}}
complete -F _asterism asterism
"""


def script() -> str:
    """The completion of all commands, kinds, options and choices; files where one is expected."""
    parts = dict(_parts(parser.parser(), ""))
    commands = [f"{before}/{name}" for path in parts if path for before, _, name in [path.rpartition(" ")]]
    return SCRIPT.format(
        commands="|".join(commands),
        words="\n".join(_words(path, part) for path, part in parts.items()),
        values="\n".join(line for path, part in parts.items() for line in _values(path, part)),
    )


def _parts(part: argparse.ArgumentParser, path: str) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    yield path, part
    for name, below in _below(part).items():
        yield from _parts(below, f"{path} {name}".strip())


def _below(part: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    return next((dict(a.choices) for a in part._actions if isinstance(a, argparse._SubParsersAction)), {})


def _words(path: str, part: argparse.ArgumentParser) -> str:
    """What may stand anywhere behind a command."""
    words = [*_below(part), *(option for action in part._actions for option in action.option_strings)]
    files = any(not action.option_strings and _is_file(action) for action in part._actions)
    return f"        '{path}') words='{' '.join(words)}'{' files=1' if files else ''} ;;"


def _values(path: str, part: argparse.ArgumentParser) -> Iterator[str]:
    """What may stand behind an option that takes a value: one of its choices, a file, or what nobody can guess."""
    for action in part._actions:
        if action.option_strings and action.nargs != 0:
            options = "|".join(f"'{path}/{option}'" for option in action.option_strings)
            words = " ".join(map(str, action.choices or ()))
            yield f"        {options}) words='{words}' files={'1' if _is_file(action) else ''} ;;"


def _is_file(action: argparse.Action) -> bool:
    return action.type in (Path, named) or action.metavar in ("RIG", "SOURCE", ("TRUTH", "SOURCE"))


if __name__ == "__main__":
    FILE.write_text(script(), encoding="utf-8")
