"""Frames as JSON lines, as they arrive: for programs that would rather read text than speak protobuf."""

import json
import queue
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import decode_frame_report
from asterism.protocol.errors import InputError
from asterism.protocol.messages import State

if TYPE_CHECKING:
    import zenoh

QUEUE = 1000  # frames that wait for a reader of the lines; what comes then is left out


class JsonLines:
    """Turns frame reports into lines; `next` hands them on in the order in which they came."""

    def __init__(self, robots: Sequence[str] = (), prefix: str = "") -> None:
        self._wanted = frozenset(robots)
        self._prefix = prefix
        self._lines: queue.Queue[str] = queue.Queue(QUEUE)
        self.left_out = 0

    def subscribe(self, session: "zenoh.Session") -> list[object]:
        """Have a session feed the lines; keep what is returned as long as it shall."""
        return [session.declare_subscriber(self._prefix + keys.frame("*"), self._frame)]

    def next(self, timeout_s: float) -> str | None:
        """The next line, or None if there is none within that time."""
        try:
            return self._lines.get(timeout=timeout_s)
        except queue.Empty:
            return None

    def _frame(self, sample: "zenoh.Sample") -> None:
        camera = str(sample.key_expr).removeprefix(self._prefix).split("/")[1]
        try:
            told = as_json(camera, decode_frame_report(sample.payload.to_bytes()), self._wanted)
        except InputError as error:
            told = {"camera": camera, "error": str(error)}
        try:
            self._lines.put_nowait(json.dumps(told))
        except queue.Full:
            self.left_out += 1


def as_json(camera: str, report: "pb.FrameReport", wanted: frozenset[str]) -> dict[str, Any]:
    """One frame as `asterism locate` writes it, and the camera; ``wanted`` are the robots to tell of, none for all."""
    robots, lost = [], {}
    for robot in report.robots:
        if wanted and robot.id not in wanted:
            continue
        if not robot.HasField("pose"):
            lost[robot.id] = robot.reason
            continue
        alternative = None
        if robot.HasField("alternative"):
            alternative = {**_pose(robot.alternative.pose), "odds": robot.alternative.odds}
        told = {
            "id": robot.id,
            "state": State.Name(robot.state) if robot.state in State.values() else robot.state,
            **_pose(robot.pose),
            "covariance": list(robot.covariance),
            "leds": robot.leds,
            "rms_px": robot.rms_px,
            "alternative": alternative,
        }
        if robot.smoothed_by:
            told |= {"smoothed": True, "filter": robot.smoothed_by}
        if robot.extrapolated:
            told["extrapolated"] = True
        robots.append(told)
    frame = f"{report.sequence:06d}"
    return {"camera": camera, "frame": frame, "exposed_ns": report.exposed_ns, "robots": robots, "lost": lost}


def _pose(pose: "pb.Pose") -> dict[str, list[float]]:
    p, q = pose.position, pose.orientation
    return {"position": [p.x, p.y, p.z], "orientation": [q.x, q.y, q.z, q.w]}
