"""Compiling with all cores: a process each, that leaves machine code on disk. `python -m` this file is such a process.

It reads its share as one line of JSON, numbers in the list of kernels, and writes each number back once that kernel is
done. When whoever started it is gone, so is it.
"""

import contextlib
import gc
import json
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Generator, Sequence

from asterism.server.chain.kernel_list import Entry, kernel_list

MOST_PROCESSES = 4  # more would compile ever more of the kernels' common parts twice
LEAST_SECONDS = 4.0  # of work for each: starting one costs a second


def cores() -> int:
    """How many this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def divide(entries: Sequence[Entry], count: int) -> list[list[Entry]]:
    """At most ``count`` shares that take about the same time; neighbours, which have the most in common, together."""
    total = sum(entry.seconds for entry in entries)
    count = max(1, min(count, MOST_PROCESSES, int(total / LEAST_SECONDS)))
    shares: list[list[Entry]] = [[] for _ in range(count)]
    before = 0.0
    for entry in entries:
        # By the middle of each: the share in which most of it falls.
        middle = before + 0.5 * entry.seconds
        shares[min(int(middle / max(total, 1e-9) * count), count - 1)].append(entry)
        before += entry.seconds
    return [share for share in shares if share]


def compile_beside(shares: Sequence[Sequence[Entry]]) -> Generator[Entry, None, None]:
    """Each kernel once it is on disk. A process that dies, or cannot be started, leaves its rest undone; none outlives
    this generator.
    """
    whole = kernel_list()
    done: queue.Queue[Entry | None] = queue.Queue()
    with contextlib.ExitStack() as stack:
        running = 0
        for share in shares:
            try:
                worker = _start()
            except OSError:
                continue
            running += 1
            stack.callback(_end, worker)
            threading.Thread(target=_listen, args=(worker, whole, done), daemon=True).start()
            _tell(worker, [whole.index(entry) for entry in share])
        while running:
            entry = done.get()
            if entry is None:
                running -= 1
            else:
                yield entry


def _start() -> "subprocess.Popen[str]":
    paths = os.pathsep.join(path for path in sys.path if path)
    return subprocess.Popen(
        [sys.executable, "-m", __name__],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env={**os.environ, "PYTHONPATH": paths},
        start_new_session=True,  # Ctrl-C is for us alone; we end it
    )


def _tell(worker: "subprocess.Popen[str]", numbers: list[int]) -> None:
    assert worker.stdin is not None
    with contextlib.suppress(OSError):  # if it died already, its listener notices
        worker.stdin.write(json.dumps(numbers) + "\n")
        worker.stdin.flush()


def _listen(worker: "subprocess.Popen[str]", whole: Sequence[Entry], done: "queue.Queue[Entry | None]") -> None:
    assert worker.stdout is not None
    with worker.stdout:
        for line in worker.stdout:
            done.put(whole[int(line)])
    done.put(None)


def _end(worker: "subprocess.Popen[str]") -> None:
    assert worker.stdin is not None
    worker.kill()
    worker.wait()
    with contextlib.suppress(OSError):
        worker.stdin.close()


def main() -> None:
    """Compile one share."""
    # numba leaves cycles by the hundred thousand; looking for them that often costs a tenth of the time.
    gc.set_threshold(100_000, 10, 10)
    numbers = json.loads(sys.stdin.readline())
    threading.Thread(target=_end_with_parent, daemon=True).start()
    for number in numbers:
        kernel_list()[number].make_ready()
        print(number, flush=True)


def _end_with_parent() -> None:
    sys.stdin.read()
    os._exit(1)


if __name__ == "__main__":
    main()
