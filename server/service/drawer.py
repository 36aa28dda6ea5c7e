"""The process that draws for a live view: `python -m asterism.server.service.drawer [PORT]`.

It takes rigs and pictures from its standard input and logs their drawing, the same as a review's, into a viewer: a
window, or with PORT a page for browsers.
"""

import contextlib
import os
import pickle
import sys
from collections.abc import Iterator
from typing import BinaryIO, Protocol

import rerun as rr

from asterism.protocol.codec import decode_frame_report
from asterism.protocol.errors import InputError
from asterism.protocol.rig import Rig
from asterism.recordings.drawing import APPLICATION, Drawing
from asterism.recordings.layout import blueprint
from asterism.server.service.live_image import jpeg
from asterism.server.service.loopback import free_port
from asterism.server.service.pictures import Opened, Picture
from asterism.server.service.rerun_program import Rerun, has_display
from asterism.server.service.web_page import WebPage

NICER = 10  # in priority, than the server
FLUSH_S = 10.0  # a browser that is stopped takes nothing, and one that is slow takes its time


class Viewer(Protocol):
    """What shows what is logged at `url`."""

    url: str

    @property
    def ended(self) -> bool: ...

    def close(self) -> None: ...


def open_viewer(port: int | None) -> tuple[Viewer, str]:
    """The viewer, and what to say of where it is. Raises as `WebPage` does."""
    if port is not None:
        page = WebPage(port)
        return page, f"look at it in a browser: {page.address}"
    if has_display():
        return Rerun(free_port(), stays=True), ""
    viewer = Rerun(free_port(), "--serve-grpc")
    return (
        viewer,
        f"no display for the viewer; connect one with: rerun {viewer.url} (or serve with --web, for a browser)",
    )


def given(stream: BinaryIO) -> Iterator[Rig | Picture]:
    """What the server hands over, until it ends."""
    while len(size := stream.read(8)) == 8:
        yield pickle.loads(stream.read(int.from_bytes(size, "little")))


def draw(values: Iterator[Rig | Picture], viewer: Viewer) -> None:
    """Draw all of them; the first is a rig."""
    stream, drawing = rr.RecordingStream(APPLICATION), None
    for value in values:
        if isinstance(value, Rig):
            if drawing is None:
                stream.connect_grpc(viewer.url, default_blueprint=blueprint(value))
            drawing = Drawing(stream, value) if drawing is None else drawing.replaced_by(value)
        elif drawing is not None:
            drawing.encoded(jpeg(value.image), "image/jpeg", value.exposed_ns, value.sequence)
            drawing.report(decode_frame_report(value.report))
            # What waits in the library is old before it is seen: the frames that count are those not yet drawn.
            with contextlib.suppress(Exception):
                stream.flush(timeout_sec=FLUSH_S)
        if viewer.ended:
            return
    stream.disconnect()


def main(words: list[str]) -> None:
    """Open the viewer, say where it is, draw what comes."""
    out = sys.stdout.buffer
    try:
        if hasattr(os, "nice"):
            os.nice(NICER)
        viewer, where = open_viewer(int(words[0]) if words else None)
    except InputError as error:
        pickle.dump(Opened(wrong_input=str(error)), out)
        return
    except Exception as error:
        pickle.dump(Opened(problem=f"the viewer did not start: {error}"), out)
        return
    try:
        pickle.dump(Opened(where), out)
        out.flush()
        draw(given(sys.stdin.buffer), viewer)
    finally:
        viewer.close()


if __name__ == "__main__":
    main(sys.argv[1:])
