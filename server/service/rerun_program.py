"""The rerun program in a process of its own, on loopback: a window, a server of what is logged, a page for browsers."""

import importlib.util
import os
import sys
from pathlib import Path

from asterism.server.service.bound_process import end, start
from asterism.server.service.loopback import HOST


class Rerun:
    """The program, started: it takes what is logged at `url`.

    ``port`` is where it listens on loopback; ``stays``: it outlives this process, as a window does that somebody looks
    at. Raises ModuleNotFoundError where it is not installed.
    """

    def __init__(self, port: int, *arguments: str, stays: bool = False) -> None:
        self.url = f"rerun+http://{HOST}:{port}/proxy"
        self._stays = stays
        self._process = start([*_program(), "--bind", HOST, "--port", str(port), *arguments], stays=stays)

    @property
    def ended(self) -> bool:
        """Whether it is gone."""
        return self._process.poll() is not None

    def close(self) -> None:
        """End it, unless it stays."""
        if not self._stays:
            end(self._process)


def has_display() -> bool:
    """Whether there is a screen for a window."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _program() -> list[str]:
    """The program itself: the command `rerun` only starts it, and would leave it behind."""
    found = importlib.util.find_spec("rerun_cli")
    if found is None or found.origin is None:
        raise ModuleNotFoundError("No module named 'rerun'", name="rerun")
    program = Path(found.origin).parent / "rerun"
    return [str(program)] if program.exists() else [sys.executable, "-m", "rerun_cli"]
