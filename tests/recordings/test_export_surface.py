"""How robots stand on the surface, exported from reports, from odometry alone, and from lines of `locate`."""

import csv
import json
import math
from pathlib import Path

import numpy as np
import pytest

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import encode_odometry, set_report_pose, to_bytes
from asterism.protocol.errors import InputError
from asterism.protocol.messages import FRAME_REPORT, ODOMETRY, Message, RobotPose
from asterism.protocol.standing import surface_as_json
from asterism.recordings.export.csv_files import write_csv
from asterism.recordings.export.frames import ExportedFrame, frames_of
from asterism.recordings.export.lines import lines_of
from tests.helpers import random_pose


def rows(frames: list[ExportedFrame], folder: Path) -> list[dict[str, str]]:
    folder.mkdir()
    write_csv(frames, folder, {})
    return list(csv.DictReader((folder / "alpha.csv").read_text().splitlines()))


def standing(rng: np.random.Generator) -> list["pb.OnSurface"]:
    """On it, lifted, beyond its edge."""
    on = pb.OnSurface(standing="ON_SURFACE", off_m=1e-4, off_sigma_m=2e-4, tilt_off_rad=3e-3, tilt_off_sigma_rad=4e-3)
    set_report_pose(on.without, random_pose(rng))
    on.without_covariance.extend(np.diag(np.arange(1.0, 7.0) ** 2).ravel().tolist())
    lifted = pb.OnSurface(standing="LIFTED", reason="it is 1 mm above", off_m=1e-3, off_sigma_m=1e-4)
    return [on, lifted, pb.OnSurface(standing="BEYOND", reason="no surface", off_m=math.nan, off_sigma_m=math.nan)]


def reports(rng: np.random.Generator) -> list["pb.FrameReport"]:
    made = []
    for number, surface in enumerate(standing(rng)):
        report = pb.FrameReport(sequence=number, exposed_ns=1 + number, session=1, frame_id="world")
        robot = report.robots.add(id="alpha", state="TRACKED", leds=6, surface=surface)
        set_report_pose(robot.pose, random_pose(rng))
        made.append(report)
    return made


def test_columns_hold_the_standing_and_what_light_alone_says(tmp_path: Path, rng: np.random.Generator) -> None:
    made = reports(rng)
    messages = [Message(keys.frame("c"), FRAME_REPORT, to_bytes(r), r.exposed_ns, 0, r.sequence) for r in made]
    on, lifted, beyond = rows(list(frames_of(messages, tmp_path)), tmp_path / "csv")
    told = made[0].robots[0].surface
    assert (on["surface"], on["surface_reason"], float(on["surface_off_m"])) == ("ON_SURFACE", "", told.off_m)
    assert float(on["surface_off_sigma_m"]) == told.off_sigma_m
    assert float(on["surface_tilt_off_sigma_rad"]) == told.tilt_off_sigma_rad
    assert float(on["without_y_m"]) == told.without.position.y
    assert float(on["without_qw"]) == told.without.orientation.w
    sigmas = [float(on[f"without_sigma_{axis}"]) for axis in ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")]
    assert sigmas == pytest.approx([1, 2, 3, 4, 5, 6])
    assert (lifted["surface"], lifted["surface_reason"], lifted["without_x_m"]) == ("LIFTED", "it is 1 mm above", "")
    assert (beyond["surface"], beyond["surface_off_m"]) == ("BEYOND", "")


def test_lines_export_to_the_same_as_reports(tmp_path: Path, rng: np.random.Generator) -> None:
    lines = tmp_path / "poses.jsonl"
    pose = {"id": "alpha", "position": [0, 0, 1], "orientation": [0, 0, 0, 1]}
    told = [
        {"frame": f"{k}", "exposed_ns": k, "robots": [{**pose, "surface": surface_as_json(surface)}]}
        for k, surface in enumerate(standing(rng))
    ]
    lines.write_text("\n".join(map(json.dumps, told)))
    made = reports(np.random.default_rng(0))
    messages = [Message(keys.frame("c"), FRAME_REPORT, to_bytes(r), r.exposed_ns, 0, r.sequence) for r in made]
    of_lines = rows(list(lines_of(lines)), tmp_path / "lines")
    of_reports = rows(list(frames_of(messages, tmp_path)), tmp_path / "reports")
    for a, b in zip(of_lines, of_reports, strict=True):
        names = [name for name in a if name.startswith("surface")]
        assert [a[name] for name in names] == [b[name] for name in names]
    assert float(of_lines[0]["without_sigma_rz_rad"]) == pytest.approx(6.0)


def test_a_line_whose_surface_is_none_is_refused_in_a_sentence(tmp_path: Path) -> None:
    without = {"position": [0, 0, 1], "orientation": [0, 0, 0, 1], "covariance": [1.0]}
    robot = {"id": "a", "position": [0, 0, 1], "orientation": [0, 0, 0, 1]}
    robot["surface"] = {"standing": "ON_SURFACE", "without": without}
    lines = tmp_path / "poses.jsonl"
    lines.write_text(json.dumps({"frame": "0", "exposed_ns": 1, "robots": [robot]}))
    with pytest.raises(InputError, match="line 1: 'a': surface: without: covariance: 1 numbers, expected 36"):
        list(lines_of(lines))


def test_odometry_whose_report_was_lost_still_tells_the_standing(tmp_path: Path, rng: np.random.Generator) -> None:
    pose = RobotPose("alpha", "world", random_pose(rng), np.eye(6), "TRACKED", 6, 0.1, 3, 5, 0, standing="LIFTED")
    message = Message(keys.odometry("c", "alpha"), ODOMETRY, encode_odometry(pose), 5, 0, 3)
    (row,) = rows(list(frames_of([message], tmp_path)), tmp_path / "csv")
    assert (row["surface"], row["without_x_m"]) == ("LIFTED", "")
