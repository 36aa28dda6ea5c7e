"""`asterism locate --record` and `asterism fuse RECORDING ...`: films of several cameras, through the commands."""

import csv
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from asterism.protocol import keys
from asterism.protocol.codec import encode_rig, report_pose, to_bytes
from asterism.protocol.geometry import Pose
from asterism.protocol.messages import FRAME_REPORT, Message
from asterism.protocol.rig import load_rig
from asterism.recordings.compare import compare, reports
from asterism.recordings.reader import Recording
from asterism.recordings.recorder import FramesKept, Recorder
from asterism.server.__main__ import main
from asterism.server.command.fused_line import fused_line
from asterism.server.fusing.fitting import view_of
from asterism.server.fusing.fleet import Fleet
from asterism.server.fusing.fuse import fuse
from asterism.server.fusing.memory import Joint
from asterism.server.fusing.offline import Exposure
from asterism.server.fusing.sighting import sighting_of
from tests.command.test_command_line import refused
from tests.fusing.drawn import sighting
from tests.service.fusing.speaking import report_of, with_texts
from tests.several import Drive, facing_pair, frames_of, rigs_at
from tests.several_files import write_film, write_rigs

START_NS, STEP_NS, LATER_NS, FRAMES = 10**18, 16_666_667, 5_000_000, 6
DRIVE = Drive(("r00",))


@pytest.fixture(scope="module")
def films(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two cameras' rigs and films: `right` exposes 5 ms after `left`, but for the last frame, when both do together."""
    folder = tmp_path_factory.mktemp("films")
    rigs = rigs_at(facing_pair(), robots=1)
    write_rigs(folder, rigs)
    for rig, later_ns in zip(rigs, (0, LATER_NS), strict=True):
        frames = frames_of(rig, DRIVE, times(later_ns, since_ns=0))
        moved = (type(frame)(frame.image, START_NS + frame.exposed_ns, frame.index) for frame in frames)
        write_film(folder / f"film-{rig.camera.name}", moved)
    return folder


def times(later_ns: int, since_ns: int = START_NS) -> list[int]:
    last = FRAMES - 1
    return [since_ns + k * STEP_NS + later_ns * (k < last) for k in range(FRAMES)]


def located(films: Path, camera: str, out: Path, *more: str) -> Path:
    assert (
        main(["locate", str(films / f"{camera}.yaml"), str(films / f"film-{camera}"), "--record", str(out), *more]) == 0
    )
    return max(out.glob(f"{camera}-*"), key=lambda folder: folder.name)


@pytest.fixture(scope="module")
def recorded(films: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the recordings of both."""
    out = tmp_path_factory.mktemp("recorded")
    for camera in ("left", "right"):
        located(films, camera, out)
    return out


def lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_a_film_is_recorded_with_its_own_times_and_its_whole_rig(films: Path, recorded: Path, tmp_path: Path) -> None:
    recording = Recording(next(recorded.glob("right-*")))
    told = list(reports(recording))
    assert [report.exposed_ns for report in told] == times(LATER_NS)
    assert {(report.solved_ns - report.exposed_ns, report.published_ns - report.exposed_ns) for report in told} == {
        (0, 0)
    }
    assert encode_rig(recording.rig()) == encode_rig(load_rig(films / "right.yaml"))
    assert set(recording.rig().files) == {"robots.yaml"}
    assert recording.count_frames() == 0
    again = Recording(located(films, "right", tmp_path, "--record-frames", "all", "-o", str(tmp_path / "o.jsonl")))
    assert list(again.messages()) == list(recording.messages())
    assert again.count_frames() == len(lines(tmp_path / "o.jsonl")) == FRAMES


def test_two_recordings_of_a_film_differ_in_when_they_began_alone(films: Path, recorded: Path, tmp_path: Path) -> None:
    one, other = (
        next(folder.glob("left-*/poses-0001.mcap")).read_bytes() for folder in (recorded, tmp_path_of(films, tmp_path))
    )
    assert len(one) == len(other)
    began = len("2026-11-27T05:24:15.123456") + 8 + 4  # in the metadata, with their check sums; twice in a file
    assert sum(a != b for a, b in zip(one, other, strict=True)) <= 3 * began


def tmp_path_of(films: Path, tmp_path: Path) -> Path:
    located(films, "left", tmp_path)
    return tmp_path


def test_every_exposure_of_any_camera_is_a_line_in_the_order_of_time(recorded: Path, tmp_path: Path) -> None:
    one, other = tmp_path / "one.jsonl", tmp_path / "other.jsonl"
    left, right = sorted(recorded.iterdir())
    assert main(["fuse", str(left), str(right), "-o", str(one)]) == 0
    assert main(["fuse", str(right), str(recorded), "-o", str(other), "--record", str(tmp_path)]) == 0
    assert one.read_bytes() == other.read_bytes()
    told = lines(one)
    assert [line["exposed_ns"] for line in told] == sorted({*times(0), *times(LATER_NS)})
    assert (told[0]["frame"], told[1]["frame"], told[-1]["frame"]) == ("left 0", "right 0", "left 5, right 5")
    assert [robot["cameras"] for robot in told[-1]["robots"]] == [["left", "right"]]
    assert "left_out" not in told[-1]
    for line in told[1:]:
        pose = Pose(np.array(line["robots"][0]["position"]), np.array(line["robots"][0]["orientation"]))
        off = pose.position - DRIVE((line["exposed_ns"] - START_NS) * 1e-9)["r00"].position
        sigmas = np.sqrt(np.diag(np.reshape(line["robots"][0]["covariance"], (6, 6))))[:3]
        assert (np.abs(off) < 5 * sigmas).all()
    fused = Recording(next(tmp_path.glob("fused-*")))
    kept = [(report.exposed_ns, [list(robot.cameras) for robot in report.robots]) for report in reports(fused)]
    assert kept == [(line["exposed_ns"], [robot["cameras"] for robot in line["robots"]]) for line in told]
    assert [robot.id for robot in fused.rig().robots] == ["r00"]
    # Beside a camera's own poses, by their times.
    own, joined = (
        {report.exposed_ns: report_pose(report.robots[0].pose).position for report in reports(of)}
        for of in (Recording(right), fused)
    )
    beside = compare(Recording(right), fused).robots["r00"].position_m
    assert beside == pytest.approx([np.linalg.norm(own[ns] - joined[ns]) for ns in sorted(own)])
    # What was joined before is not joined again.
    for folder in (left, right, fused.path):
        shutil.copytree(folder, tmp_path / "all" / folder.name)
    assert main(["fuse", str(tmp_path / "all"), "-o", str(tmp_path / "again.jsonl")]) == 0
    assert (tmp_path / "again.jsonl").read_bytes() == one.read_bytes()
    # What reads the lines and the recording reads the same.
    for source, name in ((other, "lines"), (fused.path, "recording")):
        assert main(["export", str(source), "--to", "csv", "-o", str(tmp_path / name)]) == 0
        with (tmp_path / name / "r00.csv").open() as table:
            rows = list(csv.DictReader(table))
        assert [int(row["exposed_ns"]) for row in rows] == [line["exposed_ns"] for line in told]
        assert [row["cameras"] for row in rows] == ["/".join(line["robots"][0]["cameras"]) for line in told]
        assert [float(row["x_m"]) for row in rows] == [line["robots"][0]["position"][0] for line in told]


def test_the_lines_are_what_the_pure_function_says_of_the_reports(films: Path, recorded: Path, tmp_path: Path) -> None:
    fleet = Fleet.of([view_of(load_rig(films / f"{camera}.yaml"), camera) for camera in ("left", "right")])
    told = [(report, name.name.partition("-")[0]) for name in recorded.iterdir() for report in reports(Recording(name))]
    joint, expected = Joint.none(), []
    for exposed_ns in sorted({report.exposed_ns for report, _ in told}):
        now = sorted(
            ((camera, report) for report, camera in told if report.exposed_ns == exposed_ns), key=lambda one: one[0]
        )
        fused, joint = fuse([sighting_of(report, fleet.views[camera]) for camera, report in now], fleet, joint)
        line = fused_line(Exposure(fused, {camera: report.sequence for camera, report in now}, fleet))
        expected.append(json.loads(json.dumps(line)))
    assert main(["fuse", str(recorded), "-o", str(tmp_path / "fused.jsonl")]) == 0
    assert lines(tmp_path / "fused.jsonl") == expected


def a_copy(recorded: Path, tmp_path: Path) -> Path:
    shutil.copytree(recorded, tmp_path / "copy")
    return tmp_path / "copy"


def without_world(films: Path, folder: Path) -> None:
    text = (films / "left.yaml").read_text()
    (films / "placeless.yaml").write_text(
        "".join(line for line in text.splitlines(True) if not line.startswith("world:"))
    )
    shutil.rmtree(next(folder.glob("left-*")))
    assert main(["locate", str(films / "placeless.yaml"), str(films / "film-left"), "--record", str(folder)]) == 0


def other_robots(films: Path, folder: Path) -> None:
    robots = json.loads((films / "robots.yaml").read_text().partition(": ")[2])
    robots["leds"][4][0] += 0.0005
    (films / "others.yaml").write_text(f"r00: {json.dumps(robots)}\n")
    (films / "other.yaml").write_text((films / "left.yaml").read_text().replace("robots.yaml", "others.yaml"))
    shutil.rmtree(next(folder.glob("left-*")))
    assert main(["locate", str(films / "other.yaml"), str(films / "film-left"), "--record", str(folder)]) == 0


def another_time(films: Path, folder: Path) -> None:
    shutil.copytree(films / "film-left", films / "film-early")
    (films / "film-early/times.csv").unlink()
    shutil.rmtree(next(folder.glob("left-*")))
    assert main(["locate", str(films / "left.yaml"), str(films / "film-early"), "--record", str(folder)]) == 0


def twice(_: Path, folder: Path) -> None:
    shutil.copytree(next(folder.glob("left-*")), folder / "again")


def without_reports(films: Path, folder: Path) -> None:
    shutil.rmtree(next(folder.glob("left-*")))
    (located(films, "left", folder, "--record-frames", "all") / "poses-0001.mcap").unlink()


def damaged(_: Path, folder: Path) -> None:
    file = next(folder.glob("left-*")) / "poses-0001.mcap"
    file.write_bytes(file.read_bytes()[:-500])


@pytest.mark.parametrize(
    ("harm", "said"),
    [
        (without_world, "the rig has no `world`"),
        (other_robots, "LED 4 is 0.5 mm elsewhere"),
        (another_time, "no time in common with any other (left 0.000 s to 0.083 s, right 2001-09-09 01:46:40.005 UTC"),
        (twice, "are both of camera 'left' at the same time"),
        (without_reports, "holds no frame reports, only images; find what they show first: "),
        (damaged, "was cut off"),
    ],
)  # fmt: skip
def test_recordings_that_do_not_fit_together_are_refused(
    films: Path, recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], said: str,
    harm: Callable[[Path, Path], None],
) -> None:  # fmt: skip
    folder = a_copy(recorded, tmp_path)
    harm(films, folder)
    capsys.readouterr()
    assert said in refused(capsys, "fuse", str(folder), "-o", str(tmp_path / "fused.jsonl"))
    assert not (tmp_path / "fused.jsonl").exists()


def test_what_there_is_nothing_to_write_to_is_said(
    films: Path, recorded: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "expected -o OUT for lines, --record DIR" in refused(capsys, "fuse", str(recorded))
    assert "expected -o OUT for lines, --record DIR" in refused(capsys, "locate", str(films / "left.yaml"), str(films))
    told = refused(capsys, "fuse", str(recorded), "-o", "-", "--camera", "up")
    assert "--camera up: is in none of the recordings, expected of left, right" in told


def drawn(folder: Path, late_ns: int, frames: int = 240) -> None:
    """Recordings of two cameras' reports at 60 Hz, without pictures; `right` stamps its frames too late."""
    rng = np.random.default_rng(3)
    drive = Drive(("r00",), speed=0.4)
    for rig in map(with_texts, rigs_at(facing_pair(), robots=1)):
        view, later_ns = view_of(rig, "here"), late_ns * (rig.camera.name == "right")
        recorder = Recorder(folder, rig, "drawn", FramesKept(0), wait=True)
        for k in range(frames):
            seen = sighting(view, drive(k / 60), START_NS + k * STEP_NS + later_ns, rng)
            report = report_of(seen, sequence=k)
            message = Message(keys.frame(rig.camera.name), FRAME_REPORT, to_bytes(report), report.exposed_ns, 0, k)
            recorder.write([message], None, report.exposed_ns, k)
        recorder.close({})


@pytest.mark.parametrize("late_ns", [0, 8_000_000])
def test_times_that_disagree_are_said(tmp_path: Path, caplog: pytest.LogCaptureFixture, late_ns: int) -> None:
    drawn(tmp_path, late_ns)
    with caplog.at_level("INFO"):
        assert main(["fuse", str(tmp_path), "-o", str(tmp_path / "fused.jsonl")]) == 0
    told = [record.getMessage() for record in caplog.records if "robots on the move show" in record.getMessage()]
    assert len(told) == (late_ns > 0)
    for sentence in told:
        found = re.search(r"that the times of left and right differ by ([\d.]+) ms", sentence)
        assert found is not None
        assert float(found[1]) == pytest.approx(8.0, abs=1.0)
