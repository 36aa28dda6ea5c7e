"""What a film's lines tell: frames, states, residuals of every robot; and how that differs from an earlier batch."""

import math
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import msgspec
import numpy as np

from asterism.protocol.errors import InputError


class Robot(msgspec.Struct):
    """A robot in a film: in how many frames in which state, the median of its residuals (px), why it was lost."""

    states: dict[str, int] = {}
    rms_px: float | None = None
    reasons: dict[str, int] = {}

    def found(self, frames: int) -> float:
        """The share of the frames in which it has a pose."""
        return sum(self.states.get(state, 0) for state in LOCATED) / frames if frames else 0.0


class Change(msgspec.Struct):
    """A robot in two batches: found in how many frames of the ``frames`` that both have, other state, positions and
    rotations beyond the tolerances, the largest differences in m and rad.
    """

    frames: int = 0
    found_before: int = 0
    found: int = 0
    other_state: int = 0
    beyond: int = 0
    most_m: float = 0.0
    most_rad: float = 0.0

    @property
    def is_none(self) -> bool:
        """Whether nothing differs beyond the tolerances."""
        return self.found_before == self.found and not self.other_state and not self.beyond


class Changes(msgspec.Struct):
    """A film in two batches: frames that only one of them has, and what became of every robot."""

    only_before: int = 0
    only_now: int = 0
    robots: dict[str, Change] = {}

    @property
    def is_none(self) -> bool:
        """Whether nothing differs beyond the tolerances."""
        return not (self.only_before or self.only_now) and all(robot.is_none for robot in self.robots.values())


class _Pose(msgspec.Struct):
    id: str
    state: str
    position: tuple[float, float, float]
    orientation: tuple[float, float, float, float]
    rms_px: float


class _Line(msgspec.Struct):
    frame: str
    exposed_ns: int
    robots: list[_Pose]
    lost: dict[str, str]


LOCATED = ("TRACKED", "TILT_AMBIGUOUS")
AMBIGUOUS = "IDENTITY_AMBIGUOUS"
_DECODER = msgspec.json.Decoder(_Line)


class Counting:
    """Counts lines as they pass."""

    def __init__(self, robots: list[str]) -> None:
        self.frames = 0
        self._states: dict[str, Counter[str]] = {robot: Counter() for robot in robots}
        self._reasons: dict[str, Counter[str]] = {robot: Counter() for robot in robots}
        self._rms: dict[str, list[float]] = {robot: [] for robot in robots}

    def add(self, data: bytes) -> None:
        """One line."""
        told = _DECODER.decode(data)
        self.frames += 1
        for robot in told.robots:
            self._states[robot.id][robot.state] += 1
            self._rms[robot.id].append(robot.rms_px)
        for robot_id, reason in told.lost.items():
            self._states[robot_id]["LOST"] += 1
            self._reasons[robot_id][reason] += 1

    def robots(self) -> dict[str, Robot]:
        """What was counted."""
        return {
            robot: Robot(
                dict(states),
                float(np.median(self._rms[robot])) if self._rms[robot] else None,
                dict(self._reasons[robot].most_common(5)),
            )
            for robot, states in self._states.items()
        }


def changes(before: Path, now: Path, position_m: float, rotation_rad: float) -> Changes:
    """What changed from one file of lines to another; frames belong together by time and name.

    Raises InputError for a file that holds other lines.
    """
    told, robots = Changes(), dict[str, Change]()
    old = {(line.exposed_ns, line.frame): line for line in _lines(before)}
    for line in _lines(now):
        there = old.pop((line.exposed_ns, line.frame), None)
        if there is None:
            told.only_now += 1
            continue
        states = _states(there), _states(line)
        poses = ({pose.id: pose for pose in one.robots} for one in (there, line))
        first, second = poses
        for robot in sorted(states[0].keys() | states[1].keys()):
            change = robots.setdefault(robot, Change())
            change.frames += 1
            change.found_before += robot in first
            change.found += robot in second
            change.other_state += states[0].get(robot) != states[1].get(robot)
            if robot in first and robot in second:
                _compare(change, first[robot], second[robot], (position_m, rotation_rad))
    told.only_before, told.robots = len(old), robots
    return told


def _compare(change: Change, a: _Pose, b: _Pose, tolerances: tuple[float, float]) -> None:
    away = float(np.linalg.norm(np.subtract(a.position, b.position)))
    # By the chord: of small angles the cosine keeps no digit.
    p, q = np.array(a.orientation), np.array(b.orientation)
    chord = min(float(np.linalg.norm(p - q)), float(np.linalg.norm(p + q)))
    turned = 4.0 * math.asin(min(0.5 * chord, 1.0))
    change.most_m, change.most_rad = max(change.most_m, away), max(change.most_rad, turned)
    change.beyond += away > tolerances[0] or turned > tolerances[1]


def _states(line: _Line) -> dict[str, str]:
    return {pose.id: pose.state for pose in line.robots} | dict.fromkeys(line.lost, "LOST")


def _lines(path: Path) -> Iterator[_Line]:
    with path.open("rb") as file:
        yield from _decoded(file, path)


def _decoded(file: BinaryIO, path: Path) -> Iterator[_Line]:
    for number, data in enumerate(file, 1):
        try:
            yield _DECODER.decode(data)
        except msgspec.DecodeError as error:
            raise InputError(f"{path}, line {number}: {error}; expected what asterism locate writes") from None
