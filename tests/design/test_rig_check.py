"""Checking a rig: bounds against numeric ones, flips against simulated noise, separations, verdicts, the command."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from asterism.protocol.constellation import confusions
from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.protocol.rig import Rig, Robot, load_rig
from asterism.server.__main__ import main
from asterism.server.command import design as design_command
from asterism.server.design.plate_design import Design, Request, design
from asterism.server.design.pose_bounds import leaning_poses, pose_bound
from asterism.server.design.rig_check import SIGMA_PX, check_rig
from asterism.server.pose.planar import solve_both
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.centres.bounds import pose_bound as numeric_bound
from tests.command.test_command_line import refused
from tests.rigs import make_camera, make_rig, random_layout

SIGMA = 0.05 / 1400


def plate(rng: np.random.Generator) -> Floats:
    return np.column_stack([random_layout(rng), np.zeros(6)])


def test_bounds_are_those_of_numeric_derivatives(rng: np.random.Generator) -> None:
    points = plate(rng)
    centred = points - points.mean(axis=0)
    squares = []
    for rotation, t in leaning_poses(1.2, 0.5):

        def project(motion: Floats, rotation: Floats = rotation, t: Floats = t) -> Floats:
            mapped = centred @ (exp_rotation(motion[3:]) @ rotation).T + t + motion[:3]
            return mapped[:, :2] / mapped[:, 2:]

        covariance = numeric_bound(project, np.zeros(6), np.tile(SIGMA**2 * np.eye(2), (6, 1, 1)))
        turned = rotation.T @ covariance[3:, 3:] @ rotation
        across = (covariance[0, 0] + covariance[1, 1]) / 2
        squares.append([across, covariance[2, 2], np.linalg.eigvalsh(turned[:2, :2])[1], turned[2, 2]])
    bound = pose_bound(points, 1.2, 0.5, SIGMA)
    told = [bound.across_m, bound.depth_m, bound.tilt_rad, bound.spin_rad]
    np.testing.assert_allclose(told, np.sqrt(np.mean(squares, axis=0)), rtol=1e-5)


def test_leaning_poses_lean_by_the_tilt_in_all_directions() -> None:
    normals = np.array([rotation[:, 2] for rotation, _ in leaning_poses(1.0, 0.3)])
    np.testing.assert_allclose(-normals[:, 2], np.cos(0.3))
    np.testing.assert_allclose(normals[:, :2].sum(axis=0), 0.0, atol=1e-12)


@pytest.mark.parametrize(("distance", "tilt_deg", "sigma_px"), [(2.0, 5, 0.05), (2.0, 15, 0.2), (1.2, 10, 0.2)])
def test_flips_are_as_frequent_as_with_simulated_noise(
    rng: np.random.Generator, distance: float, tilt_deg: float, sigma_px: float
) -> None:
    sigma, trials = sigma_px / 1400, 40
    information = np.tile([sigma**-2, 0.0, sigma**-2], (6, 1))
    rotations, ts, costs = np.empty((2, 3, 3)), np.empty((2, 3)), np.empty(2)
    told, wrong, poses = 0.0, 0, 0
    for points in (plate(rng) for _ in range(12)):
        centred = points - points.mean(axis=0)
        told += pose_bound(points, distance, np.radians(tilt_deg), sigma).flip / 12
        for rotation, t in leaning_poses(distance, np.radians(tilt_deg)):
            mapped = centred @ rotation.T + t
            for _ in range(trials):
                rays = mapped[:, :2] / mapped[:, 2:] + sigma * rng.standard_normal((6, 2))
                assert solve_both(centred, rays, information, 12, rotations, ts, costs)
                found, mirrored = rotations[0, :, 2], rotation[:, 2] * [-1, -1, 1]
                wrong += int(found @ mirrored > found @ rotation[:, 2])
                poses += 1
    assert wrong / poses == pytest.approx(told, abs=4 * np.sqrt(told / poses), rel=0.1)


def test_separations_are_those_of_the_rig() -> None:
    rig = make_rig(4, seed=3)
    found = check_rig(rig)
    layouts = [robot.leds_plane[:, :2] for robot in rig.robots]
    for hidden in (0, 1):
        every = list(confusions(layouts, hidden))
        for index, entry in enumerate(found.robots):
            mine = [c for c in every if index in (c.seen, c.taken)]
            assert entry.other[hidden] == min(c.separation for c in mine if c.seen != c.taken)
            assert entry.itself[hidden] == min(c.separation for c in mine if c.seen == c.taken)
        least = {entry.kind: entry.confusion.separation for entry in found.weakest if entry.hidden == hidden}
        assert least["two robots"] == min(entry.other[hidden] for entry in found.robots)
        assert least["one and itself"] == min(entry.itself[hidden] for entry in found.robots)
        assert least["mirror image"] == min(c.separation for c in confusions(layouts, hidden, mirrored=True))
    assert found.px(0.001, 60.0) == pytest.approx(0.001 * rig.camera.focal_px / 2.0 / 2)
    assert found.px(found.needed, found.tilt_deg) == pytest.approx(10 * SIGMA_PX)


def test_priors_of_normals_limit_the_tilt() -> None:
    assert check_rig(load_rig(DEMO_RIG)).tilt_deg == pytest.approx(40.0)
    assert check_rig(make_rig(1)).tilt_deg == 60.0


def test_leds_on_a_line_tell_no_pose() -> None:
    line = np.column_stack([[0.0, 0.02, 0.045, 0.06, 0.09], np.zeros((5, 2))])
    assert pose_bound(line, 1.0, 0.5, SIGMA).depth_m == np.inf
    robot = Robot("alpha", np.vstack([line, [0.03, 0.05, 0.0]]))
    verdict = check_rig(Rig(make_camera(), (robot,), range_m=(0.8, 2.0))).verdict()
    assert "poses: five LEDs on one line tell none when the sixth is hidden: alpha" in verdict


def lookalikes(shift: float, hidden_too: bool) -> Rig:
    """Two robots that differ in one LED by ``shift`` m; or in three of them."""
    rng = np.random.default_rng(8)
    one, other = plate(rng), np.empty((6, 3))
    other[:] = one
    other[0, 0] += shift
    if not hidden_too:
        other[3, 1] -= shift
        other[4, 0] += shift
    return Rig(make_camera(), (Robot("alpha", one), Robot("bravo", other)), range_m=(0.8, 2.0))


@pytest.mark.parametrize(
    ("rig", "words"),
    [
        (lambda: make_rig(2, seed=5), "identities: safe, also with one LED hidden"),
        (
            lambda: lookalikes(0.02, True),
            "identities: safe with all LEDs visible; with one hidden alpha, bravo can be mistaken",
        ),
        (lambda: lookalikes(0.001, True), "identities: NOT safe, even with all LEDs visible"),
    ],
)
def test_the_verdict_says_who_is_safe(rig: Callable[[], Rig], words: str) -> None:
    assert check_rig(rig()).verdict()[0].startswith(words)


def test_the_verdict_warns_of_mirror_images_and_tilts(rng: np.random.Generator) -> None:
    one = plate(rng)
    rig = Rig(make_camera(), (Robot("alpha", one), Robot("bravo", one * [-1, 1, 1])), range_m=(0.8, 2.0))
    _, mirrors, tilts = check_rig(rig).verdict()
    assert "mirror images in a polished surface: NOT safe" in mirrors
    assert "tilts: at 2 m and 10° or less" in tilts


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    def short(request: Request) -> Design:
        return design(request, 3000)

    monkeypatch.setattr(design_command, "design", short)


def test_design_writes_what_check_reads(quick: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "plates"
    asked = ["--robots", "3", "--disc", "0.1", "--spacing", "0.02", "--distance", "1.5", "--sigma", "0.05"]
    assert main(["design", *asked, "-o", str(out)]) == 0
    told = capsys.readouterr().out
    assert re.search(r"of two robots +one hidden +\d+\.\d\d", told)
    assert sorted(path.name for path in (out / "drill").iterdir()) == [
        f"r00{number}.{kind}" for number in (1, 2, 3) for kind in ("pdf", "svg")
    ]
    assert main(["check", str(out / "rig.yaml")]) == 0
    told = capsys.readouterr().out
    assert "3 robots, camera nominal (f = 1400 px), 0.75 to 1.5 m, tilted by up to 60°" in told
    assert "verdict identities: safe, also with one LED hidden" in told
    assert "verdict mirror images in a polished surface: safe, also with one LED hidden" in told
    assert "exists already, expected a new or empty folder" in refused(capsys, "design", *asked, "-o", out)


def test_check_tells_everything_of_the_demonstration(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(DEMO_RIG)]) == 0
    told = capsys.readouterr().out
    for words in ("alpha", "echo", "mirror image", "spin °", "wrong tilt %", "verdict tilts"):
        assert words in told
    assert len(re.findall(r"^(?:two robots|one and itself|mirror image) +(?:all visible|one hidden)", told, re.M)) == 6


def test_names_are_told_as_they_are(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "[bold]"
    folder.mkdir()
    (folder / "camera.yaml").write_text((DEMO_RIG.parent / "camera.yaml").read_text())
    (folder / "rig.yaml").write_text(DEMO_RIG.read_text().replace("alpha:", "'[red]':"))
    assert main(["check", str(folder / "rig.yaml")]) == 0
    told = capsys.readouterr().out
    assert "[bold]/rig.yaml: 5 robots" in told
    assert re.search(r"^\[red\] +\d", told, re.M)


def test_bad_input_gets_one_sentence(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    asked = ["design", "--robots", "3", "--disc", "0.1", "--spacing", "0.02", "--distance", "1.5", "--sigma", "0.05"]
    assert "nowhere.yaml: no such file" in refused(capsys, "check", "nowhere.yaml")
    assert "argument --robots: '0'" in refused(capsys, *asked, "--robots", "0", "-o", tmp_path / "x")
    assert "is that mm?" in refused(capsys, *asked, "--disc", "100", "-o", tmp_path / "x")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "note").write_text("keep")
    assert "expected a new or empty folder" in refused(capsys, *asked, "-o", tmp_path / "full")
    assert "expected a new or empty folder" in refused(capsys, *asked, "-o", tmp_path / "full" / "note")
    assert not (tmp_path / "x").exists()


def test_a_rig_in_the_world_is_judged_by_how_its_plates_can_lean() -> None:
    upright = Pose(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    assert check_rig(make_rig(1, T_world_camera=upright)).tilt_deg == 60.0
