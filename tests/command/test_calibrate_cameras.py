"""asterism calibrate cameras: what it writes and says of recordings, and what it refuses."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from asterism.protocol import keys
from asterism.protocol.geometry import Pose, exp_rotation
from asterism.protocol.messages import STATUS, Message
from asterism.protocol.place_error import place_error_of
from asterism.protocol.rig import Rig, load_rig
from asterism.recordings.recorder import FramesKept, Recorder
from asterism.server.__main__ import main
from asterism.server.pose.place import apart
from tests.calibration.cameras.drawn import ROBOTS, record, reports, three, times, with_leds_off, write_rig
from tests.command.test_command_line import refused
from tests.several import Drive

FRAMES = 45
TRUE = three(4)
WRONG = Pose.from_matrix(exp_rotation(np.array([0.1, 0.1, -0.05])), np.array([0.1, -0.15, 0.05]))


class Films(NamedTuple):
    """The rigs' files and the recordings of the cameras in their order."""

    rigs: list[Path]
    recordings: list[Path]


@pytest.fixture(scope="module")
def films(tmp_path_factory: pytest.TempPathFactory) -> Films:
    """Three cameras: the second's world is wrong, the third's absent; its clock is 20 ms ahead."""
    folder, rng = tmp_path_factory.mktemp("films"), np.random.default_rng(8)
    places = [TRUE[0].T_world_camera, WRONG @ (TRUE[1].T_world_camera or Pose.identity()), None]
    stamps = [times(FRAMES), times(FRAMES), times(FRAMES, 0.03, 0.02)]
    rigs = [write_rig(folder, rig, place) for rig, place in zip(TRUE, places, strict=True)]
    recordings = [
        record(folder, load_rig(path), reports(rig, Drive(ROBOTS, 4), each, rng, T_world_camera=place))
        for path, rig, each, place in zip(rigs, TRUE, stamps, places, strict=True)
    ]
    return Films(rigs, recordings)


def calibrate(*words: object) -> int:
    return main(["calibrate", "cameras", *map(str, words)])


def check_places(folder: Path, T_world_first: Pose) -> None:
    """Every camera stands where it truly does against the first, as sure as its file says."""
    T_true_first = TRUE[0].T_world_camera
    assert T_true_first is not None
    for true in TRUE:
        rig = load_rig(folder / f"{true.camera.name}.yaml")
        assert rig.T_world_camera is not None
        assert true.T_world_camera is not None
        away = apart(T_world_first @ T_true_first.inverse() @ true.T_world_camera, rig.T_world_camera)
        known = place_error_of(rig.files, str(folder))
        assert known is not None
        assert known.by == "calibrate cameras, against camera left"
        sigmas = np.sqrt(np.diag(known.covariance))
        assert sigmas.max() < 3e-4
        assert (np.abs(away) < 4.5 * sigmas + 1e-6).all()


def test_every_rig_is_written_again(films: Films, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "placed"
    # In any order.
    assert calibrate(*films.recordings[::-1], *films.rigs, "-o", out) == 0
    assert TRUE[0].T_world_camera is not None
    check_places(out, TRUE[0].T_world_camera)
    for before in films.rigs:
        text = (out / before.name).read_text()
        assert "# by the eye" in text
        assert load_rig(out / before.name).camera.name == before.stem
    told = capsys.readouterr().out
    assert "recordings keep the rig they were made with" in told
    assert "the world is that of left's rig, whose camera stays where it is" in told
    assert re.search(r"third's clock is (19\.[89]|20\.[012])\d+ \+- 0\.0\d+ ms ahead of left's", told)
    assert re.search(r"capture: \{delay_us: (19[89]|20[012])\d\d\} in its rig takes that off", told)
    assert "ASSUMED" in told
    moved = next(line for line in told.splitlines() if line.startswith("right")).split()[-2]
    assert abs(float(moved) - 1e3 * _moved()) < 1.0
    # Nothing is replaced unasked, before any work is done.
    assert "exists; choose another name, or --force" in refused(
        capsys, "calibrate", "cameras", *films.rigs, *films.recordings, "-o", out
    )


def _moved() -> float:
    place = TRUE[1].T_world_camera
    assert place is not None
    return float(np.linalg.norm((WRONG @ place).position - place.position))


def test_without_a_world_the_first_camera_is_it_and_lenses_are_fitted_on_request(
    films: Films, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rigs = [write_rig(tmp_path / "in", rig, None) for rig in TRUE]
    for rig in rigs:  # the lens is known well
        rig.with_name(f"{rig.stem}.uncertainty.yaml").write_text(
            "# by Anna\nfocal_relative: 1e-6\nprincipal_point_px: 0.001\ndistortion_relative: 1e-6\n"
        )
    assert calibrate(*rigs, *films.recordings, "--lens", "-o", tmp_path / "out") == 0
    check_places(tmp_path / "out", Pose.identity())
    told = capsys.readouterr().out
    assert "the world is the frame of camera left, since its rig has none" in told
    assert re.search(r"third's lens: f (1399\.9|1400\.0)", told)
    assert "camera: right-camera.yaml" in (tmp_path / "out" / "right.yaml").read_text()
    assert "made_by: calibrate cameras" in (tmp_path / "out" / "right-camera.report.yaml").read_text()
    known = (tmp_path / "out" / "right.uncertainty.yaml").read_text()
    assert "# by Anna" in known
    assert "focal_relative" not in known


def test_constellations_that_do_not_move_give_the_world(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng, drive, stood = np.random.default_rng(9), Drive(ROBOTS, 4), Drive(ROBOTS, 4)(3.0)["r01"]
    T_new_old = Pose.from_matrix(exp_rotation(np.array([0.0, 0.0, 1.0])), np.array([2.0, 1.0, 0.5]))
    there = T_new_old @ stood
    fixed = f", fixed: {{position: {there.position.tolist()}, orientation: {there.orientation.tolist()}}}"
    rigs = []
    for rig in TRUE:
        path = write_rig(tmp_path, rig, rig.T_world_camera)
        path.write_text(re.sub(r"(  r01: .*)\}$", rf"\1{fixed}}}", path.read_text(), flags=re.MULTILINE))
        rigs.append(path)
    recordings = [
        record(tmp_path, load_rig(path), reports(
            rig, lambda at: {"r00": drive(at)["r00"], "r01": stood}, times(FRAMES), rng,
            T_world_camera=rig.T_world_camera))
        for path, rig in zip(rigs, TRUE, strict=True)
    ]  # fmt: skip
    assert calibrate(*rigs, *recordings, "-o", tmp_path / "out") == 0
    assert "the world is of the rigs' fixed constellations (r01)" in capsys.readouterr().out
    for true in TRUE:
        place = load_rig(tmp_path / "out" / f"{true.camera.name}.yaml").T_world_camera
        assert place is not None
        assert true.T_world_camera is not None
        away = apart(T_new_old @ true.T_world_camera, place)
        assert np.abs(away[:3]).max() < 2e-3
        assert np.abs(away[3:]).max() < 2e-3


def without_frames(folder: Path, path: Path) -> Path:
    """A recording in which the server only told how it does."""
    rig = load_rig(path)
    recorder = Recorder(folder, rig, "drawn", FramesKept(0), wait=True)
    recorder.write([Message(keys.status(rig.camera.name), STATUS, b"", 1, 1, 0)], None, 1, 0)
    recorder.close({})
    return recorder.folder


def test_what_does_not_go_together_is_refused(films: Films, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (left, right, _), (one, two, three_) = films
    out = tmp_path / "out"

    def told(*words: object) -> str:
        return refused(capsys, "calibrate", "cameras", *words, "-o", out)

    assert "1 camera, expected two or more" in told(left, one)
    assert f"{right}: no recording of its camera right is given, expected one" in told(left, right, one)
    assert f"{three_}: is of camera third, expected one of left, right, whose rigs are given" in told(
        left, right, one, two, three_
    )
    assert f"{one}: is of camera left, and so is {one}, expected one recording of every camera" in told(
        left, right, one, two, one
    )
    again = tmp_path / "again.yaml"
    again.write_text(left.read_text().replace("left-camera.yaml", str(left.with_name("left-camera.yaml"))))
    assert f"{again}: its camera is called left, and so is that of {left}" in told(left, again, one, two)
    assert "there is no such recording" in told(left, right, one, tmp_path / "nowhere")
    assert "holds no frame reports, expected what serve or locate recorded" in told(
        left, right, one, without_frames(tmp_path / "silent", right)
    )
    other = write_rig(tmp_path / "other", with_leds_off(TRUE, 1e-3, np.random.default_rng(1))[1], None)
    assert "robot 'r00' is another one in the rig of camera 'right' than in that of 'left': LED " in told(
        left, other, one, two
    )
    assert not out.exists()


def late(films: Films, folder: Path, rig: Rig, path: Path, first_s: float) -> Path:
    return record(folder, load_rig(path), reports(rig, Drive(ROBOTS, 4), times(20, first_s), np.random.default_rng(2)))


def test_recordings_of_other_times_are_refused(
    films: Films, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hours_later = late(films, tmp_path, TRUE[1], films.rigs[1], 7200.0)
    told = _two(films, hours_later, tmp_path, capsys)
    assert "recordings do not overlap in time: " in told
    assert "is from 2023-11-14 22:13:20 to 2023-11-14 22:13:22 UTC" in told
    # With what clocks may be apart they could.
    just_after = late(films, tmp_path, TRUE[1], films.rigs[1], 6.0)
    told = _two(films, just_after, tmp_path, capsys)
    assert "camera right shares no robot at the same time with left: drive one through both views" in told


def _two(films: Films, second: Path, folder: Path, capsys: pytest.CaptureFixture[str]) -> str:
    words: Sequence[object] = (*films.rigs[:2], films.recordings[0], second, "-o", folder / "out")
    return refused(capsys, "calibrate", "cameras", *words)


def test_a_world_that_others_rest_on_must_come_first(
    films: Films, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first = write_rig(tmp_path, TRUE[0], None)
    other = write_rig(tmp_path, TRUE[1], TRUE[1].T_world_camera)
    text = other.read_text()
    other.write_text(text.replace("radius: 0.0025}}", "radius: 0.0025}, normal: {world: [0, 0, 1], within_deg: 40}}"))
    told = refused(capsys, "calibrate", "cameras", first, other, *films.recordings[:2], "-o", tmp_path / "out")
    assert "the rig of left has no `world`, but that of right has robots whose `normal` or `fixed`" in told
    assert "name the rig of right first" in told
