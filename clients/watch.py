"""A live table of every robot: where it is, how old that is, how it is doing."""

import contextlib
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import decode_frame_report, decode_status, report_pose
from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats
from asterism.protocol.messages import State
from asterism.protocol.network import DEFAULT_ENDPOINT, check_endpoint, client_config

if TYPE_CHECKING:
    import zenoh

T = TypeVar("T")

REFRESH_HZ = 5
PLAIN_EVERY_S = 2.0
STALE_S = 1.0
_STYLES = {"TRACKED": "green", "TILT_AMBIGUOUS": "yellow", "IDENTITY_AMBIGUOUS": "magenta", "LOST": "red"}


@dataclass(slots=True)
class _Row:
    report: "pb.RobotReport"
    camera: str
    seen: "pb.RobotReport | None" = None  # the newest with a pose
    seen_age_s: float = 0.0  # of that pose when it arrived
    seen_at_s: float = 0.0
    at_s: float = 0.0
    times: deque[float] = field(default_factory=lambda: deque(maxlen=120))


class RobotTable:
    """Collects frame reports and status messages, and draws them. Safe to feed from zenoh's threads."""

    def __init__(self, robots: Sequence[str] = (), prefix: str = "") -> None:
        self._wanted = set(robots)
        self._prefix = prefix
        self._lock = threading.Lock()
        self._rows: dict[tuple[str, str], _Row] = {}
        self._status: dict[str, tuple[pb.Status, float]] = {}
        self._refused = ""  # the newest message that could not be read

    def subscribe(self, session: "zenoh.Session") -> list[object]:
        """Have a session feed the table; keep what is returned as long as it shall."""
        return [
            session.declare_subscriber(self._prefix + keys.frame("*"), self._frame),
            session.declare_subscriber(self._prefix + keys.status("*"), self._health),
        ]

    def _frame(self, sample: "zenoh.Sample") -> None:
        camera = str(sample.key_expr).removeprefix(self._prefix).split("/")[1]
        report = self._read(decode_frame_report, sample)
        if report is None:
            return
        now = time.monotonic()
        with self._lock:
            for robot in report.robots:
                if self._wanted and robot.id not in self._wanted:
                    continue
                row = self._rows.setdefault((camera, robot.id), _Row(robot, camera))
                row.report = robot
                row.at_s = now
                if robot.HasField("pose"):
                    row.seen = robot
                    row.seen_age_s = (report.published_ns - report.exposed_ns) * 1e-9
                    row.seen_at_s = now
                    row.times.append(now)

    def _health(self, sample: "zenoh.Sample") -> None:
        camera = str(sample.key_expr).removeprefix(self._prefix).split("/")[1]
        status = self._read(decode_status, sample)
        if status is not None:
            with self._lock:
                self._status[camera] = (status, time.monotonic())

    def _read(self, decode: Callable[[bytes], T], sample: "zenoh.Sample") -> T | None:
        """The message, or None for one that is none: then the table says so."""
        try:
            return decode(sample.payload.to_bytes())
        except InputError as error:
            with self._lock:
                self._refused = f"{sample.key_expr}: {error}; ignored"
            return None

    def lines(self) -> list[str]:
        """The table as plain text, for terminals that cannot redraw."""
        with self._lock:
            rows = [" ".join(self._cells(row)[0]).rstrip() for _, row in sorted(self._rows.items())]
            return [*rows, self._refused] if self._refused else rows

    def draw(self) -> RenderableType:
        """The table as it is now."""
        table = Table(expand=False, header_style="bold", box=None, padding=(0, 1))
        for name in (
            "robot",
            "state",
            "x mm",
            "y mm",
            "z mm",
            "heading °",
            "tilt °",
            "LEDs",
            "rms px",
            "Hz",
            "age",
            "why",
        ):
            left = name in ("robot", "state", "why")
            table.add_column(name, justify="left" if left else "right", no_wrap=name != "why")
        with self._lock:
            for _, row in sorted(self._rows.items()):
                cells, style = self._cells(row)
                texts = [Text(cell) for cell in cells]
                texts[1].stylize(style)
                table.add_row(*texts)
            lines = [self._status_line(camera) for camera in sorted(self._status)]
            if self._refused:
                lines.append(Text(self._refused, style="red"))
            empty = not self._rows
        if empty:
            return Group(Text("no frame has arrived yet", style="dim"), *lines)
        return Group(table, *lines)

    def _cells(self, row: _Row) -> tuple[list[str], str]:
        now = time.monotonic()
        state = State.Name(row.report.state)
        if now - row.at_s > STALE_S:
            state = "NO FRAMES"
        rate = sum(1 for moment in row.times if now - moment <= 1.0)
        cells = [row.report.id, state, *["-"] * 7, f"{rate}", "-"]
        if row.seen is not None:
            pose = report_pose(row.seen.pose)
            turn = pose.rotation
            located = row.report.HasField("pose")
            if located:
                cells[2:5] = [f"{1e3 * value:.2f}" for value in pose.position]
                cells[5] = f"{math.degrees(math.atan2(turn[1, 0], turn[0, 0])):.1f}"
                cells[6] = f"{math.degrees(_tilt(turn)):.1f}"
                cells[7], cells[8] = str(row.seen.leds), f"{row.seen.rms_px:.3f}"
            age = row.seen_age_s + now - row.seen_at_s
            cells[10] = f"{1e3 * age:.0f} ms" if age < 1.0 else f"{age:.0f} s"
        return [*cells, row.report.reason], _STYLES.get(state, "red")

    def _status_line(self, camera: str) -> Text:
        status, at_s = self._status[camera]
        text = (
            f"{camera} ({status.source}): {status.rate_hz:.0f} frames/s, solve {1e3 * status.solve_p50_s:.1f} ms, "
            f"latency {1e3 * status.latency_p50_s:.1f} ms (p99 {1e3 * status.latency_p99_s:.1f}), "
            f"dropped {status.frames_dropped}, not recorded {status.frames_not_recorded}"
        )
        if time.monotonic() - at_s > 3 * STALE_S:
            return Text(f"{camera}: the server is silent", style="red")
        if status.problem:
            return Text(f"{text}\n{status.problem}", style="red")
        return Text(text, style="dim")


def _tilt(turn: Floats) -> float:
    """Angle in rad between the robot's z axis and the vertical of the parent frame (either way up)."""
    return math.acos(min(abs(float(turn[2, 2])), 1.0))


def show(table: RobotTable, console: Console, stop: threading.Event, waiting: str = "") -> None:
    """Draw the table until ``stop`` is set: redrawn in place on a terminal, else as lines now and then."""
    if not console.is_terminal:
        while not stop.wait(PLAIN_EVERY_S):
            for line in table.lines() or ([waiting] if waiting else []):
                console.print(line, soft_wrap=True, markup=False, highlight=False)
        return
    with Live(console=console, refresh_per_second=REFRESH_HZ, transient=False) as live:
        while not stop.wait(1.0 / REFRESH_HZ):
            live.update(table.draw())
        live.update(table.draw())


def watch(robots: Sequence[str], connect: str | None, options: Path | None, prefix: str = "") -> None:
    """Show the live table until Ctrl-C. Raises InputError for a malformed endpoint, file or robot id."""
    import zenoh

    for robot in robots:
        if problem := keys.key_problem(robot):
            raise InputError(f"robot id {robot!r} {problem}")
    if connect is not None:
        check_endpoint(connect)
    config = client_config(connect, options)
    endpoint = connect or (str(options) if options else DEFAULT_ENDPOINT)
    console = Console()
    stop = threading.Event()
    table = RobotTable(robots, prefix)
    with contextlib.suppress(KeyboardInterrupt):
        session = None
        said = False
        while session is None:
            try:
                session = zenoh.open(config)
            except zenoh.ZError:
                if not said:
                    console.print(f"waiting for a server at {endpoint} ...", markup=False, highlight=False)
                    said = True
                time.sleep(0.5)
        held = table.subscribe(session)
        try:
            show(table, console, stop, f"no frame from {endpoint} yet")
        finally:
            held.clear()
            session.close()
