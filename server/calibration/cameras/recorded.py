"""Rigs and the recordings of their cameras: which belongs to which, and what the recordings hold."""

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import decode_frame_report
from asterism.protocol.errors import InputError
from asterism.protocol.messages import FRAME_REPORT
from asterism.protocol.rig import Rig, Robot
from asterism.recordings.reader import Recording
from asterism.server.calibration.cameras.start import WITHIN_S
from asterism.server.calibration.cameras.views import Seen, views_of

EPOCH_S = 1e8  # times before are a film's own, from 0 on


class Pair(NamedTuple):
    """A camera's rig, where it stands, and its recording."""

    path: Path
    rig: Rig
    recording: Recording


def paired(rigs: Sequence[tuple[Path, Rig]], recordings: Sequence[Recording]) -> list[Pair]:
    """Every rig with its camera's recording, in the rigs' order.

    Raises InputError for two of one camera, a recording of another camera, a rig without a recording.
    """
    paths: dict[str, Path] = {}
    for path, rig in rigs:
        name = rig.camera.name
        if name in paths:
            raise InputError(
                f"{path}: its camera is called {name}, and so is that of {paths[name]}, expected a rig for every "
                "camera, and a camera_name of its own in each camera.yaml"
            )
        paths[name] = path
    by_camera: dict[str, Recording] = {}
    for recording in recordings:
        name = recording.rig().camera.name
        if name not in paths:
            raise InputError(
                f"{recording.path}: is of camera {name}, expected one of {', '.join(paths)}, whose rigs are given"
            )
        if name in by_camera:
            raise InputError(
                f"{recording.path}: is of camera {name}, and so is {by_camera[name].path}, expected one recording of "
                "every camera"
            )
        by_camera[name] = recording
    for name, path in paths.items():
        if name not in by_camera:
            raise InputError(f"{path}: no recording of its camera {name} is given, expected one")
    return [Pair(path, rig, by_camera[rig.camera.name]) for path, rig in rigs]


def robots_of(rigs: Sequence[Rig]) -> list[Robot]:
    """The robots of all rigs, each once, the first rig's first."""
    robots: dict[str, Robot] = {}
    for rig in rigs:
        for robot in rig.robots:
            robots.setdefault(robot.id, robot)
    return list(robots.values())


def read_all(pairs: Sequence[Pair]) -> list[Seen]:
    """What the recordings hold of the rigs' robots, on one axis of time.

    Raises InputError for a recording without frames, and for recordings that do not overlap in time.
    """
    ids = [robot.id for robot in robots_of([pair.rig for pair in pairs])]
    origin_ns = next((report.exposed_ns for report, _ in _reports(pairs[0].recording)), 0)
    seen = []
    for pair in pairs:
        each = views_of(_reports(pair.recording), pair.rig, ids, origin_ns, str(pair.recording.path))
        if not each.frames:
            raise InputError(f"{pair.recording.path}: holds no frame reports, expected what serve or locate recorded")
        seen.append(each)
    for one, other in combinations(seen, 2):
        if min(one.span_s[1], other.span_s[1]) - max(one.span_s[0], other.span_s[0]) < -WITHIN_S:
            raise InputError(
                f"recordings do not overlap in time: {one.source} is from {_when(one, origin_ns)}, {other.source} from "
                f"{_when(other, origin_ns)}; expected all cameras to have recorded the same drive"
            )
    return seen


def _reports(recording: Recording) -> "Iterator[tuple[pb.FrameReport, Rig]]":
    """Every frame report with the rig that was in force."""
    rigs = recording.rigs()
    for message in recording.messages():
        if message.kind.schema != FRAME_REPORT.schema:
            continue
        while len(rigs) > 1 and message.sequence >= rigs[1][0]:
            rigs.pop(0)
        yield decode_frame_report(message.payload), rigs[0][1]


def _when(seen: Seen, origin_ns: int) -> str:
    first, last = (origin_ns * 1e-9 + each for each in seen.span_s)
    if last < EPOCH_S:
        return f"{first:.1f} to {last:.1f} s"
    return " to ".join(f"{datetime.fromtimestamp(each, UTC):%Y-%m-%d %H:%M:%S}" for each in (first, last)) + " UTC"
