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
import threading
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
        self._rig = rig
        self._ready = threading.Condition()
        self._newest: tuple[list[Message], Frame, Rig] | None = None
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="live-view", daemon=True)
        self._thread.start()

    def take_rig(self, rig: Rig) -> None:
        """Another rig is in force for the frames from now on."""
        self._rig = rig

    def write(self, messages: list[Message], frame: Frame) -> None:
        """Show this frame when the viewer gets to it."""
        with self._ready:
            self._newest = (messages, frame, self._rig)
            self._ready.notify()

    def close(self) -> None:
        """Stop showing; the viewer's window stays until it is closed."""
        with self._ready:
            self._closed = True
            self._ready.notify()
        self._thread.join(timeout=5.0)
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

    def _run(self) -> None:
        drawn = self._rig
        drawing = Drawing(self._stream, drawn)
        while True:
            with self._ready:
                self._ready.wait_for(lambda: self._newest is not None or self._closed)
                if self._closed:
                    return
                assert self._newest is not None
                messages, frame, rig = self._newest
                self._newest = None
            if rig is not drawn:
                drawn, drawing = rig, drawing.replaced_by(rig)
            drawing.image(frame.image, frame.exposed_ns, frame.index)
            for message in messages:
                if message.kind == FRAME_REPORT:
                    drawing.report(decode_frame_report(message.payload))
