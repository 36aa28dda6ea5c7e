"""One line on the terminal's error channel that says how a run is doing, redrawn in place; elsewhere nothing."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

from asterism.server.service.telling import shows_progress

if TYPE_CHECKING:  # a service without a terminal starts without it
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

REFRESH_HZ = 4.0
LOCATED = ("TRACKED", "TILT_AMBIGUOUS")


class Now(NamedTuple):
    """How a run is doing. ``whole`` is the number of frames if it is known."""

    frames: int
    whole: int | None
    rate_hz: float
    robots: Mapping[str, str]  # state of each in the newest frame
    notes: Sequence[str] = ()  # recording, drops: what else belongs into the line
    problem: str = ""  # what is wrong now, a sentence


def told(now: Now) -> str:
    """The line."""
    parts = [f"{now.frames} of {now.whole} frames" if now.whole else f"{now.frames} frames", f"{now.rate_hz:.0f}/s"]
    if now.robots:
        parts.append(states(now.robots))
    return ", ".join([*parts, *now.notes])


def states(robots: Mapping[str, str]) -> str:
    """How many robots are in which state; the ones that have no pose by name."""
    names: dict[str, list[str]] = {}
    for robot, state in robots.items():
        names.setdefault(state, []).append(robot)
    counts = []
    for state, who in names.items():
        few = state not in LOCATED and len(who) <= 3 and len(who) < len(robots)
        counts.append(f"{len(who)} {state}" + (f" ({' '.join(who)})" if few else ""))
    return " ".join(counts)


class LiveLine:
    """A context manager that keeps the line on the terminal; what is said meanwhile goes above it."""

    def __init__(self, now: Callable[[], Now], console: "Console | None" = None) -> None:
        self._now = now
        self._shown = shows_progress() if console is None else console.is_terminal
        self._console = console
        self._live: Live | None = None

    def draw(self) -> "Text":
        """The line as it is now."""
        from rich.text import Text

        now = self._now()
        line = Text(told(now), no_wrap=True, overflow="ellipsis")
        if now.problem:
            line.append(f"\n{now.problem}", "red")
        return line

    def __enter__(self) -> "LiveLine":
        if self._shown:
            from rich.console import Console
            from rich.live import Live

            console = self._console or Console(stderr=True)
            self._live = Live(get_renderable=self.draw, console=console, refresh_per_second=REFRESH_HZ, transient=True)
            self._live.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.__exit__(None, None, None)
