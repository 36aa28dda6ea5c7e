"""How a robot stands on the surface, as clients show it: lines of JSON, the table, a pose."""

import json
import math

import numpy as np
import pytest

from asterism.clients.json_lines import frame_as_json
from asterism.clients.servers import Servers
from asterism.clients.watched import RobotTable
from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import set_report_pose
from asterism.protocol.geometry import Pose
from tests.clients.test_watch import drawn, tell
from tests.protocol import make_golden


def standing_report(standing: str, **numbers: float) -> "pb.FrameReport":
    """A frame in which alpha stands so."""
    report = make_golden.frame_report()
    report.robots[0].surface.CopyFrom(pb.OnSurface(standing=pb.Standing.Value(standing), **numbers))
    return report


def test_lines_tell_the_standing_and_what_light_alone_says() -> None:
    report = standing_report("ON_SURFACE", off_m=1e-4, off_sigma_m=2e-4, tilt_off_rad=0.25, tilt_off_sigma_rad=0.5)
    told = report.robots[0].surface
    set_report_pose(told.without, Pose(np.array([1.0, 2.0, 3.0]), np.array([0.0, 0.0, 0.0, 1.0])))
    told.without_covariance.extend(range(36))
    told.without_alternative.pose.CopyFrom(told.without)
    told.without_alternative.odds = 7.0
    (alpha,) = frame_as_json(report, Servers("")["cam"], frozenset())["robots"]
    line = json.loads(json.dumps(alpha, allow_nan=False))["surface"]
    assert line["without"].pop("alternative")["odds"] == 7.0
    assert line == {
        "standing": "ON_SURFACE", "off_m": 1e-4, "off_sigma_m": 2e-4, "tilt_off_rad": 0.25, "tilt_off_sigma_rad": 0.5,
        "reason": "", "without": {
            "position": [1.0, 2.0, 3.0], "orientation": [0.0, 0.0, 0.0, 1.0], "covariance": list(map(float, range(36))),
        },
    }  # fmt: skip


def test_beyond_the_edge_there_are_no_numbers_and_a_line_all_the_same() -> None:
    report = standing_report("BEYOND", off_m=math.nan, off_sigma_m=math.nan, tilt_off_rad=math.nan)
    (alpha,) = frame_as_json(report, Servers("")["cam"], frozenset())["robots"]
    assert (alpha["surface"]["off_m"], alpha["surface"]["without"]) == (None, None)
    json.dumps(alpha, allow_nan=False)


@pytest.mark.parametrize(
    ("report", "shown"),
    [
        (standing_report("ON_SURFACE", off_m=1e-4), "on"),
        (standing_report("LIFTED", off_m=1.04e-3), "lifted 1.0 mm"),
        (standing_report("SUNK", off_m=-2e-3), "sunk 2.0 mm"),
        (standing_report("TILTED", tilt_off_rad=0.05), "tilted 2.9°"),
        (standing_report("BEYOND", off_m=math.nan), "beyond"),
    ],
)
def test_the_table_shows_it_also_in_eighty_columns(report: "pb.FrameReport", shown: str) -> None:
    table = RobotTable()
    tell(table, report)
    for width in (80, 160):
        lines = drawn(table, width).splitlines()
        assert " surface" in lines[0]
        assert f" {shown} " in f"{next(line for line in lines if line.strip().startswith('alpha'))} "
        assert max(map(len, lines)) <= width


def test_a_rig_without_a_surface_has_no_column_for_it() -> None:
    table = RobotTable()
    tell(table)
    assert "surface" not in drawn(table)
