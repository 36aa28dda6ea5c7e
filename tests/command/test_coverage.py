"""`asterism coverage`: what it writes and prints, which recordings it joins, and which it refuses."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Pose
from asterism.protocol.rig import Rig
from asterism.server.command import coverage
from asterism.server.command.parser import parser
from asterism.server.coverage.days import days_of
from tests.coverage.driven import FLAT, RATE_HZ, STEP_NS, record_drive, working_rig

UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])
SPEED = 0.05
FRAMES = 121


def lane(robot: str, number: int) -> Pose | None:
    """Each robot on a lane of its own; the second is lost for a while."""
    k = int(robot[1:])
    if k == 1 and number % 1000 in range(30, 40):
        return None
    return Pose(np.array([-0.1 + SPEED * (number % 1000) * STEP_NS * 1e-9, -0.05 + 0.1 * k, 0.03]), UPRIGHT)


def driven(parent: Path, rig: Rig, first: int = 0) -> Path:
    """A recording of two seconds."""
    parent.mkdir(exist_ok=True)
    return record_drive(parent, rig, FRAMES, lane, np.random.default_rng(first), first)


def run(*words: str | Path) -> int:
    """The command."""
    words = ("coverage", *words)
    return coverage.run(parser([str(word) for word in words]).parse_args([str(word) for word in words]))


def test_two_days_are_joined_and_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = working_rig(2, FLAT)
    for day in range(2):
        driven(tmp_path / f"day{day}", rig, 1000 * day)
    assert run(tmp_path / "day1", tmp_path / "day0", "-o", tmp_path / "out") == 0
    told = capsys.readouterr().out
    assert max(map(len, told.splitlines())) <= 80
    assert "surface: 2400.0 cm2; patches of 1.25 mm" in told
    assert re.search(r"r00: 242 poses over 4\.0 s$", told, re.MULTILINE)
    assert re.search(r"r01: 222 poses over 3\.6 s; left out: 20 not tracked, 2 gaps in time", told)
    with np.load(tmp_path / "out" / "coverage.npz") as found:
        dwell, areas = found["robot_dwell_s"], found["area_m2"]
        assert (dwell[0] * areas).sum() == pytest.approx(4.0 * math.pi * 1e-4, rel=0.01)
        assert found["robot_passes"][0].max() == 2


def test_the_tools_radius_can_be_said(tmp_path: Path) -> None:
    recording = driven(tmp_path, working_rig(1, FLAT, None))
    for said, radius in ((None, 0.01), (0.02, 0.02)):
        found, _ = coverage.added_up(days_of([recording], said)[0])
        assert found.grid.pitch_m == pytest.approx(radius / 8)
        length, area = SPEED * (FRAMES - 1) / RATE_HZ, found.grid.areas[found.together.visited].sum()
        assert area == pytest.approx(2 * radius * length + math.pi * radius**2, rel=0.015)


def refused(*folders: Path, radius_m: float | None = None) -> str:
    """Why these are not joined."""
    with pytest.raises(InputError) as told:
        days_of(folders, radius_m)
    return str(told.value)


def test_recordings_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    flat = driven(tmp_path / "flat", working_rig(2, FLAT))
    assert "calibrate surface" in refused(driven(tmp_path / "none", working_rig(1, None)))
    bent = driven(tmp_path / "bent", working_rig(2), 1000)
    assert f"{flat} and {bent}: the surfaces of their rigs differ" in refused(bent, flat)
    wide = driven(tmp_path / "wide", working_rig(2, FLAT, 0.02), 1000)
    assert "--tool-radius METRES" in refused(flat, wide)
    assert len(days_of([flat, wide], 0.01)[0]) == 2
    again = driven(tmp_path / "again", working_rig(2, FLAT))
    assert "at the same time, expected every recording once" in refused(flat, again)
    other = driven(tmp_path / "other", working_rig(2, FLAT, name="other"))
    assert "both tell of 'r00' at the same time, which would count twice" in refused(flat, other)


def test_of_cameras_that_were_joined_only_what_was_joined_counts(tmp_path: Path) -> None:
    one = driven(tmp_path, working_rig(2, FLAT))
    fused = driven(tmp_path, working_rig(2, FLAT, name="fused"))
    kept, passed = days_of([tmp_path], None)
    assert [day.path for day in kept] == [fused]
    assert [day.path for day in passed] == [one]


def test_a_recording_that_is_damaged_is_refused(tmp_path: Path) -> None:
    recording = driven(tmp_path, working_rig(2, FLAT))
    file = recording / "poses-0001.mcap"
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 0x55
    file.write_bytes(data)
    with pytest.raises(InputError, match=r"is damaged .*recover"):
        run(recording, "-o", tmp_path / "out")
    assert not (tmp_path / "out").exists()
