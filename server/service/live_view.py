"""The rerun viewer beside a running server, fed by a process of its own that draws (`drawer`).

Drawing takes rerun's library, its memory and 10 ms a frame: none of it is the server's. The newest frame wins here as
well: a viewer that is slow loses frames, never the chain its time.
"""

import contextlib
import importlib.util
import os
import pickle
import subprocess
import sys
import time

from asterism.protocol.errors import InputError, WorldError
from asterism.protocol.messages import FRAME_REPORT, Message
from asterism.protocol.rig import Rig
from asterism.server.chain.frame import Frame
from asterism.server.service.bound_process import end, start
from asterism.server.service.live_image import SHOWN_HZ
from asterism.server.service.pictures import Opened, Picture
from asterism.server.service.say import complain, say
from asterism.server.service.threads import Newest

ENDS_S = 3.0  # a viewer that does not let go is ended after that


class LiveView:
    """Shows frames in a viewer. A context manager.

    ``words`` are the drawing process': none for the viewer's window (without a display its server, for a viewer to
    connect to), a port for a page in browsers. Raises InputError for a port that cannot be had, ModuleNotFoundError
    where rerun is not installed, WorldError where the viewer does not start.
    """

    def __init__(self, rig: Rig, *words: str) -> None:
        if importlib.util.find_spec("rerun") is None:
            raise ModuleNotFoundError("No module named 'rerun'", name="rerun")
        self._process = start([sys.executable, "-m", "asterism.server.service.drawer", *words], pipes=True)
        self._ended = False
        try:
            self._hand_over(rig)
            _say_where(self._process)
        except BaseException:
            end(self._process)
            _close_pipes(self._process)
            raise
        self._rig = self._drawn = rig
        self._shown = Newest(self._show, "live-view")

    @property
    def pid(self) -> int:
        """Of the drawing process."""
        return self._process.pid

    def take_rig(self, rig: Rig) -> None:
        """Another rig is in force for the frames from now on."""
        self._rig = rig

    def write(self, messages: list[Message], frame: Frame) -> None:
        """Show this frame when the viewer gets to it."""
        self._shown.give((messages, frame, self._rig))

    def between(self, messages: list[Message]) -> None:
        """Its views have no place for it."""

    def close(self) -> None:
        """Stop showing; a window stays until it is closed."""
        self._shown.close(1.0 / SHOWN_HZ)
        if self._shown.busy:  # the viewer takes nothing
            end(self._process)
            self._shown.close()
        assert self._process.stdin is not None
        self._process.stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(ENDS_S)
        end(self._process)
        _close_pipes(self._process)

    def __enter__(self) -> "LiveView":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _show(self, shown: tuple[list[Message], Frame, Rig]) -> None:
        began, (messages, frame, rig) = time.monotonic(), shown
        if self._ended:
            return
        try:
            if rig is not self._drawn:
                self._hand_over(rig)
                self._drawn = rig
            for message in messages:
                if message.kind == FRAME_REPORT:
                    self._hand_over(Picture(frame.image, frame.exposed_ns, frame.index, message.payload))
        except OSError:
            self._ended = True
            complain("the viewer has ended; serving goes on without it")
        time.sleep(max(began + 1.0 / SHOWN_HZ - time.monotonic(), 0.0))

    def _hand_over(self, value: Rig | Picture) -> None:
        assert self._process.stdin is not None
        data = pickle.dumps(value, pickle.HIGHEST_PROTOCOL)
        for part in (len(data).to_bytes(8, "little"), data):
            left = memoryview(part)
            while left:
                left = left[os.write(self._process.stdin.fileno(), left) :]


def _say_where(process: subprocess.Popen[bytes]) -> None:
    assert process.stdout is not None
    try:
        opened = pickle.load(process.stdout)
    except EOFError:
        opened = Opened(problem="the viewer did not start")
    if opened.wrong_input:
        raise InputError(opened.wrong_input)
    if opened.problem:
        raise WorldError(opened.problem)
    if opened.where:
        say(opened.where)


def _close_pipes(process: subprocess.Popen[bytes]) -> None:
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            pipe.close()
