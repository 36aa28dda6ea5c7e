"""asterism watch: a live table of every robot, or every frame and event as a line of JSON."""

import contextlib
import os
import select
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.live import Live

from asterism.clients.asking import asking
from asterism.clients.json_lines import JsonLines
from asterism.clients.waiting import waited_for
from asterism.clients.watched import RobotTable
from asterism.protocol import keys
from asterism.protocol.errors import InputError

if TYPE_CHECKING:
    import zenoh

REFRESH_HZ = 5
PLAIN_EVERY_S = 2.0
LOOK_EVERY_S = 0.2  # how things stand, while no line comes


def show(table: RobotTable, console: Console, stop: threading.Event, waiting: str = "") -> None:
    """Draw the table until ``stop`` is set: redrawn in place on a terminal, else as lines now and then."""
    if not console.is_terminal:
        while not stop.wait(PLAIN_EVERY_S):
            for line in table.lines() or ([waiting] if waiting else []):
                console.print(line, soft_wrap=True, markup=False, highlight=False)
        return
    with Live(console=console, refresh_per_second=REFRESH_HZ, transient=False) as live:
        while not stop.wait(1.0 / REFRESH_HZ):
            live.update(table.draw(console.width))
        live.update(table.draw(console.width))


def watch(
    robots: Sequence[str], connect: str | None, options: Path | None, prefix: str = "", as_json: bool = False
) -> None:
    """Show the live table, or write JSON lines, until Ctrl-C.

    ``prefix`` goes before every key: `replay/` follows a replay. Raises InputError for a malformed endpoint, file,
    robot id or prefix.
    """
    for robot in robots:
        if problem := keys.key_problem(robot):
            raise InputError(f"robot id {robot!r} {problem}")
    check_prefix(prefix)
    table = RobotTable(robots, prefix)
    with (
        contextlib.suppress(KeyboardInterrupt),
        waited_for(connect, options) as (session, endpoint),
        asking(session, prefix + keys.rig("*"), table.servers),
    ):
        if as_json:
            _write_lines(session, table, JsonLines(robots, prefix, table.servers))
            return
        held = table.subscribe(session)
        try:
            show(table, Console(), threading.Event(), f"no frame from {endpoint} yet")
        finally:
            held.clear()


def check_prefix(prefix: str) -> None:
    """Refuse what cannot stand before a key with an InputError."""
    parts = prefix.split("/")
    if prefix and (parts.pop() or any(keys.key_problem(part) for part in parts)):
        raise InputError(f"--prefix {prefix!r}: expected parts of a key that end with '/', such as replay/")


def _write_lines(session: "zenoh.Session", table: RobotTable, lines: JsonLines) -> None:
    """Everything as lines on standard output, each at once, until whoever reads them has enough; what is to be said
    besides goes to standard error, once.
    """
    held = [*table.follow_servers(session), *lines.subscribe(session)]
    said = ""
    try:
        while True:
            line = lines.next(LOOK_EVERY_S)
            if line is not None:
                print(line, flush=True)
            elif _is_left(sys.stdout.fileno()):
                break
            if (note := table.mistyped()) != said:
                print(f"asterism: {note}", file=sys.stderr, flush=True)
                said = note
    except BrokenPipeError:
        # What is left in the buffer has nowhere to go when Python ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    finally:
        held.clear()
        if lines.left_out:
            print(f"asterism: {lines.left_out} lines were left out: what reads them is too slow", file=sys.stderr)


def _is_left(file: int) -> bool:
    """Whether it is a pipe that nobody reads any more."""
    if not hasattr(select, "poll"):
        return False
    polled = select.poll()
    polled.register(file, 0)  # of trouble it tells all the same
    return any(told & select.POLLERR for _, told in polled.poll(0))
