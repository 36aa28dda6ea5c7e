"""What arrives for the live table: every robot's newest report, every server's health, whom nobody knows."""

import difflib
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, TypeVar

from rich.text import Text

from asterism.clients import layout
from asterism.clients.layout import Row, printable
from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import decode_frame_report, decode_rig, decode_status, report_pose
from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats
from asterism.protocol.messages import State

if TYPE_CHECKING:
    import zenoh

T = TypeVar("T")

STALE_S = 1.0
FORGOTTEN_S = 60.0  # a camera that is silent for so long leaves the table
MOST_CAMERAS = 32
SOURCE_CELLS = 32


@dataclass(slots=True)
class _Robot:
    row: Row  # of the newest frame
    seen: Row | None = None  # the newest with a pose
    seen_at_s: float = 0.0
    times: deque[float] = field(default_factory=lambda: deque(maxlen=120))


@dataclass(slots=True)
class _Camera:
    heard_s: float
    at_s: float = -math.inf  # of its newest frame
    robots: dict[str, _Robot] = field(default_factory=dict)
    known: set[str] = field(default_factory=set)  # the robots of its rig
    status: "pb.Status | None" = None
    status_at_s: float = -math.inf


class RobotTable:
    """Collects frame reports and status messages, and lays them out. Safe to feed from zenoh's threads.

    A frame report lists all of a rig's robots: those that are in it no more are forgotten at once, a camera after a
    minute without a message. ``clock`` is monotonic, s.
    """

    def __init__(
        self, robots: Sequence[str] = (), prefix: str = "", clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._wanted = tuple(dict.fromkeys(robots))
        self._prefix = prefix
        self._clock = clock
        self._lock = threading.Lock()
        self._cameras: dict[str, _Camera] = {}
        self.nothing = "no frame has arrived yet" + ("" if prefix else "; a replay is watched with --prefix replay/")
        self._refused = ""  # the newest message that could not be read

    def subscribe(self, session: "zenoh.Session") -> list[object]:
        """Have a session feed the table; keep what is returned as long as it shall."""
        return [
            session.declare_subscriber(self._prefix + keys.frame("*"), self._frame),
            session.declare_subscriber(self._prefix + keys.status("*"), self._health),
        ]

    def ask_who_is_known(self, session: "zenoh.Session") -> None:
        """Ask the servers for their rigs, if robots were named of which nobody has told; the answers come by and by."""

        def answered(reply: "zenoh.Reply") -> None:
            if reply.ok is not None:
                self._rig(reply.ok)

        if self._unknown():
            session.get(self._prefix + keys.rig("*"), answered)

    def _frame(self, sample: "zenoh.Sample") -> None:
        report = self._read(decode_frame_report, sample)
        if report is None:
            return
        now = self._clock()
        with self._lock:
            camera = self._camera(sample, now)
            try:
                rows = [_row(self._name(sample), report, robot) for robot in report.robots]
            except InputError as error:
                self._refused = f"{sample.key_expr}: {error}; ignored"
                return
            camera.at_s, camera.known = now, {row.robot for row in rows}
            before, camera.robots = camera.robots, {}
            for row in rows:
                if not self._wanted or row.robot in self._wanted:
                    robot = before.get(row.robot) or _Robot(row)
                    camera.robots[row.robot] = robot
                    robot.row = row
                    if row.position_mm is not None:
                        robot.seen, robot.seen_at_s = row, now
                        robot.times.append(now)

    def _health(self, sample: "zenoh.Sample") -> None:
        status = self._read(decode_status, sample)
        if status is not None:
            with self._lock:
                camera = self._camera(sample, self._clock())
                camera.status, camera.status_at_s = status, self._clock()

    def _rig(self, sample: "zenoh.Sample") -> None:
        rig = self._read(decode_rig, sample)
        if rig is not None:
            with self._lock:
                self._camera(sample, self._clock()).known = {robot.id for robot in rig.robots}

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

    def _camera(self, sample: "zenoh.Sample", now: float) -> _Camera:
        """The camera that a message is about, heard of now; called under the lock."""
        name = self._name(sample)
        camera = self._cameras.setdefault(name, _Camera(now))
        camera.heard_s = now
        if len(self._cameras) > MOST_CAMERAS:
            del self._cameras[min(self._cameras, key=lambda other: self._cameras[other].heard_s)]
        return camera

    def _unknown(self) -> list[str]:
        """The robots asked for that no rig has which we know of."""
        with self._lock:
            known = set().union(*(camera.known for camera in self._cameras.values()))
        return [robot for robot in self._wanted if robot not in known]

    def mistyped(self) -> str:
        """A sentence about the robots asked for that no rig here has, or nothing while no rig is known."""
        unknown = self._unknown()
        with self._lock:
            known = sorted(set().union(*(camera.known for camera in self._cameras.values())))
        if not unknown or not known:
            return ""
        sentences = []
        for robot in unknown:
            near = difflib.get_close_matches(robot, known, n=1, cutoff=0.5)
            hint = f"did you mean '{near[0]}'? " if near else ""
            sentences.append(f"no rig here has a robot '{robot}'; {hint}There are: {', '.join(known)}")
        return printable(". ".join(sentences))

    def rows(self) -> list[Row]:
        """What is to be shown now, by camera and robot."""
        now = self._clock()
        with self._lock:
            for name in [name for name, camera in self._cameras.items() if now - camera.heard_s > FORGOTTEN_S]:
                del self._cameras[name]
            return [
                _aged(robot, camera, now)
                for _, camera in sorted(self._cameras.items())
                for _, robot in sorted(camera.robots.items())
            ]

    def lines(self) -> list[str]:
        """The table as plain text, for terminals that cannot redraw."""
        lines = [line.plain for line in layout.table(rows, 1000)[1:]] if (rows := self.rows()) else []
        return [*lines, *(note for note in (self.mistyped(), printable(self._refused)) if note)]

    def draw(self, width: int) -> Text:
        """The table as it is now, in at most ``width`` cells."""
        rows = self.rows()
        lines = layout.table(rows, width) if rows else [Text(self.nothing, style="dim")]
        with self._lock:
            lines += [
                _status_line(name, camera, self._clock() - camera.status_at_s > 3 * STALE_S, width)
                for name, camera in sorted(self._cameras.items())
                if camera.status is not None
            ]
        notes = (self.mistyped(), printable(self._refused))
        return Text("\n").join([*lines, *(Text(note, style="red") for note in notes if note)])


def _status_line(name: str, camera: _Camera, silent: bool, width: int) -> Text:
    status, shown = camera.status, printable(name)
    assert status is not None
    if silent:
        return Text(f"{shown}: the server is silent", style="red")
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
        return Text(f"{text}\n{printable(status.problem)}", style="red")
    return Text(text, style="dim")


def _row(camera: str, report: "pb.FrameReport", robot: "pb.RobotReport") -> Row:
    """A robot as its report has it. Raises InputError for a report that no server of ours makes."""
    if robot.state not in State.values():
        raise InputError(f"robot {robot.id[:40]!r}: state {robot.state}, expected one of {', '.join(State.keys()[1:])}")
    row = Row(printable(camera), robot.id, State.Name(robot.state), printable(robot.reason))
    if not robot.HasField("pose"):
        return row
    try:
        pose = report_pose(robot.pose)
    except InputError as error:
        raise InputError(f"robot {robot.id[:40]!r}: {error}") from None
    (x, y, z), turn = (1e3 * pose.position).tolist(), pose.rotation
    return replace(
        row,
        age_s=(report.published_ns - report.exposed_ns) * 1e-9,
        position_mm=(x, y, z),
        heading_deg=math.degrees(math.atan2(turn[1, 0], turn[0, 0])),
        tilt_deg=math.degrees(_tilt(turn)),
        leds=robot.leds,
        rms_px=robot.rms_px,
    )


def _tilt(turn: Floats) -> float:
    """Angle in rad between the robot's z axis and the vertical of the parent frame (either way up)."""
    return math.acos(min(abs(float(turn[2, 2])), 1.0))


def _aged(robot: _Robot, camera: _Camera, now: float) -> Row:
    """The row as time has made it: the age of the newest pose, the rate of the last second."""
    age_s = None
    if robot.seen is not None and robot.seen.age_s is not None:
        age_s = robot.seen.age_s + now - robot.seen_at_s
    silent = now - camera.at_s > STALE_S
    return replace(
        robot.row,
        robot=printable(robot.row.robot),
        state="NO FRAMES" if silent else robot.row.state,
        age_s=age_s,
        rate_hz=sum(1 for moment in robot.times if now - moment <= 1.0),
    )
