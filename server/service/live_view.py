"""The rerun viewer beside a running server: the same drawing as a review, fed from a thread of its own.

The newest frame wins here as well: a viewer that is slow loses frames, never the chain its time.
"""

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path

import rerun as rr

from asterism.protocol.codec import decode_frame_report
from asterism.protocol.errors import WorldError
from asterism.protocol.messages import FRAME_REPORT, Message
from asterism.protocol.rig import Rig
from asterism.recordings.drawing import APPLICATION, Drawing
from asterism.recordings.layout import blueprint
from asterism.server.chain.frame import Frame
from asterism.server.service.say import say
from asterism.server.service.threads import Newest


class LiveView:
    """Starts the viewer on loopback (without a display: its server, for a viewer to connect to). A context manager."""

    def __init__(self, rig: Rig) -> None:
        program = shutil.which("rerun", path=f"{Path(sys.executable).parent}:{os.environ.get('PATH', '')}")
        if program is None:
            raise WorldError("the rerun viewer is not installed; pip install 'asterism-localization[review]'")
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        has_display = sys.platform != "linux" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
        command = [program, "--bind", "127.0.0.1", "--port", str(port)]
        self._viewer = subprocess.Popen(
            command if has_display else [*command, "--serve-grpc"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C ends the server, not what it has shown
        )
        url = f"rerun+http://127.0.0.1:{port}/proxy"
        if not has_display:
            say(f"no display for the viewer; connect one with: rerun {url}")
        self._stream = rr.RecordingStream(APPLICATION)
        self._stream.connect_grpc(url, default_blueprint=blueprint(rig))
        self._rig = self._drawn = rig
        self._drawing = Drawing(self._stream, rig)
        self._shown = Newest(self._show, "live-view")

    def take_rig(self, rig: Rig) -> None:
        """Another rig is in force for the frames from now on."""
        self._rig = rig

    def write(self, messages: list[Message], frame: Frame) -> None:
        """Show this frame when the viewer gets to it."""
        self._shown.give((messages, frame, self._rig))

    def status(self, messages: list[Message]) -> None:
        """Its views have no place for it."""

    def close(self) -> None:
        """Stop showing; the viewer's window stays until it is closed."""
        self._shown.close()
        self._stream.disconnect()
        if self._viewer.args[-1] == "--serve-grpc":  # type: ignore[index]
            # The program on the path only starts the viewer proper.
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._viewer.pid, signal.SIGTERM)
            self._viewer.wait()

    def __enter__(self) -> "LiveView":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _show(self, shown: tuple[list[Message], Frame, Rig]) -> None:
        messages, frame, rig = shown
        if rig is not self._drawn:
            self._drawn, self._drawing = rig, self._drawing.replaced_by(rig)
        self._drawing.image(frame.image, frame.exposed_ns, frame.index)
        for message in messages:
            if message.kind == FRAME_REPORT:
                self._drawing.report(decode_frame_report(message.payload))
