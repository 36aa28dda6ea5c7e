"""Where tools were, out of recordings: their chunks are unpacked and read beside each other, and added up in order."""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.errors import InputError
from asterism.protocol.messages import FRAME_REPORT
from asterism.protocol.program import typed
from asterism.protocol.surface import Surface
from asterism.recordings.chunk_bytes import Indexed, chunk_bytes
from asterism.recordings.summary_check import ChunkPlace
from asterism.server.coverage.accumulate import Coverage
from asterism.server.coverage.report_bytes import Columns, records_of
from asterism.server.coverage.sightings import Sighted, Tool, sighted
from asterism.server.coverage.told import Looked, by_robot, told_in

_CHUNKS_AT_ONCE = 32  # of one task: some 32 MB
_AHEAD = 32  # tasks, so that nobody waits while what was read is added up
_FRAMES_AT_ONCE = 30_000  # that are added together: adding copies the map
_MESSAGE = 5  # MCAP's opcode


class Part(NamedTuple):
    """A file of a recording, and what the rig in force in it says: the ``surface``, the ``tools`` of the robots that
    stand on it by id, and where on the robots their points are.
    """

    file: Indexed
    surface: Surface
    tools: Mapping[str, Tool]
    looked: Looked


class Seen(NamedTuple):
    """What some frames told: their exposures (n,) ns, and where robots were."""

    times_ns: NDArray[np.int64]
    robots: dict[str, Sighted]


def add_recorded(coverage: Coverage, parts: Iterable[Part], show: Callable[[int], None]) -> Coverage:
    """With the files of one recording, in their order; ``show`` is told how many chunks were read.

    Raises InputError for one that is damaged.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    with ThreadPoolExecutor(cores) as pool:
        waiting: list[Seen] = []
        for seen in _in_order(_tasks(parts), pool, _AHEAD):
            show(_CHUNKS_AT_ONCE)
            waiting.append(seen)
            if sum(len(each.times_ns) for each in waiting) >= _FRAMES_AT_ONCE:
                coverage, waiting = _add(coverage, waiting), []
    return _add(coverage, waiting) if waiting else coverage


def _add(coverage: Coverage, seen: list[Seen]) -> Coverage:
    steps = np.diff(np.concatenate([each.times_ns for each in seen]))
    steps = steps[steps > 0]
    period_s = float(np.median(steps)) * 1e-9 if len(steps) else 0.0
    robots = dict.fromkeys(robot for each in seen for robot in each.robots)
    joined = {robot: _joined([each.robots[robot] for each in seen if robot in each.robots]) for robot in robots}
    return coverage.add_sighted(joined, period_s)


def _joined(seen: list[Sighted]) -> Sighted:
    times, feet, slopes, leaves, why = (np.concatenate(column) for column in zip(*seen, strict=True))
    return Sighted(times, feet, slopes, leaves, why)


def _tasks(parts: Iterable[Part]) -> Iterator[Callable[[], Seen]]:
    for part in parts:
        chunks = part.file.chunks
        for at in range(0, len(chunks), _CHUNKS_AT_ONCE):
            yield partial(_seen, part, chunks[at : at + _CHUNKS_AT_ONCE])


def _in_order(tasks: Iterator[Callable[[], Seen]], pool: ThreadPoolExecutor, most: int) -> Iterator[Seen]:
    """What the tasks return, in their order; at most so many are begun ahead."""
    begun: deque[Future[Seen]] = deque()
    for task in tasks:
        begun.append(pool.submit(task))
        if len(begun) >= most:
            yield begun.popleft().result()
    while begun:
        yield begun.popleft().result()


def _seen(part: Part, chunks: list[ChunkPlace]) -> Seen:
    """What the frame reports in some chunks of a file tell."""
    path = part.file.path
    reports = np.array([number for number, schema in part.file.channels.items() if schema == FRAME_REPORT.schema])
    columns = []
    for place in chunks:
        data = np.array(np.frombuffer(chunk_bytes(path, place), np.uint8))
        rows = records_of(data)
        channels = rows[rows[:, 0] == _MESSAGE, 1]
        if (len(rows) and rows[-1, 0] < 0) or not np.isin(channels, list(part.file.channels)).all():
            what = "records that are not whole" if len(rows) and rows[-1, 0] < 0 else "a message without its channel"
            raise InputError(f"{path}: is damaged ({what}); run this first: {typed('recover', path.parent)}")
        spans = np.ascontiguousarray(rows[(rows[:, 0] == _MESSAGE) & np.isin(rows[:, 1], reports), 2:])
        columns.append(told_in(data, spans, part.looked, path.parent))
    joined = Columns(*(np.concatenate(column) for column in zip(*columns, strict=True)))
    told = by_robot(joined, part.looked)
    return Seen(joined.times_ns, {robot: sighted(told[robot], part.surface, part.tools[robot]) for robot in told})
