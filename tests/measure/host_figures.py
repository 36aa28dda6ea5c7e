"""Figures of one phase of `tests.measure.hosts`."""

import re
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from tests.measure.host_programs import Line, Program


class Phase(NamedTuple):
    """When it began and ended (monotonic, s), how long after the fault's end things were back, by where, and what the
    robots' host received.
    """

    began: float
    ended: float
    back: dict[str, float]
    air_bytes: int


def figures(phase: Phase, observer: Program, robot: Program) -> list[str]:
    """Lines about it."""
    seen, had = observer.between(phase.began, phase.ended), robot.between(phase.began, phase.ended)
    lines = [*_frames(seen, phase), *_problems(seen)]
    lines += _robot([line for line in had if "exposed" in line], phase)
    lines += [f"robot: link {line['link']}: {line['sentence']}" for line in had if "link" in line]
    told = ", ".join(f"{name} {after:.1f} s" for name, after in phase.back.items())
    return [*lines, f"back after the fault's end: {told}"]


def _frames(seen: Sequence[Line], phase: Phase) -> list[str]:
    told = []
    for camera in sorted({line["camera"] for line in seen if "camera" in line}):
        own = [line for line in seen if line.get("camera") == camera]
        lost = sum(max(b["sequence"] - a["sequence"] - 1, 0) for a, b in pairwise(own) if _follows(a, b))
        gap = _gap([line["at"] for line in own], phase)
        told.append(f"{camera}: {len(own)} reports, {lost} lost, longest gap {gap:.2f} s")
    return told


def _follows(a: Line, b: Line) -> bool:
    return bool(a["session"] == b["session"])


def _problems(seen: Sequence[Line]) -> list[str]:
    """What statuses said, where only numbers changed the last of it."""
    told = {}
    for line in seen:
        if line.get("problem"):
            text = f"status of {line['status']}: {line['problem']}"
            told[re.sub(r"[\d.]+", "#", text)] = text
    return list(told.values())


def _robot(had: Sequence[Line], phase: Phase) -> list[str]:
    rate = phase.air_bytes / (phase.ended - phase.began)
    if not had:
        return [f"robot: no pose; {rate / 1e3:.1f} kB/s to it"]
    true, told = (1e3 * np.array([line[key] for line in had]) for key in ("true", "told"))
    p50, p99 = np.percentile(true, [50, 99])
    gap = _gap([line["at"] for line in had], phase)
    fresher, older = max((true - told).max(), 0.0), max((told - true).max(), 0.0)
    return [
        f"robot: {len(had)} poses, longest gap {gap:.2f} s; {rate / 1e3:.1f} kB/s to it",
        f"robot: age on arrival {p50:.0f} ms, 99 % {p99:.0f}, most {true.max():.0f}; told as fresher than it is by "
        f"at most {fresher:.1f} ms, as older by {older:.1f}",
    ]


def _gap(times: Sequence[float], phase: Phase) -> float:
    edges = [phase.began, *times, phase.ended]
    return max(b - a for a, b in pairwise(edges))
