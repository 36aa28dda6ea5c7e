"""Robots in a file that several rigs share; every file that a rig rests on travels with it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from asterism.protocol import keys
from asterism.protocol.codec import decode_rig, encode_rig
from asterism.protocol.errors import InputError
from asterism.protocol.messages import STATUS, Message
from asterism.protocol.place_error import place_error_of
from asterism.protocol.rig import Rig, load_rig, parse_rig
from asterism.recordings.reader import Recording
from asterism.recordings.recorder import FramesKept, Recorder
from tests.protocol.test_camera import TEXT as CAMERA
from tests.protocol.test_rig import RIG

HEAD, _, ROBOTS = RIG.partition("robots:\n")
SHARED = "\n".join(line.removeprefix("  ") for line in ROBOTS.splitlines()) + "\n"
OFFSET = "axial_shift: [-0.002, 0.0003]\nup_to_deg: 50\n"
WORLD = "world: {position_m: 0.001, orientation_rad: 0.0002, by: a tape}\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A rig whose robots, their LEDs' offset, its camera's report and its uncertainties lie in files."""
    (tmp_path / "all/glass").mkdir(parents=True)
    for name, text in {
        "lens/camera.yaml": CAMERA,
        "lens/camera.report.yaml": "made_by: a test\n",
        "left.yaml": HEAD.replace("camera.yaml", "lens/camera.yaml") + "robots: all/robots.yaml\n",
        "left.uncertainty.yaml": WORLD,
        "uncertainty.yaml": "bias_px: 0.1\n",
        "all/robots.yaml": SHARED.replace("led: {", "led: {offset: glass/led.yaml, ", 1),
        "all/glass/led.yaml": OFFSET,
    }.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def same(a: Rig, b: Rig) -> bool:
    """Whether two rigs are made of the same texts and have the same robots."""
    told = [(rig.rig_text, rig.camera_text, dict(rig.offset_texts), rig.robots_name, dict(rig.files)) for rig in (a, b)]
    alike = (np.array_equal(one.leds, other.leds) for one, other in zip(a.robots, b.robots, strict=True))
    offsets = [[robot.led_offset is None for robot in rig.robots] for rig in (a, b)]
    return told[0] == told[1] and all(alike) and offsets[0] == offsets[1]


def test_the_robots_of_a_file_are_those_of_the_rig(folder: Path) -> None:
    (folder / "whole.yaml").write_text(RIG.replace("camera.yaml", "lens/camera.yaml"))
    whole, shared = load_rig(folder / "whole.yaml"), load_rig(folder / "left.yaml")
    assert [robot.id for robot in shared.robots] == [robot.id for robot in whole.robots] == ["alpha", "bravo"]
    assert all(np.array_equal(a.leds, b.leds) for a, b in zip(whole.robots, shared.robots, strict=True))
    assert [robot.led_offset is None for robot in shared.robots] == [False, True]
    assert sorted(shared.files) == ["all/robots.yaml", "left.uncertainty.yaml", "lens/camera.report.yaml"]
    assert sorted(whole.files) == ["lens/camera.report.yaml", "uncertainty.yaml"]


def test_a_reply_and_a_recording_hold_every_file(folder: Path) -> None:
    rig = load_rig(folder / "left.yaml")
    told = decode_rig(encode_rig(rig))
    assert same(rig, parse_rig(told.rig_yaml, told.camera_yaml, "a reply", told.offset_yaml, told.files))
    recorder = Recorder(folder, rig, "test", FramesKept(), wait=True)
    recorder.write([Message(keys.status("cam"), STATUS, b"", 0, 0, 0)], None, 0, 0)
    recorder.close({})
    recorded = Recording(recorder.folder).rig()
    assert same(rig, recorded)
    error = place_error_of(recorded.files, "here")
    assert error is not None
    np.testing.assert_allclose(np.sqrt(np.diag(error.covariance)), [0.001] * 3 + [0.0002] * 3)
    assert error.by == "a tape"
    assert place_error_of(replace(rig, files={}).files, "here") is None


@pytest.mark.parametrize(
    ("name", "old", "new", "said"),
    [
        ("all/robots.yaml", "[0.050, 0.000, 0.012]", "[0.050, 0.000]", "/all/robots.yaml: alpha.leds[0]: 2 values"),
        ("all/robots.yaml", "alpha:", "robots: {}\nalpha:", "/all/robots.yaml: robots.leds: is missing"),
        ("left.yaml", "all/robots.yaml", "none.yaml", "/left.yaml: robots: there is no file "),
        ("left.yaml", "all/robots.yaml", "whole.yaml", "/whole.yaml: robots: expected the robots' ids at the left"),
        ("all/robots.yaml", SHARED, "{}", "/all/robots.yaml: is empty, expected at least one robot"),
        ("all/robots.yaml", "glass/led.yaml", "led.yaml", "/all/robots.yaml: alpha.led.offset: there is no file "),
    ],
)  # fmt: skip
def test_what_is_wrong_there_is_said_of_that_file(folder: Path, name: str, old: str, new: str, said: str) -> None:
    (folder / "whole.yaml").write_text("robots: {}\n")
    text = (folder / name).read_text()
    if old == SHARED:
        text = SHARED
    assert old in text
    (folder / name).write_text(text.replace(old, new, 1))
    with pytest.raises(InputError) as refusal:
        load_rig(folder / "left.yaml")
    assert str(refusal.value).startswith(f"{folder}{said}")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("world: {position_m: 0.1}", "world.orientation_rad: is missing"),
        ("world: {position_m: 0.1, orientation_rad: 0.1, covariance: []}", "unknown key 'position_m'"),
        ("world: {covariance: [[1, 0, 0, 0, 0, 0]]}", "1 rows, expected 6"),
        (f"world: {{covariance: {[[float(i == j) - 2.0 * (i + j == 1) for j in range(6)] for i in range(6)]}}}",
         "is no covariance"),
    ],
)  # fmt: skip
def test_a_place_that_is_not_said_well_is_refused(text: str, said: str) -> None:
    with pytest.raises(InputError, match=r"^here: uncertainty.yaml: world") as refusal:
        place_error_of({"uncertainty.yaml": text}, "here")
    assert said in str(refusal.value)
