"""What frame reports tell of robots that stand on the surface, as columns: by bytes, or message by message."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.geometry import Floats, Pose
from asterism.recordings.decodable import read_report
from asterism.server.coverage.report_bytes import ODD, Columns, Robots, read_reports
from asterism.server.coverage.sightings import Told

_UPPER = np.triu_indices(3)


class Looked(NamedTuple):
    """Robots that are looked for, by id, and how the bytes are read for them."""

    ids: tuple[str, ...]
    robots: Robots


def looked_for(levers: Mapping[str, Floats]) -> Looked:
    """Robots by id, with the points (3,) m of their tools."""
    names = [robot.encode() for robot in levers]
    table = np.zeros((len(names), max(map(len, names), default=0)), np.uint8)
    for row, name in zip(table, names, strict=True):
        row[: len(name)] = np.frombuffer(name, np.uint8)
    lengths = np.array([len(name) for name in names], np.int64)
    return Looked(tuple(levers), Robots(table, lengths, np.array([*levers.values()]).reshape(-1, 3)))


def told_in(data: NDArray[np.uint8], spans: NDArray[np.int64], looked: Looked, where: Path) -> Columns:
    """What the reports between ``spans`` (n, 2) of the bytes tell. Raises InputError for one that is none."""
    columns = Columns.of(len(spans), len(looked.ids))
    read_reports(data, spans, looked.robots, columns)
    for n in np.flatnonzero(columns.found == ODD):
        begin, end = spans[n]
        decode_into(columns, int(n), read_report(data[begin:end].tobytes(), where), looked)
    return columns


def decode_into(columns: Columns, n: int, report: "pb.FrameReport", looked: Looked) -> None:
    """The same of one report, by the real decoder. Of a pose that does not tell its covariance that is nan."""
    columns.times_ns[n] = report.exposed_ns
    for column in (columns.states, columns.standings, columns.points, columns.covariances):
        column[n] = 0
    for robot in report.robots:
        if robot.id not in looked.ids:
            continue
        r = looked.ids.index(robot.id)
        columns.states[n, r], columns.standings[n, r] = robot.state, robot.surface.standing
        if robot.HasField("pose"):
            columns.points[n, r], columns.covariances[n, r] = _point(robot, looked.robots.levers[r])
        elif robot.state in (pb.TRACKED, pb.TILT_AMBIGUOUS):
            columns.states[n, r] = pb.LOST


def _point(robot: "pb.RobotReport", lever: Floats) -> tuple[Floats, Floats]:
    """The tool's point (3,) m, and its covariance as of `Told`: a small turn w of the robot about the parent's axes
    moves it by w x (R lever).
    """
    p, q = robot.pose.position, robot.pose.orientation
    pose = Pose(np.array([p.x, p.y, p.z]), np.array([q.x, q.y, q.z, q.w]))
    if len(robot.covariance) != 36:
        return pose.map(lever), np.full(6, np.nan)
    x, y, z = pose.rotation @ lever
    jacobian = np.hstack([np.eye(3), [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]])
    full = jacobian @ np.reshape(robot.covariance, (6, 6)) @ jacobian.T
    return pose.map(lever), full[_UPPER]


def by_robot(columns: Columns, looked: Looked) -> dict[str, Told]:
    """What the reports tell, of each robot."""
    return {
        robot: Told(
            columns.times_ns,
            columns.states[:, r],
            columns.standings[:, r],
            columns.points[:, r],
            columns.covariances[:, r],
        )
        for r, robot in enumerate(looked.ids)
    }
