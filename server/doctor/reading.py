"""Frames of a camera while they are looked at: every stamp is noted, whether or not there is time for its image.

A thread of its own takes them, so that what the chain costs looks like no frame that the camera lost. What the chain
has no time for is left out of everything but the checks of stamps.
"""

import contextlib
import queue
import threading
import time
from collections.abc import Callable, Iterator

from asterism.protocol.errors import WorldError
from asterism.server.chain.frame import Frame
from asterism.server.sources.source import LiveSource

AHEAD = 16  # images that may wait where all are wanted
GRACE_S = 3.0  # beyond the time to look for, until the first frame is there
WAIT_S = 0.1
LET_GO_S = 1.0  # that a camera may take; one that takes longer is left to the end of the program

Note = Callable[[Frame], None]


def read_live(source: LiveSource, seconds: float, note: Note, ahead: int = AHEAD) -> Iterator[Frame]:
    """Frames of so many seconds, those that there is time for; ``note`` is called with each, by another thread. So many
    wait ``ahead`` at most.

    Raises what the source raises, WorldError where no frame comes.
    """
    waiting: queue.Queue[Frame | BaseException | None] = queue.Queue(ahead)
    over = threading.Event()
    taker = threading.Thread(target=_take, args=(source, note, waiting, over), name="camera", daemon=True)
    taker.start()
    end, count = time.monotonic() + seconds, 0
    try:
        while (left := end + (0.0 if count else GRACE_S) - time.monotonic()) > 0:
            try:
                taken = waiting.get(timeout=min(left, WAIT_S))
            except queue.Empty:
                continue
            if isinstance(taken, BaseException):
                raise taken
            if taken is None:
                break
            end = end if count else time.monotonic() + seconds
            count += 1
            yield taken
    finally:
        over.set()
        taker.join(LET_GO_S)
    if not count:
        raise WorldError(f"{source.name}: no frame came; {source.problem or 'does it wait for a trigger?'}")


def _take(
    source: LiveSource, note: Note, waiting: "queue.Queue[Frame | BaseException | None]", over: threading.Event
) -> None:
    """In the thread: take frames until it is ``over``, and let go of the camera."""
    frames = source.frames()
    try:
        for frame in frames:
            if over.is_set():
                break
            note(frame)
            if not waiting.full():
                waiting.put(frame)
        source.close()
        next(frames, None)
        with contextlib.suppress(queue.Full):
            waiting.put_nowait(None)
    except BaseException as error:
        waiting.put(error)
