"""A process for every core, each of one thread. They end with this process, however it ends."""

import contextlib
import multiprocessing
import os
import threading
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from multiprocessing.connection import Connection

# More threads than cores only get into each other's way.
ALONE = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")


@contextlib.contextmanager
def workers(count: int) -> Iterator[Executor]:
    """So many; what they have in work is given up where the block is left by an exception."""
    here, there = multiprocessing.Pipe(duplex=False)
    before = {name: os.environ.get(name) for name in ALONE}
    os.environ.update(ALONE)
    context = multiprocessing.get_context("spawn")
    executor = ProcessPoolExecutor(count, context, _begin, (here,))
    try:
        yield executor
        executor.shutdown()
    except BaseException:
        there.close()
        executor.shutdown(wait=False, cancel_futures=True)
        raise
    finally:
        there.close()
        here.close()
        for name, value in before.items():
            _put(name, value)


def _put(name: str, value: str | None) -> None:
    if value is None:
        os.environ.pop(name, None)
    else:
        os.environ[name] = value


def _begin(alive: Connection) -> None:
    """In a worker: Ctrl-C is for the process that started it; when that is gone, so is this."""
    import signal

    for name in ("SIGINT", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(alive,), daemon=True).start()
    be_alone()


def be_alone() -> None:
    """OpenCV's threads are of no use where every core has a process."""
    import cv2

    cv2.setNumThreads(1)


def _end_with(alive: Connection) -> None:
    with contextlib.suppress(EOFError, OSError):
        alive.recv()
    os._exit(0)
