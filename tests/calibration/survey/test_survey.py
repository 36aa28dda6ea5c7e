"""Surveyed truth: what is read, what is refused and in which words, and which line belongs to which frame."""

import json
from pathlib import Path

import numpy as np
import pytest

from asterism.protocol.errors import InputError
from asterism.server.calibration.survey.survey import Survey, match_frames, read_survey
from asterism.server.chain.frame import Frame
from asterism.server.command.locate import line
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.helpers import shared

GOOD = {"id": "alpha", "position": [0.1, 0.2, 1.3], "orientation": [0, 0, 0, 1]}


def written(folder: Path, *lines: object) -> Path:
    path = folder / "truth.jsonl"
    path.write_text("\n".join(text if isinstance(text, str) else json.dumps(text) for text in lines))
    return path


def read(path: Path, orientations: bool = True) -> Survey:
    return read_survey(path, ["alpha", "bravo"], orientations)


def test_what_locate_and_simulate_write_is_a_survey(tmp_path: Path) -> None:
    from asterism.protocol.rig import load_rig
    from asterism.server import Tracks, localize
    from asterism.server.simulation.simulate import Scene

    rig = load_rig(DEMO_RIG)
    scene = Scene(rig)
    frame = Frame(scene.render(0, scene.truth(0, 0.0)), 0, 0, "00000.png")
    result, _ = localize(frame, rig, Tracks.none())
    path = written(tmp_path, line(frame, result))
    found = read_survey(path, [robot.id for robot in rig.robots])
    assert found.frames[0].name == "00000.png"
    assert set(found.frames[0].robots) == {robot.id for robot in rig.robots}
    for robot, answer in result.answers.items():
        np.testing.assert_array_equal(found.frames[0].robots[robot].position, answer.position)  # type: ignore[union-attr]
    simulated = {"frame": "a", "exposed_ns": 0, "robots": [{**GOOD, "visible": 6}]}
    assert read(written(tmp_path, simulated, "", "")).frames[0].line == 1


def test_orientations_may_be_left_out_where_only_places_count(tmp_path: Path) -> None:
    path = written(tmp_path, {"frame": "a", "robots": [{"id": "alpha", "position": [1, 2, 3]}]})
    assert read(path, orientations=False).frames[0].robots["alpha"].orientation is None
    with pytest.raises(InputError, match=r"line 1: robots\[0\]\.orientation: is missing, expected 4 numbers"):
        read(path)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ('{"frame": "b"', "is no JSON"),
        ("[1, 2]", "a list of 2 values, expected one JSON object a line as asterism locate writes them"),
        ({"robots": []}, "frame: is missing, expected text"),
        ({"frame": "b"}, "robots: nothing, expected a list of robots"),
        ({"frame": "a", "robots": []}, "frame 'a' is in line 1 already, expected once"),
        ({"frame": "b", "robots": [5]}, "robots[0]: 5, expected a mapping"),
        ({"frame": "b", "robots": [], "robot": 1}, "unknown key 'robot'; did you mean 'robots'?"),
        (
            {"frame": "b", "robots": [{**GOOD, "id": "alhpa"}]},
            "'alhpa' is not in the rig, expected one of alpha, bravo",
        ),
        ({"frame": "b", "robots": [GOOD, GOOD]}, "robots[1].id: 'alpha' is given twice"),
        ({"frame": "b", "robots": [{**GOOD, "position": [1, 2]}]}, "robots[0].position: 2 values, expected 3 numbers"),
        ({"frame": "b", "robots": [{**GOOD, "position": [1, 2, "3"]}]}, "'3' is among the values, expected 3 numbers"),
        ({"frame": "b", "robots": [{**GOOD, "orientation": [0, 0, 0, 2]}]}, "a quaternion of length 2, expected"),
        ({"frame": "b", "robots": [{**GOOD, "orientaton": [0, 0, 0, 1]}]}, "did you mean 'orientation'?"),
    ],
)
def test_every_mistake_gets_one_sentence_with_its_line(tmp_path: Path, wrong: object, words: str) -> None:
    path = written(tmp_path, {"frame": "a", "robots": [GOOD]}, "", wrong)
    with pytest.raises(InputError) as caught:
        read(path)
    said = str(caught.value)
    assert said.startswith(f"{path}: line 3: ")
    assert words in said
    assert "\n" not in said


def test_files_that_are_none_are_refused(tmp_path: Path) -> None:
    for path, words in (
        (tmp_path / "none.jsonl", "no such file"),
        (tmp_path, "is a folder"),
        (written(tmp_path, {"frame": "a", "robots": []}), "holds no surveyed robot"),
    ):
        with pytest.raises(InputError, match=words):
            read(path)
    binary = tmp_path / "binary"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="is no text in UTF-8"):
        read(binary)
    with pytest.raises(InputError, match=r"line 1: .*expected one JSON object a line"):
        read(shared("samples", "clean", "truth.json"))


def test_lines_belong_to_frames_by_name_and_what_is_left_is_said(tmp_path: Path) -> None:
    survey = read(written(tmp_path, *({"frame": name, "robots": [GOOD]} for name in ("2", "0", "7"))))
    matched = match_frames(survey, ["0", "1", "2", "3"], "film")
    assert {name: frame.line for name, frame in matched.frames.items()} == {"0": 2, "2": 1}
    assert "frame 7 is not among the frames of film; left out" in matched.remarks[0]
    assert "2 frames (1, 3) are not in" in matched.remarks[1]


def test_lines_without_a_common_name_are_taken_in_order_or_refused(tmp_path: Path) -> None:
    survey = read(written(tmp_path, *({"frame": name, "robots": [GOOD]} for name in ("b", "a"))))
    matched = match_frames(survey, ["000000", "000001"], "film")
    assert [matched.frames[name].name for name in ("000000", "000001")] == ["b", "a"]
    assert "taken in the frames' order" in matched.remarks[0]
    with pytest.raises(InputError, match=r"names none of the frames of film \(it has 'b', the source 'x'\)"):
        match_frames(survey, ["x", "y", "z"], "film")
