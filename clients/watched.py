"""What arrives for the live table: every robot's newest report, every server's health, whom nobody knows."""

import difflib
import math
import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, TypeVar

from rich.text import Text

from asterism.clients import layout
from asterism.clients.age import SessionAge
from asterism.clients.angles import UP, heading_deg, tilt_deg
from asterism.clients.layout import Row, printable
from asterism.clients.link_state import Link, LinkState
from asterism.clients.received_pose import clock_ns
from asterism.clients.server_state import ServerState
from asterism.clients.servers import Servers
from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import decode_beat, decode_frame_report, decode_status, report_pose
from asterism.protocol.errors import InputError
from asterism.protocol.messages import Standing, State
from asterism.protocol.standing import standing_name

if TYPE_CHECKING:
    import zenoh

T = TypeVar("T")

STALE_NS = 1_000_000_000
FORGOTTEN_NS = 60_000_000_000  # a camera that is silent for so long leaves the table
MOST_CAMERAS = 32
SOURCE_CELLS = 32


@dataclass(slots=True)
class _Robot:
    row: Row  # of the newest frame
    exposed_ns: int = 0  # of the newest with a pose
    clock: SessionAge | None = None  # of that one's session; None before there is one
    times: deque[int] = field(default_factory=lambda: deque(maxlen=120))


@dataclass(slots=True)
class _Camera:
    heard_ns: int
    at_ns: int | None = None  # of its newest frame
    robots: dict[str, _Robot] = field(default_factory=dict)
    known: set[str] = field(default_factory=set)  # the robots of its rig
    status: "pb.Status | None" = None


class RobotTable:
    """Collects frame reports and status messages, and lays them out. Safe to feed from zenoh's threads.

    A frame report lists all of a rig's robots: those that are in it no more are forgotten at once, a camera after a
    minute without a message. Ages are by the servers' own clocks, as a PoseClient's are; ``servers`` holds what is
    known of those. ``clock`` is this machine's own, ns.
    """

    def __init__(self, robots: Sequence[str] = (), prefix: str = "", clock: Callable[[], int] = clock_ns) -> None:
        self._wanted = tuple(dict.fromkeys(robots))
        self._prefix = prefix
        self._clock = clock
        self.servers = Servers("")
        self._lock = threading.Lock()
        self._cameras: dict[str, _Camera] = {}
        self.nothing = "no frame has arrived yet" + ("" if prefix else "; a replay is watched with --prefix replay/")
        self._refused = ""  # the newest message that could not be read

    def subscribe(self, session: "zenoh.Session") -> list[object]:
        """Have a session feed the table; keep what is returned as long as it shall."""
        return [
            session.declare_subscriber(self._prefix + keys.frame("*"), self._frame),
            session.declare_subscriber(self._prefix + keys.status("*"), self._health),
            *self.follow_servers(session),
        ]

    def follow_servers(self, session: "zenoh.Session") -> list[object]:
        """The same for what tells whether servers live, alone."""
        return [
            session.declare_subscriber(self._prefix + keys.beat("*"), self._beat),
            session.liveliness().declare_subscriber(self._prefix + keys.alive("*"), self._shows, history=True),
        ]

    def _frame(self, sample: "zenoh.Sample") -> None:
        report = self._read(decode_frame_report, sample)
        if report is None:
            return
        now_ns = self._clock()
        server = self.servers[self._name(sample)]
        clock = server.age(report.session)
        server.arrived(clock, report.published_ns, now_ns)
        with self._lock:
            camera = self._camera(sample, now_ns)
            try:
                rows = [_row(server, robot, report.frame_id) for robot in report.robots]
            except InputError as error:
                self._refused = f"{sample.key_expr}: {error}; ignored"
                return
            camera.at_ns, camera.known = now_ns, {row.robot for row in rows}
            before, camera.robots = camera.robots, {}
            for row in rows:
                if not self._wanted or row.robot in self._wanted:
                    robot = before.get(row.robot) or _Robot(row)
                    camera.robots[row.robot] = robot
                    robot.row = row
                    if row.position_mm is not None:
                        robot.exposed_ns, robot.clock = report.exposed_ns, clock
                        robot.times.append(now_ns)

    def _health(self, sample: "zenoh.Sample") -> None:
        status = self._read(decode_status, sample)
        if status is not None:
            with self._lock:
                self._camera(sample, self._clock()).status = status

    def _beat(self, sample: "zenoh.Sample") -> None:
        beat = self._read(decode_beat, sample)
        if beat is not None:
            self.servers[self._name(sample)].beats(beat, self._clock())

    def _shows(self, sample: "zenoh.Sample") -> None:
        import zenoh

        self.servers[self._name(sample)].shows(sample.kind == zenoh.SampleKind.PUT, self._clock())

    def _read(self, decode: Callable[[bytes], T], sample: "zenoh.Sample") -> T | None:
        """The message, or None for one that is none: then the table says so."""
        try:
            return decode(sample.payload.to_bytes())
        except InputError as error:
            with self._lock:
                self._refused = f"{sample.key_expr}: {error}; ignored"
            return None

    def _name(self, sample: "zenoh.Sample") -> str:
        return str(sample.key_expr).removeprefix(self._prefix).split("/")[1]

    def _camera(self, sample: "zenoh.Sample", now_ns: int) -> _Camera:
        """The camera that a message is about, heard of now; called under the lock."""
        name = self._name(sample)
        camera = self._cameras.setdefault(name, _Camera(now_ns))
        camera.heard_ns = now_ns
        if len(self._cameras) > MOST_CAMERAS:
            del self._cameras[min(self._cameras, key=lambda other: self._cameras[other].heard_ns)]
        return camera

    def mistyped(self) -> str:
        """A sentence about the robots asked for that no rig here has, or nothing while no rig is known."""
        with self._lock:
            told = [camera.known for camera in self._cameras.values()]
        known = sorted(set().union(*told, *(server.points for server in self.servers.all())))
        unknown = [robot for robot in self._wanted if robot not in known]
        if not unknown or not known:
            return ""
        sentences = []
        for robot in unknown:
            near = difflib.get_close_matches(robot, known, n=1, cutoff=0.5)
            hint = f"did you mean '{near[0]}'? There" if near else "there"
            sentences.append(f"no rig here has a robot '{robot}'; {hint} are: {', '.join(known)}")
        return printable(". ".join(sentences))

    def rows(self) -> list[Row]:
        """What is to be shown now, by camera and robot."""
        now_ns = self._clock()
        with self._lock:
            for name in [name for name, camera in self._cameras.items() if now_ns - camera.heard_ns > FORGOTTEN_NS]:
                del self._cameras[name]
            return [
                _aged(robot, camera, now_ns)
                for _, camera in sorted(self._cameras.items())
                for _, robot in sorted(camera.robots.items())
            ]

    def lines(self) -> list[str]:
        """The table as plain text, for terminals that cannot redraw."""
        lines = [line.plain for line in layout.table(rows, 1000)[1:]] if (rows := self.rows()) else []
        return [*lines, *(note for note in (self.mistyped(), printable(self._refused)) if note)]

    def draw(self, width: int) -> Text:
        """The table as it is now, in at most ``width`` cells."""
        rows, mistyped = self.rows(), self.mistyped()
        lines = layout.table(rows, width) if rows else [Text(self.nothing, style="dim")] if not mistyped else []
        now_ns = self._clock()
        with self._lock:
            for name, camera in sorted(self._cameras.items()):
                lines += _server_lines(name, camera.status, self.servers[name].link(now_ns), width)
        notes = (mistyped, printable(self._refused))
        return Text("\n").join([*lines, *(Text(note, style="red") for note in notes if note)])


def _server_lines(name: str, status: "pb.Status | None", link: Link, width: int) -> list[Text]:
    """What is to be said of a server: that its poses are late or come no more, else how it does."""
    if link.state is not LinkState.LIVE:
        return [Text(printable(link.sentence), style="red")]
    if status is None:
        return []
    shown = printable(name)
    text = layout.joined(
        (
            f"{shown} ({layout.shorten(printable(status.source), SOURCE_CELLS)}): {status.rate_hz:.0f} frames/s",
            f"solve {1e3 * status.solve_p50_s:.1f} ms",
            f"latency {1e3 * status.latency_p50_s:.1f} ms (p99 {1e3 * status.latency_p99_s:.1f})",
            f"dropped {status.frames_dropped}",
            f"not recorded {status.frames_not_recorded}",
        ),
        width,
    )
    if status.problem:
        return [Text(f"{text}\n{printable(status.problem)}", style="red")]
    return [Text(text, style="dim")]


def _row(server: ServerState, robot: "pb.RobotReport", frame_id: str) -> Row:
    """A robot as its report has it. Raises InputError for a report that no server of ours makes."""
    if robot.state not in State.values():
        raise InputError(f"robot {robot.id[:40]!r}: state {robot.state}, expected one of {', '.join(State.keys()[1:])}")
    row = Row(printable(server.camera), robot.id, State.Name(robot.state), printable(robot.reason))
    if not robot.HasField("pose"):
        return row
    try:
        pose = report_pose(robot.pose)
    except InputError as error:
        raise InputError(f"robot {robot.id[:40]!r}: {error}") from None
    (x, y, z), turn = (1e3 * pose.position).tolist(), pose.rotation
    moves = robot.velocity if robot.HasField("velocity") else None
    return replace(
        row,
        position_mm=(x, y, z),
        heading_deg=heading_deg(turn),
        tilt_deg=tilt_deg(turn, server.axes.get(robot.id, UP), frame_id),
        leds=robot.leds,
        rms_px=robot.rms_px,
        speed_mm_s=None if moves is None else 1e3 * _length(moves.linear),
        turning_deg_s=None if moves is None else math.degrees(_length(moves.angular)),
        surface=_standing(robot.surface) if robot.HasField("surface") else "",
    )


def _standing(told: "pb.OnSurface") -> str:
    """As the table shows it: on the surface, or how it is off."""
    if told.standing == Standing.ON_SURFACE:
        return layout.ON
    name = standing_name(told.standing).lower()
    if told.standing in (Standing.LIFTED, Standing.SUNK) and math.isfinite(told.off_m):
        return f"{name} {1e3 * abs(told.off_m):.1f} mm"
    if told.standing == Standing.TILTED and math.isfinite(told.tilt_off_rad):
        return f"{name} {math.degrees(told.tilt_off_rad):.1f}°"
    return name


def _length(vector: "pb.Vector3") -> float:
    return math.hypot(vector.x, vector.y, vector.z)


def _aged(robot: _Robot, camera: _Camera, now_ns: int) -> Row:
    """The row as time has made it: the age of the newest pose, the rate of the last second."""
    age_s = math.inf if robot.clock is None else robot.clock.age_s(now_ns, robot.exposed_ns)
    silent = camera.at_ns is None or now_ns - camera.at_ns > STALE_NS
    return replace(
        robot.row,
        robot=printable(robot.row.robot),
        state="NO FRAMES" if silent else robot.row.state,
        age_s=age_s if math.isfinite(age_s) else None,
        rate_hz=sum(1 for moment in robot.times if now_ns - moment <= STALE_NS),
    )
