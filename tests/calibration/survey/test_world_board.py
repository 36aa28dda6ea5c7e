"""A camera placed by a board on the floor, and what its lens' own error does to its place."""

import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from asterism.protocol.camera import Camera
from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose, exp_rotation, log_rotation
from asterism.protocol.rig import load_rig
from asterism.server.__main__ import main
from asterism.server.calibration.lens.board_points import Seen
from asterism.server.calibration.lens.bundle import State, View, refine
from asterism.server.calibration.lens.bundle import covariance_of as lens_covariance
from asterism.server.calibration.lens.camera_file import refit_report_text
from asterism.server.calibration.lens.targets import parse_target
from asterism.server.calibration.survey.world import fit_world
from asterism.server.calibration.survey.world_board import fit_board
from asterism.server.calibration.survey.world_lens import RobotError, with_systematic_errors
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.calibration.lens.boards import Lens, poses
from tests.calibration.survey.surveys import survey_pairs
from tests.calibration.survey.test_world import write_sim
from tests.chain.frames import disc_image
from tests.command.test_command_line import refused
from tests.helpers import assert_poses_close, facing_pose, random_pose
from tests.rigs import make_camera, make_rig

EXACT = np.zeros((9, 9))  # covariance of a lens without errors
BOARD = parse_target("chessboard:8x5:0.03")


def board_view(T_camera_board: Pose, name: str = "0", off: float | Floats = 0.0) -> View:
    points = BOARD.points
    return View(name, Seen(points, make_camera().project(T_camera_board.map(points)) + off))


@pytest.mark.parametrize("away", [True, False])
def test_the_world_is_the_board_with_z_to_the_camera(rng: np.random.Generator, away: bool) -> None:
    """Whichever way the board's own z points (OpenCV's chessboards point away from the camera)."""
    tilt = exp_rotation(np.array([0.4, -0.3, 0.2]))
    facing = tilt if away else tilt @ np.diag([1.0, -1.0, -1.0])
    T_camera_board = Pose.from_matrix(facing, np.array([-0.1, -0.05, 1.0]))
    fit = fit_board([board_view(T_camera_board)], make_camera(), EXACT)
    T_camera_world = fit.T_world_camera.inverse()
    assert fit.T_world_camera.position[2] > 0.5
    np.testing.assert_allclose(T_camera_world.position, T_camera_board.position, atol=1e-9)
    np.testing.assert_allclose(T_camera_world.rotation[:, 0], facing[:, 0], atol=1e-9)
    assert fit.rms_px[0] < 1e-8
    assert np.isnan(fit.held_out_px[0])


def test_the_boards_covariance_is_meant(rng: np.random.Generator) -> None:
    T_camera_board = Pose.from_matrix(exp_rotation(np.array([0.4, -0.3, 0.2])), np.array([-0.1, -0.05, 1.0]))
    true = fit_board([board_view(T_camera_board)], make_camera(), EXACT).T_world_camera
    squared = []
    for _ in range(40):
        fit = fit_board([board_view(T_camera_board, off=0.1 * rng.standard_normal((40, 2)))], make_camera(), EXACT)
        turned = log_rotation(true.rotation @ fit.T_world_camera.rotation.T)
        off = np.concatenate([true.position - fit.T_world_camera.position, turned])
        squared.append(off @ np.linalg.solve(fit.covariance, off))
    assert abs(np.mean(squared) - 6) < 4 * np.sqrt(12 / 40)


def weighted_error(found: Pose, covariance: Floats, true: Pose) -> float:
    turned = log_rotation(true.rotation @ found.rotation.T)
    off = np.concatenate([true.position - found.position, turned])
    return float(off @ np.linalg.solve(covariance, off))


def calibrated(camera: Camera, rng: np.random.Generator) -> tuple[Camera, Floats]:
    """The camera as a calibration from ten noisy views of a board finds it, and the covariance it tells."""
    target = parse_target("chessboard:9x6:0.05")
    lens = Lens((camera.width, camera.height), (camera.matrix[0, 0], camera.matrix[1, 1]))
    seen_from = poses(rng, 10, target.points.mean(axis=0), lens, 0.5, 0.7, 1.3, 0.6)
    views = [
        View(f"{k}", Seen(target.points, camera.project(pose.map(target.points)) + 0.1 * rng.standard_normal((54, 2))))
        for k, pose in enumerate(seen_from)
    ]
    start = State(camera, np.array([p.rotation for p in seen_from]), np.array([p.position for p in seen_from]))
    state = refine(views, start)
    return state.camera, lens_covariance(views, state)


def test_a_camera_placed_by_a_board_is_as_far_off_as_it_says_with_a_lens_that_is_calibrated_anew(
    rng: np.random.Generator,
) -> None:
    """Weighted squared errors average 6 when the lens' covariance is carried in, and are far beyond it when not."""
    true, trials = make_camera(), 40
    with_lens, without = [], []
    for _ in range(trials):
        camera, covariance = calibrated(true, rng)
        tilt = exp_rotation(np.array([rng.uniform(-0.6, 0.6), rng.uniform(-0.6, 0.6), rng.uniform(-3.0, 3.0)]))
        T_camera_board = Pose.from_matrix(tilt, np.array([rng.uniform(-0.3, 0.1), rng.uniform(-0.2, 0.1), 1.2]))
        view = board_view(T_camera_board, off=0.1 * rng.standard_normal((40, 2)))
        fit = fit_board([view], camera, covariance)
        placed = fit_board([board_view(T_camera_board)], true, EXACT).T_world_camera
        with_lens.append(weighted_error(fit.T_world_camera, fit.covariance, placed))
        without.append(weighted_error(fit.T_world_camera, fit.covariance - fit.of_lens, placed))
    assert abs(np.mean(with_lens) - 6.0) < 4 * np.sqrt(12 / trials)
    assert np.mean(without) > 12.0


def test_a_camera_placed_by_robots_is_as_far_off_as_it_says_with_a_lens_that_is_calibrated_anew(
    rng: np.random.Generator,
) -> None:
    true_rig, trials = make_rig(1, seed=4), 30
    with_lens, without = [], []
    for _ in range(trials):
        camera, covariance = calibrated(true_rig.camera, rng)
        T = random_pose(rng)
        true = replace(true_rig, T_world_camera=T)
        given = replace(true_rig, camera=camera)
        pairs = survey_pairs(true, given, [facing_pose(rng, (0.9, 1.4), (15.0, 50.0)) for _ in range(12)], rng)
        fit = fit_world(pairs, "survey")
        told, _ = with_systematic_errors(fit, given, covariance, {})
        with_lens.append(weighted_error(fit.T_world_camera, told.covariance, T))
        without.append(weighted_error(fit.T_world_camera, fit.covariance, T))
    assert 6 - 4 * np.sqrt(12 / trials) < np.mean(with_lens) < 1.15 * 6 + 4 * np.sqrt(12 / trials)
    assert np.mean(without) > 12.0


def test_a_camera_is_as_far_off_as_robots_with_a_wrong_frame_and_size_make_it(rng: np.random.Generator) -> None:
    """Frames and sizes drawn anew each time, as `calibrate leds` leaves them."""
    rig, trials, error = make_rig(1, seed=4), 30, RobotError(1e-3, 0.15e-3, 1e-3, 5e-3)
    known, unknown = [], []
    for _ in range(trials):
        T, robot = random_pose(rng), rig.robots[0]
        turn = exp_rotation(rng.standard_normal(3) * [error.tilt_rad, error.tilt_rad, error.turn_rad])
        leds = (1.0 + error.size_relative * rng.standard_normal()) * robot.leds
        leds = leds @ turn.T + error.frame_m * rng.standard_normal(3)
        given = replace(rig, robots=(replace(robot, leds=leds),))
        there = [facing_pose(rng, (0.9, 1.4), (15.0, 50.0)) for _ in range(12)]
        fit = fit_world(survey_pairs(replace(rig, T_world_camera=T), given, there, rng), "survey")
        told, shares = with_systematic_errors(fit, given, EXACT, {"r00": error})
        assert not shares.lens.any()
        known.append(weighted_error(fit.T_world_camera, told.covariance, T))
        unknown.append(weighted_error(fit.T_world_camera, fit.covariance, T))
    assert 6 - 4 * np.sqrt(12 / trials) < np.mean(known) < 1.15 * 6 + 4 * np.sqrt(12 / trials)
    assert np.mean(unknown) > 12.0


def test_dots_are_corrected_for_perspective(rng: np.random.Generator) -> None:
    """Large dots near the camera, seen obliquely: what is seen is the middle of their images."""
    target, camera = parse_target("acircles:4x7:0.03"), make_camera()
    T = Pose.from_matrix(exp_rotation(np.array([0.9, -0.4, 0.2])), np.array([-0.1, -0.05, 0.6]))
    seen = [disc_image(camera, centre, T.rotation[:, 2], 0.01) for centre in T.map(target.points)]
    view = View("0", Seen(target.points, np.array([s[0] for s in seen]), np.array([np.pi * s[1] * s[2] for s in seen])))
    plain = View("0", Seen(target.points, view.seen.pixels))
    shifts = view.seen.pixels - camera.project(T.map(target.points))
    assert np.abs(shifts).max() > 0.1
    off = [
        np.linalg.norm(fit_board([each], camera, EXACT).T_world_camera.inverse().position - T.position)
        for each in (view, plain)
    ]
    assert off[0] < 0.02 * off[1]


def test_boards_that_move_or_do_not_fit_are_refused(rng: np.random.Generator) -> None:
    T = Pose.from_matrix(exp_rotation(np.array([0.4, -0.3, 0.2])), np.array([-0.1, -0.05, 1.0]))
    with pytest.raises(InputError, match=r"frame 1: the target lies \d+\.\d px from where it was in frame 0"):
        fit_board([board_view(T), board_view(T, "1", np.array([3.0, 1.0]))], make_camera(), EXACT)
    with pytest.raises(InputError, match=r"px .RMS. from where a flat board of that size would show them"):
        fit_board([board_view(T, off=5.0 * rng.standard_normal((40, 2)))], make_camera(), EXACT)
    with pytest.raises(InputError, match="the target is in none of them"):
        fit_board([], make_camera(), EXACT)


def test_the_command_takes_a_chessboard(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A board of 8 x 5 inner corners, every sample of a pixel traced back to the floor; no lens errors, for brevity."""
    text = (DEMO_RIG.parent / "camera.yaml").read_text()
    (tmp_path / "camera.yaml").write_text(re.sub(r"(cols: 5\n\s+data: )\[.*\]", r"\1[0, 0, 0, 0, 0]", text))
    (tmp_path / "rig.yaml").write_text(DEMO_RIG.read_text())
    camera = load_rig(tmp_path / "rig.yaml").camera
    assert not camera.distortion.any()
    T_camera_board = Pose.from_matrix(exp_rotation(np.array([0.5, 0.1, 0.3])), np.array([-0.1, -0.08, 1.0]))
    finer, pitch, (x0, y0, x1, y1) = 3, 0.03, (300, 250, 900, 750)
    v, u = np.mgrid[: (y1 - y0) * finer, : (x1 - x0) * finer]
    pixels = (np.stack([u, v], axis=-1) + 0.5) / finer - 0.5 + [x0, y0]
    rays = (pixels - camera.matrix[:2, 2]) / np.diag(camera.matrix)[:2]
    # Where the ray meets the board: t + R (x, y, 0) = s (ray, 1).
    h = np.linalg.inv(np.column_stack([T_camera_board.rotation[:, :2], T_camera_board.position]))
    met = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], axis=-1) @ h.T
    x, y = met[..., 0] / met[..., 2] / pitch, met[..., 1] / met[..., 2] / pitch
    inside = (x > -1) & (x < 8) & (y > -1) & (y < 5)
    light = np.where(inside & ((np.floor(x) + np.floor(y)) % 2 == 0), 30.0, 200.0)
    image = np.full((camera.height, camera.width), 200.0)
    image[y0:y1, x0:x1] = light.reshape(y1 - y0, finer, x1 - x0, finer).mean(axis=(1, 3))
    (tmp_path / "frames").mkdir()
    assert cv2.imwrite(str(tmp_path / "frames" / "0.png"), np.rint(cv2.GaussianBlur(image, (0, 0), 0.8)))
    arguments = ["world", tmp_path / "rig.yaml", tmp_path / "frames", "--target", f"chessboard:8x5:{pitch}"]
    code = main(["calibrate", *map(str, arguments), "-o", str(tmp_path / "out.yaml")])
    told = capsys.readouterr()
    assert code == 0, told.err
    found = load_rig(tmp_path / "out.yaml").T_world_camera
    assert found is not None
    assert "the target is in 1 of 1 frames; the world's origin is its first point" in told.out
    assert "of that the lens: " in told.out
    assert "ASSUMED: f 0.050%, principal point 0.5 px, distortion 1.0%, since" in told.out
    # Counted from the light corner square, which is at the other end of how it was drawn.
    other = T_camera_board @ Pose(np.array([7 * pitch, 4 * pitch, 0.0]), np.array([0.0, 0.0, 1.0, 0.0]))
    flip = Pose(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    assert_poses_close(found, (other @ flip).inverse(), 0.5e-3, 1e-3)
    # The report of the camera's calibration is what holds, as long as it is this camera's.
    covariance = np.diag([4.0, 4.0, 0.01, 0.01, *[1e-8] * 5])
    (tmp_path / "camera.report.yaml").write_text(refit_report_text(camera, covariance, "somewhere", 3))
    code = main(["calibrate", *map(str, arguments), "-o", str(tmp_path / "again.yaml")])
    told = capsys.readouterr()
    assert code == 0, told.err
    assert "by calibrate z (" in told.out
    wrong = refit_report_text(replace(camera, matrix=1.01 * camera.matrix), covariance, "somewhere", 3)
    (tmp_path / "camera.report.yaml").write_text(wrong)
    assert "it is the report of another calibration" in refused(
        capsys, "calibrate", *arguments, "-o", tmp_path / "never.yaml"
    )


@pytest.mark.parametrize("target", ["chessboard:8x6:0.03", "chessboard:9x7:0.03", "circles:7x5:0.03"])
def test_a_board_that_looks_the_same_turned_about_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], target: str
) -> None:
    assert "looks the same turned about, which leaves the world's origin and axes open; expected" in refused(
        capsys, "calibrate", "world", DEMO_RIG, tmp_path, "--target", target, "-o", tmp_path / "out.yaml"
    )


def test_an_unknown_or_absent_board_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_sim(tmp_path / "sim", 1)
    arguments = ("calibrate", "world", DEMO_RIG, tmp_path / "sim" / "frames", "-o", tmp_path / "out.yaml")
    assert "the target chessboard:9x6:0.025 is in none of its 1 frames" in refused(
        capsys, *arguments, "--target", "chessboard:9x6:0.025"
    )
    assert "sim: has no end; calibrate world takes" in refused(
        capsys, "calibrate", "world", DEMO_RIG, "sim", "--target", "chessboard:9x6:0.025", "-o", tmp_path / "out.yaml"
    )
