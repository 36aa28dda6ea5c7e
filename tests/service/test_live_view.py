"""The viewer beside a server: without a display its server starts, and ends with the view."""

import os
import time

import pytest

from asterism.protocol.rig import load_rig
from asterism.server.service.live_view import LiveView
from asterism.server.simulation.demo_rig import DEMO_RIG


def test_the_viewers_server_ends_with_the_view(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with LiveView(load_rig(DEMO_RIG)) as view:
        viewer = view._viewer
        assert os.getpgid(viewer.pid) == viewer.pid != os.getpgrp()  # Ctrl-C in the terminal does not reach it
    deadline = time.monotonic() + 30.0
    while _lives(viewer.pid) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not _lives(viewer.pid)


def _lives(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True
