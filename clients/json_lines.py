"""What arrives, as JSON lines: for programs that would rather read text than speak protobuf.

Every line is one object, and its `type` says which: `frame`, `event`, `link` or `error` (docs/clients.md).
"""

import json
import math
import queue
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from asterism.clients.angles import UP, heading_deg, tilt_deg
from asterism.clients.link_state import LinkState
from asterism.clients.received_pose import clock_ns
from asterism.clients.server_state import ServerState
from asterism.clients.servers import Servers
from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import decode_event, decode_frame_report, report_pose
from asterism.protocol.errors import InputError
from asterism.protocol.messages import Happening, State
from asterism.protocol.standing import surface_as_json

if TYPE_CHECKING:
    import zenoh

QUEUE = 1000  # lines that wait for a reader; what comes then is left out


class JsonLines:
    """Turns frame reports, events and what ``servers`` knows of the servers into lines; `next` hands them on in the
    order in which they came. Only ``robots`` are told of, none for all.
    """

    def __init__(
        self, robots: Sequence[str], prefix: str, servers: Servers, clock: Callable[[], int] = clock_ns
    ) -> None:
        self._wanted = frozenset(robots)
        self._prefix = prefix
        self._servers = servers
        self._clock = clock
        self._lines: queue.Queue[str] = queue.Queue(QUEUE)
        self._links: dict[str, LinkState] = {}  # as told last, by camera
        self.left_out = 0

    def subscribe(self, session: "zenoh.Session") -> list[object]:
        """Have a session feed the lines; keep what is returned as long as it shall."""
        return [
            session.declare_subscriber(self._prefix + keys.frame("*"), self._frame),
            session.declare_subscriber(self._prefix + keys.event("*"), self._event),
        ]

    def next(self, timeout_s: float) -> str | None:
        """The next line, or None if there is none within that time. Looks how things stand with the servers first."""
        for camera, link in self._servers.links(self._clock()).items():
            # A token comes on its own: who was never there is not gone.
            before = self._links.get(camera, LinkState.GONE)
            if before is not link.state:
                self._links[camera] = link.state
                self._put("link", camera, {"link": link.state.value, "sentence": link.sentence})
        try:
            return self._lines.get(timeout=timeout_s)
        except queue.Empty:
            return None

    def _frame(self, sample: "zenoh.Sample") -> None:
        server, now_ns = self._server(sample), self._clock()
        try:
            report = decode_frame_report(sample.payload.to_bytes())
            told = frame_as_json(report, server, self._wanted)
        except InputError as error:
            self._put("error", server.camera, {"error": str(error)})
            return
        clock = server.age(report.session)
        server.arrived(clock, report.published_ns, now_ns)
        age_s = clock.age_s(now_ns, report.exposed_ns)
        told["age_s"] = round(age_s, 6) if math.isfinite(age_s) else None
        self._put("frame", server.camera, told)

    def _event(self, sample: "zenoh.Sample") -> None:
        server = self._server(sample)
        try:
            event = decode_event(sample.payload.to_bytes())
        except InputError as error:
            self._put("error", server.camera, {"error": str(error)})
            return
        server.arrived(server.age(event.session), event.published_ns, self._clock())
        if not (self._wanted and event.robot and event.robot not in self._wanted):
            self._put("event", server.camera, event_as_json(event))

    def _server(self, sample: "zenoh.Sample") -> ServerState:
        return self._servers[str(sample.key_expr).removeprefix(self._prefix).split("/")[1]]

    def _put(self, kind: str, camera: str, told: dict[str, Any]) -> None:
        try:
            line = json.dumps({"type": kind, "camera": camera, **told}, allow_nan=False)
        except ValueError:
            line = json.dumps({"type": "error", "camera": camera, "error": f"a {kind} with numbers that are none"})
        try:
            self._lines.put_nowait(line)
        except queue.Full:
            self.left_out += 1


def frame_as_json(report: "pb.FrameReport", server: ServerState, wanted: frozenset[str]) -> dict[str, Any]:
    """One frame as `asterism locate` writes it, with angles, and velocities where there are any; ``wanted`` are the
    robots to tell of, none for all. Raises InputError for a pose that is none.
    """
    robots, lost = [], {}
    for robot in report.robots:
        if wanted and robot.id not in wanted:
            continue
        if robot.HasField("pose"):
            robots.append(_robot(robot, server, report.frame_id))
        else:
            lost[robot.id] = robot.reason
    told = {"frame": f"{report.sequence:06d}", "exposed_ns": report.exposed_ns, "session": report.session}
    return {**told, "frame_id": report.frame_id, "robots": robots, "lost": lost}


def event_as_json(event: "pb.Event") -> dict[str, Any]:
    """One event, its fields as in asterism.proto."""
    return {
        "robot": event.robot,
        "happening": Happening.Name(event.happening),
        "before": State.Name(event.before),
        "state": State.Name(event.state),
        "reason": event.reason,
        "since_ns": event.since_ns,
        "lasted_s": event.lasted_s,
        "sequence": event.sequence,
        "session": event.session,
        "number": event.number,
        "left_out": event.left_out,
    }


def _robot(robot: "pb.RobotReport", server: ServerState, frame_id: str) -> dict[str, Any]:
    turn = report_pose(robot.pose).rotation
    alternative = None
    if robot.HasField("alternative"):
        alternative = {**_pose(robot.alternative.pose), "odds": robot.alternative.odds}
    told: dict[str, Any] = {
        "id": robot.id,
        "state": State.Name(robot.state) if robot.state in State.values() else robot.state,
        **_pose(robot.pose),
        "covariance": list(robot.covariance),
        "leds": robot.leds,
        "rms_px": robot.rms_px,
        "alternative": alternative,
        "heading_deg": round(heading_deg(turn), 4),
        "tilt_deg": round(tilt_deg(turn, server.axes.get(robot.id, UP), frame_id), 4),
    }
    if robot.smoothed_by:
        told |= {"smoothed": True, "filter": robot.smoothed_by}
    if robot.HasField("velocity"):
        v, w = robot.velocity.linear, robot.velocity.angular
        covariance = list(robot.velocity.covariance)
        told["velocity"] = {"linear": [v.x, v.y, v.z], "angular": [w.x, w.y, w.z], "covariance": covariance}
    if robot.extrapolated:
        told["extrapolated"] = True
    if robot.HasField("surface"):
        told["surface"] = surface_as_json(robot.surface)
    return told


def _pose(pose: "pb.Pose") -> dict[str, list[float]]:
    p, q = pose.position, pose.orientation
    return {"position": [p.x, p.y, p.z], "orientation": [q.x, q.y, q.z, q.w]}
