"""Recordings to join into one map: those of one surface, none of which tells of a robot what another tells as well."""

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

from asterism.protocol.errors import InputError
from asterism.protocol.keys import FUSED
from asterism.protocol.messages import FRAME_REPORT
from asterism.protocol.program import typed
from asterism.recordings.chunk_bytes import indexed
from asterism.recordings.reader import Recording
from asterism.recordings.tape import Span, recordings_in
from asterism.server.coverage.recorded import Part
from asterism.server.coverage.working import refuse_idle, same_surface, working


class Day(NamedTuple):
    """A recording of ``camera``: its files with who works by their rigs, and when that was."""

    path: Path
    camera: str
    parts: tuple[Part, ...]
    span: Span

    @property
    def robots(self) -> set[str]:
        """That work in it."""
        return {robot for part in self.parts for robot in part.tools}


def days_of(folders: Sequence[Path], radius_m: float | None) -> tuple[list[Day], list[Day]]:
    """The recordings, and those in folders that hold recordings, in the order of time; and those that were passed
    over, cameras' own where what was joined of them is there as well.

    Raises InputError for what is no recording, is damaged, or has no surface with robots on it; where surfaces or tools
    differ; and for two that saw the same robot at the same time.
    """
    paths = sorted({path.resolve(): path for folder in folders for path in recordings_in(folder)}.items())
    days = sorted((_day(path, radius_m) for _, path in paths), key=lambda day: (day.span, day.path))
    joined = [day for day in days if day.camera == FUSED]
    passed = [day for day in days if day not in joined and any(_meet(day, other) for other in joined)]
    kept = [day for day in days if day not in passed]
    for one, other in combinations(kept, 2):
        _refuse_twice(one, other)
    _refuse_unlike([(day, part) for day in kept for part in day.parts])
    return kept, passed


def _day(path: Path, radius_m: float | None) -> Day:
    recording, parts, spans = Recording(path), [], []
    for file, rig in recording.files():
        refuse_idle(rig, str(path))
        found, index = working(rig, radius_m), indexed(file)
        assert found is not None
        parts.append(Part(index, found.surface, found.tools, found.looked))
        spans += [index.span_ns] if index.span_ns is not None else []
    if not any(FRAME_REPORT.schema in part.file.channels.values() for part in parts) or not spans:
        raise InputError(
            f"{path}: holds no frame reports, expected a recording in which frames were solved; "
            f"{typed('locate', 'RIG', path)} --record DIR solves its images"
        )
    span = Span(min(first for first, _ in spans), max(last for _, last in spans))
    return Day(path, recording.rig().camera.name, tuple(parts), span)


def _meet(one: Day, other: Day) -> bool:
    """Whether both may have seen the same robot at the same time."""
    return one.span.meets(other.span) and bool(one.robots & other.robots)


def _refuse_twice(one: Day, other: Day) -> None:
    if not _meet(one, other):
        return
    robot = min(one.robots & other.robots)
    if one.camera == other.camera:
        raise InputError(
            f"{one.path} ({one.span}) and {other.path} ({other.span}) are both of camera '{one.camera}' at the same "
            "time, expected every recording once"
        )
    raise InputError(
        f"{one.path} and {other.path} both tell of '{robot}' at the same time, which would count twice; join what the "
        f"cameras saw first, and give what that records: {typed('fuse', one.path, other.path)} --record DIR"
    )


def _refuse_unlike(told: list[tuple[Day, Part]]) -> None:
    radii: dict[str, tuple[float, Path]] = {}
    for day, part in told:
        if not same_surface(told[0][1].surface, part.surface):
            raise InputError(
                f"{told[0][0].path} and {day.path}: the surfaces of their rigs differ, expected recordings of one "
                "surface, described by the same `surface`"
            )
        for robot, tool in part.tools.items():
            radius, path = radii.setdefault(robot, (tool.radius_m, day.path))
            if radius != tool.radius_m:
                raise InputError(
                    f"{path} and {day.path}: the tool of '{robot}' has a radius of {radius:g} m in one and of "
                    f"{tool.radius_m:g} m in the other, expected one; --tool-radius METRES says it for all"
                )
