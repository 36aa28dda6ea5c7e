"""Films that are cut have the lines of the whole, byte for byte; memories meet, or it is said that they do not."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from asterism.protocol.capture import Capture
from asterism.protocol.rig import Rig
from asterism.server import Frame, Tracks, localize
from asterism.server.service.batch import solving
from asterism.server.service.batch.cutting import LEAST_S, WHOLE, cuts
from asterism.server.service.batch.memory import mark, restored, stored
from tests.service.batch.films import batched, filmed, off, small_rig, with_standing

BLOCK = 120  # frames of what is learned at once


def plain(rng: np.random.Generator) -> tuple[Rig, list[Frame]]:
    rig = small_rig(2)
    return rig, filmed(rig, 4 * BLOCK, hidden=0.08)


def learned(rng: np.random.Generator) -> tuple[Rig, list[Frame]]:
    rig = small_rig(2)
    return off(rig, 3e-4, rng), filmed(rig, 4 * BLOCK)


def followed(rng: np.random.Generator) -> tuple[Rig, list[Frame]]:
    rig = small_rig(2)
    return with_standing(rig, 1), filmed(rig, 70, standing=1)


def rolling(rng: np.random.Generator) -> tuple[Rig, list[Frame]]:
    rig = replace(small_rig(1), capture=Capture(line_time_us=15.0))
    return rig, filmed(rig, 90)


@pytest.mark.parametrize("film", [plain, learned])
def test_a_film_that_is_cut_has_the_bytes_of_the_whole(
    film: Callable[[np.random.Generator], tuple[Rig, list[Frame]]],
    rng: np.random.Generator,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rig, frames = film(rng)
    whole, told = batched(monkeypatch, tmp_path, frames, rig, WHOLE, "whole")
    assert told.frames == len(frames)
    assert min(robot.found(told.frames) for robot in told.robots.values()) > 0.9
    third = len(frames) // 4
    cut, outcome = batched(monkeypatch, tmp_path, frames, rig, [(0, third), (third, len(frames))], "cut")
    assert cut == whole
    # It is no new solution of the rest: after some blocks its memory was that of the piece which began empty.
    assert outcome.again == 0
    assert 0 < outcome.overlap < len(frames) - third


@pytest.mark.parametrize("film", [rolling, followed])
def test_where_memories_do_not_meet_the_next_piece_is_solved_again(
    film: Callable[[np.random.Generator], tuple[Rig, list[Frame]]],
    rng: np.random.Generator,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rig, frames = film(rng)
    count = len(frames)
    whole, _ = batched(monkeypatch, tmp_path, frames, rig, WHOLE, "whole")
    cut, outcome = batched(monkeypatch, tmp_path, frames, rig, [(0, 20), (20, 45), (45, count)], "cut")
    assert cut == whole
    assert outcome.again == 2
    assert outcome.overlap >= count - 20


def test_a_clock_that_was_set_back_is_not_cut(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = small_rig(1)
    frames = [replace(frame, exposed_ns=frame.exposed_ns - 10**9 * (frame.index >= 25)) for frame in filmed(rig, 40)]
    whole, _ = batched(monkeypatch, tmp_path, frames, rig, WHOLE, "whole")
    cut, outcome = batched(monkeypatch, tmp_path, frames, rig, [(0, 20), (20, 40)], "cut")
    assert cut == whole
    assert outcome.pieces == 1
    assert outcome.notes == ["its clock was set back: not cut"]


def test_what_is_finished_is_not_solved_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = small_rig(1)
    frames, pieces = filmed(rig, 60), [(0, 20), (20, 40), (40, 60)]
    whole, _ = batched(monkeypatch, tmp_path, frames, rig, WHOLE, "whole")
    solved: list[str] = []
    real = solving._Solving.run

    def run(self: solving._Solving) -> solving.Told:
        if len(solved) >= 3:
            raise OSError("stopped")
        solved.append(self._job.name)
        return real(self)

    monkeypatch.setattr(solving._Solving, "run", run)
    _, outcome = batched(monkeypatch, tmp_path, frames, rig, pieces, "cut")
    assert outcome.state == "failed"
    assert "stopped" in outcome.problem
    before = set(solved)
    solved.clear()
    monkeypatch.setattr(solving._Solving, "run", lambda self: (solved.append(self._job.name), real(self))[1])
    cut, outcome = batched(monkeypatch, tmp_path, frames, rig, pieces, "cut")
    assert cut == whole
    assert before.isdisjoint(solved)


def test_a_memory_is_known_again_from_the_disk() -> None:
    rig = with_standing(replace(small_rig(2), capture=Capture(line_time_us=15.0)), 1)
    tracks = Tracks.none()
    for frame in filmed(rig, 3, standing=1):
        _, tracks = localize(frame, rig, tracks)
    again = restored(stored(tracks))
    assert mark(again, frame.exposed_ns) == mark(tracks, frame.exposed_ns)
    (here, _), (there, _) = (localize(frame, rig, memory) for memory in (tracks, again))
    assert repr(here) == repr(there)
    assert mark(tracks, frame.exposed_ns) != mark(Tracks.none(2), frame.exposed_ns)


def test_what_was_not_seen_for_long_is_no_part_of_a_memory() -> None:
    rig = small_rig(1)
    _, tracks = localize(filmed(rig, 1, hidden=0.0)[0], rig, Tracks.none())
    seen_ns = int(tracks.seen_ns[0])
    assert seen_ns > 0
    forgotten = Tracks.none(1)._replace(misfits=tracks.misfits, reasons=tracks.reasons)
    assert mark(tracks, seen_ns + 10**9) != mark(forgotten, seen_ns + 10**9)
    assert mark(tracks, seen_ns + 10**9 + 1) == mark(forgotten, seen_ns + 10**9 + 1)


def test_only_films_that_are_long_and_can_begin_anywhere_are_cut() -> None:
    least = round(LEAST_S * 60)
    assert cuts([9 * least], [None], [60.0], 2) == [WHOLE]
    assert cuts([least], [least], [60.0], 8) == [WHOLE]
    assert cuts([9 * least], [9 * least], [60.0], 1) == [WHOLE]
    (pieces,) = cuts([9 * least], [9 * least], [60.0], 2)
    assert len(pieces) == 4
    assert pieces[0][0] == 0
    assert pieces[-1][1] == 9 * least
    assert all(a[1] == b[0] for a, b in pairwise(pieces))
    assert cuts([9 * least] * 8, [9 * least] * 8, [60.0] * 8, 2) == [WHOLE] * 8
