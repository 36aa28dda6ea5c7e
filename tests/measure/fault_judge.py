"""What a place of `tests.measure.faults` shows after its faults: what the client was handed, what is on the disk."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from asterism.protocol.codec import decode_frame_report
from asterism.protocol.messages import FRAME_REPORT
from asterism.protocol.rig import load_rig
from asterism.recordings.reader import Recording
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.simulation.simulate import Scene
from tests.measure.fault_place import ROBOT, Place
from tests.servers import asterism

RATE_HZ = 60
WRONG_M = 0.005
OLDEST_S = 0.3  # of what `latest(0.1)` hands out, measured from outside
STEP_S = 600.0  # the server's clock may be off by a multiple of it


class Judged(NamedTuple):
    """What was seen."""

    poses: int
    wrong: int  # more than 5 mm from the simulation's truth
    old: int  # handed out older than they may be
    tracebacks: int  # of any program
    recordings: int
    unreadable: int
    lost_s: float  # the most that a recording's end lacks of what the client was told


def judge(place: Place) -> Judged:
    """End server and client in order, and look."""
    place.server.end()
    errors = place.server.said() + place.client.end() + "".join(place.errors)
    told = [line for line in place.client.lines if "sequence" in line]
    folders = [folder for folder in place.folder.iterdir() if folder.is_dir()]
    last: dict[int, int] = {}
    unreadable = sum(not _is_readable(folder, last) for folder in folders)
    lost = [(line["exposed"] - last[line["session"]]) * 1e-9 for line in told if line["session"] in last]
    missing = {line["session"] for line in told} - set(last)
    return Judged(
        len(told),
        sum(_wrong(told)),
        sum(abs(_age_s(line)) > OLDEST_S for line in told),
        errors.count("Traceback"),
        len(folders),
        unreadable + len(missing),
        max([0.0, *lost]),
    )


def _wrong(told: list[dict[str, Any]]) -> list[bool]:
    rig = load_rig(DEMO_RIG)
    scene, T_world_camera = Scene(rig, 0), rig.T_world_camera
    assert T_world_camera is not None
    found = []
    for line in told:
        truth = scene.truth(line["sequence"], line["sequence"] / RATE_HZ)
        right = T_world_camera.map(next(t.T_camera_robot.position for t in truth if t.robot == ROBOT)[None])[0]
        found.append(bool(np.linalg.norm(np.subtract(line["position"], right)) > WRONG_M))
    return found


def _age_s(line: dict[str, Any]) -> float:
    """From exposure to the client's program, by this machine's clock."""
    off_s: float = (line["wall"] - line["exposed"]) * 1e-9
    return (off_s + STEP_S / 2) % STEP_S - STEP_S / 2


def _is_readable(folder: Path, last: dict[int, int]) -> bool:
    """Whether a recording can be recovered, and read then; the newest exposure of each session goes to ``last``."""
    try:
        assert asterism("recover", folder).returncode == 0
        for message in Recording(folder).messages():
            if message.kind.schema == FRAME_REPORT.schema:
                session = decode_frame_report(message.payload).session
                last[session] = max(last.get(session, 0), message.log_ns)
    except Exception as error:  # whatever it is, it is counted
        print(f"{folder}: {error!r}")
        return False
    return True
