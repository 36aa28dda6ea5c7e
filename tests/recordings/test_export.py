"""Tables and trajectories of a recording: every number back as it was recorded, nothing where nothing was known."""

import csv
import math
import shutil
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from asterism.protocol.codec import decode_frame_report, decode_odometry, encode_odometry
from asterism.protocol.errors import InputError
from asterism.protocol.messages import FRAME_REPORT, ODOMETRY, Message, RobotPose
from asterism.recordings.compare import reports
from asterism.recordings.export.columns import columns, groups, seconds
from asterism.recordings.export.csv_files import write_csv
from asterism.recordings.export.frames import ExportedFrame, ExportedRobot, frames_of, points_of
from asterism.recordings.export.parquet_file import write_parquet
from asterism.recordings.export.tum_files import write_tum
from asterism.recordings.mend import mend
from asterism.recordings.reader import Recording
from tests.helpers import assert_poses_close, random_pose
from tests.recordings.exported import FRAMES, LOST_IN, REASON, RELOADED, exposed_ns, record

Poses = dict[tuple[int, str], RobotPose]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Recording, Poses]:
    return record(tmp_path_factory.mktemp("recording"), np.random.default_rng(11))


def frames(recording: Recording) -> list[ExportedFrame]:
    return list(frames_of(recording.messages(), recording.path))


def points(recording: Recording) -> dict[str, list[str]]:
    return points_of(rig for _, rig in recording.rigs())


def test_every_number_of_the_csv_is_what_was_recorded(tmp_path: Path, recorded: tuple[Recording, Poses]) -> None:
    recording, poses = recorded
    written = write_csv(frames_of(recording.messages(), recording.path), tmp_path, points(recording))
    assert written.frames == FRAMES
    assert written.backwards == str(RELOADED), "the clock was set back there"
    assert set(written.files) == {f"{robot}.csv" for robot in points(recording)} == set(map(str, names(tmp_path)))
    seen = set()
    for path in tmp_path.iterdir():
        with path.open(newline="") as stream:
            for row in csv.DictReader(stream):
                key = (int(row["frame"]), row["robot"])
                assert not any("e" in row[name] for name in NUMBERS), "PlotJuggler takes an exponent for text"
                assert row["time_s"] == seconds(int(row["exposed_ns"])) == seconds(exposed_ns(key[0]))
                if key in poses:
                    seen.add(key)
                    check(row, poses[key])
                else:
                    assert (row["state"], row["reason"], int(row["frame"])) == ("LOST", REASON, LOST_IN)
                    assert not any(row[name] for name in NUMBERS)
    assert seen == poses.keys()


NUMBERS = [column.name for column in columns(groups(())) if column.type == "real"]


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def check(row: dict[str, str], told: RobotPose) -> None:
    assert [float(row[f"{axis}_m"]) for axis in "xyz"] == told.position.tolist()
    assert [float(row[f"q{axis}"]) for axis in "xyzw"] == told.orientation.tolist()
    spread = told.covariance
    sigmas = [row[f"sigma_{name}"] for name in ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")]
    assert [float(sigma) for sigma in sigmas] == np.sqrt(spread.diagonal()).tolist()
    assert [float(row[name]) for name in ("cov_x_y_m2", "cov_x_rz_m_rad", "cov_ry_rz_rad2")] == [
        spread[0, 1], spread[0, 5], spread[4, 5]
    ]  # fmt: skip
    assert told.velocity is not None
    assert [float(row[f"v{axis}_m_per_s"]) for axis in "xyz"] == told.velocity.linear.tolist()
    assert [float(row[f"w{axis}_rad_per_s"]) for axis in "xyz"] == told.velocity.angular.tolist()
    assert float(row["sigma_wz_rad_per_s"]) == math.sqrt(told.velocity.covariance[5, 5])
    assert (row["state"], row["frame_id"], row["leds"], row["filter"]) == (told.state, "world", "6", "test")
    assert row["session"] == str(told.session)
    assert float(row["rms_px"]) == told.rms_px
    assert [bool(row[f"led{led}_residual_x_px"]) for led in range(6)] == [True, False, False, False, True, False]
    assert row["other_odds"] == ("12.5" if told.state == "TILT_AMBIGUOUS" else "")


def test_residuals_and_points_are_those_of_the_report(tmp_path: Path, recorded: tuple[Recording, Poses]) -> None:
    recording, _ = recorded
    write_csv(frames(recording), tmp_path, points(recording))
    carrying = next(robot for robot, carried in points(recording).items() if carried)
    name = points(recording)[carrying][0]
    told = {
        str(report.sequence): robot
        for report in reports(recording)
        for robot in report.robots
        if robot.id == carrying and robot.HasField("pose")
    }
    with (tmp_path / f"{carrying}.csv").open(newline="") as stream:
        rows = {row["frame"]: row for row in csv.DictReader(stream)}
    assert told
    for frame, robot in told.items():
        point, row = robot.points[name], rows[frame]
        assert [float(row[f"{name}_{axis}_m"]) for axis in "xyz"] == [point.x, point.y, point.z]
        assert [float(row[f"led{led}_residual_y_px"]) for led in (0, 4)] == list(robot.residual_y)


def test_pandas_finds_the_same_in_csv_and_parquet(tmp_path: Path, recorded: tuple[Recording, Poses]) -> None:
    recording, poses = recorded
    (tmp_path / "csv").mkdir()
    write_csv(frames(recording), tmp_path / "csv", points(recording))
    write_parquet(frames(recording), tmp_path / "poses.parquet", points(recording))
    table = pd.read_parquet(tmp_path / "poses.parquet")
    assert str(table["time"].dtype) == "datetime64[ns, UTC]"
    assert table["time"].astype("int64").tolist() == table["exposed_ns"].tolist()
    assert table.groupby("robot")["x_m"].count().sum() == len(poses)
    for robot, of_robot in table.groupby("robot"):
        rows = pd.read_csv(tmp_path / "csv" / f"{robot}.csv", engine="python")  # whose floats are exact
        shared = [name for name in rows.columns if name in table.columns]
        assert len(shared) == len(rows.columns) - 1, "all but time_s"
        for name in shared:
            ours, theirs = of_robot[name].to_numpy(), rows[name].to_numpy()
            if rows[name].dtype.kind == "f":
                np.testing.assert_array_equal(ours.astype(float), theirs)
            else:
                same = [
                    a == b or (pd.isna(a) and pd.isna(b)) for a, b in zip(ours.tolist(), theirs.tolist(), strict=True)
                ]
                assert all(same) or name == "frame", name
    schema = pq.read_schema(tmp_path / "poses.parquet")
    units = {field.name: (field.metadata or {}).get(b"unit") for field in schema}
    assert (units["x_m"], units["cov_x_rx_m_rad"], units["vx_m_per_s"], units["qx"]) == (b"m", b"m rad", b"m/s", None)


def test_parquet_is_the_same_in_many_groups(
    tmp_path: Path, recorded: tuple[Recording, Poses], monkeypatch: pytest.MonkeyPatch
) -> None:
    recording, _ = recorded
    write_parquet(frames(recording), tmp_path / "one.parquet", points(recording))
    monkeypatch.setattr("asterism.recordings.export.parquet_file.ROWS", 7)
    write_parquet(frames(recording), tmp_path / "many.parquet", points(recording))
    assert pq.ParquetFile(tmp_path / "many.parquet").num_row_groups > 1
    assert pq.read_table(tmp_path / "many.parquet").to_pylist() == pq.read_table(tmp_path / "one.parquet").to_pylist()


def test_a_trajectory_holds_the_poses_alone(tmp_path: Path, recorded: tuple[Recording, Poses]) -> None:
    recording, poses = recorded
    written = write_tum(frames(recording), tmp_path)
    assert sum(written.located.values()) == len(poses)
    for robot in points(recording):
        told = [pose for (_, of), pose in sorted(poses.items()) if of == robot]
        lines = (tmp_path / f"{robot}.tum").read_text().splitlines()
        assert lines[:2] == [
            f"# pose of {robot} in world: m, quaternion; timestamp: mid-exposure, s since the Unix epoch",
            "# timestamp tx ty tz qx qy qz qw",
        ]
        assert [line.split()[0] for line in lines[2:]] == [seconds(pose.exposed_ns) for pose in told]
        numbers = [[float(word) for word in line.split()[1:]] for line in lines[2:]]
        assert numbers == [[*pose.position, *pose.orientation] for pose in told]


def test_another_parent_frame_is_another_trajectory(tmp_path: Path) -> None:
    robot = ExportedRobot("alpha", "TRACKED", position=(1.0, 2.0, 3.0), orientation=(0.0, 0.0, 0.0, 1.0))
    told = [ExportedFrame(str(k), k, k, 0, "cam" if k < 2 else "world", (robot,)) for k in range(5)]
    assert write_tum(told, tmp_path).files == ["alpha.tum", "alpha.world.tum"]
    assert [len((tmp_path / name).read_text().splitlines()) - 2 for name in ("alpha.tum", "alpha.world.tum")] == [2, 3]


def test_odometry_without_its_report_is_a_frame_too(recorded: tuple[Recording, Poses]) -> None:
    recording, poses = recorded
    alone = [message for message in recording.messages() if message.kind.schema != FRAME_REPORT.schema]
    found = list(frames_of(alone, recording.path))
    assert len(found) == FRAMES
    told = {(frame.sequence, robot.id): robot for frame in found for robot in frame.robots}
    assert told.keys() == poses.keys()
    for key, pose in poses.items():
        assert told[key].position == tuple(pose.position.tolist())
        assert told[key].velocity is not None


@pytest.mark.parametrize("name", ["../../elsewhere", "/elsewhere", "a\0b", "", "a" * 300])
@pytest.mark.parametrize("schema", [FRAME_REPORT.schema, ODOMETRY.schema])
def test_no_robot_of_a_recording_names_a_file_elsewhere(
    recorded: tuple[Recording, Poses], name: str, schema: str
) -> None:
    recording, _ = recorded

    def renamed(message: Message) -> Message:
        if schema == FRAME_REPORT.schema:
            report = decode_frame_report(message.payload)
            report.robots[0].id = name
            return replace(message, payload=report.SerializeToString())
        return replace(message, payload=encode_odometry(replace(decode_odometry(message.payload), robot=name)))

    told = (renamed(message) for message in recording.messages() if message.kind.schema == schema)
    with pytest.raises(InputError, match=r"none that a server makes; run this first: asterism recover"):
        list(frames_of(told, recording.path))


def test_what_was_recovered_is_exported_as_far_as_it_goes(
    tmp_path: Path, recorded: tuple[Recording, Poses], rng: np.random.Generator
) -> None:
    recording, poses = recorded
    shutil.copytree(recording.path, tmp_path / "cut")
    last = sorted((tmp_path / "cut").glob("poses-*.mcap"))[-1]
    last.write_bytes(last.read_bytes()[: -int(rng.integers(200, 2000))])
    list(mend([last]))
    cut = Recording(tmp_path / "cut")
    write_csv(frames(cut), tmp_path, points(cut))
    found = 0
    for path in tmp_path.glob("*.csv"):
        with path.open(newline="") as stream:
            for row in csv.DictReader(stream):
                if row["x_m"]:
                    check(row, poses[int(row["frame"]), row["robot"]])
                    found += 1
    assert found >= sum(sequence < RELOADED for sequence, _ in poses), "the first file is whole"


def test_only_so_much_is_read_as_is_asked_for(recorded: tuple[Recording, Poses]) -> None:
    recording, _ = recorded
    read = []
    messages = (read.append(message.sequence) or message for message in recording.messages())
    assert len(list(islice(frames_of(messages, recording.path), 2))) == 2
    assert max(read) == 2


def test_points_go_with_a_robot_that_is_moved(rng: np.random.Generator) -> None:
    before, after, point = random_pose(rng), random_pose(rng), rng.normal(size=3)
    robot = ExportedRobot(
        "alpha",
        "TRACKED",
        position=tuple(before.position),
        orientation=tuple(before.orientation),
        points={"tool": tuple(before.map(point))},
    )
    moved = robot.moved(after, np.eye(6), None, "both ways")
    assert moved.pose is not None
    assert_poses_close(moved.pose, after)
    np.testing.assert_allclose(moved.points["tool"], after.map(point), atol=1e-12)
    assert (moved.smoothed_by, moved.covariance) == ("both ways", tuple(np.eye(6).ravel()))


def test_no_two_columns_have_one_name() -> None:
    for named in ([], ["tool", "tip"], ["sigma", "other", "point_sigma", "led0_residual"]):
        of = [column.name for column in columns(groups(named))]
        assert len(of) == len(set(of)) == len(columns(groups([]))) + 3 * len(named)
