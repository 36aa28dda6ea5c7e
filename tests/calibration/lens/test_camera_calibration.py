"""asterism calibrate camera: the lens from views of boards, rendered with a known lens (boards.py)."""

from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from asterism.protocol.camera import Camera, load_camera
from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.protocol.yaml_file import read_yaml
from asterism.server.__main__ import main
from asterism.server.calibration.lens.board_points import Seen, find_points
from asterism.server.calibration.lens.bundle import View, dot_shift
from asterism.server.calibration.lens.calibration import calibrate_camera, implausible, refuse_too_few
from asterism.server.calibration.lens.camera_file import camera_text
from asterism.server.calibration.lens.coverage import distinct, missing
from asterism.server.calibration.lens.fit import CameraFit, ends_inside, fit_camera
from asterism.server.calibration.lens.layout_match import match_layout
from asterism.server.calibration.lens.targets import Target, parse_target
from asterism.server.chain.frame import Frame
from asterism.server.service.telling import telling
from asterism.server.sources.images import read_pages, to_grey8
from tests.calibration.lens.boards import FISHEYE, Lens, chessboard, discs, poses, render
from tests.helpers import conic_centres, shared

LENS = Lens()
TRUE = Camera(
    "true", 640, 480, np.array([[610.0, 0, 325.0], [0, 612.0, 236.0], [0, 0, 1]]), "plumb_bob",
    np.array(LENS.coefficients),
)  # fmt: skip


def silent(_: str) -> None:
    """Nobody listens."""


def seen_by(camera: Camera, target: Target, pose: Pose, rng: np.random.Generator, noise: float = 0.05) -> View:
    """What a detector without faults would tell."""
    pixels = camera.project(pose.map(target.points)) + noise * rng.standard_normal((len(target.points), 2))
    return View(f"{rng.integers(1 << 30)}", Seen(target.points, pixels))


def seen_often(
    camera: Camera, target: Target, rng: np.random.Generator, count: int = 12, tilt: float = 0.6, reach: float = 0.5
) -> list[View]:
    lens = Lens(focal=(camera.matrix[0, 0], camera.matrix[1, 1]))
    middle = target.points.mean(axis=0)
    return [seen_by(camera, target, pose, rng) for pose in poses(rng, count, middle, lens, reach, 0.35, 0.7, tilt)]


def values(camera: Camera) -> Floats:
    m = camera.matrix
    return np.array([m[0, 0], m[1, 1], m[0, 2], m[1, 2], *camera.distortion])


def assert_true(fit: CameraFit, lens: Lens, sigmas: float = 4.5) -> None:
    """Every parameter is within so many standard deviations, and a hundredth of a pixel, of the truth."""
    off = np.abs(values(fit.camera) - lens.parameters)
    assert (off <= sigmas * np.array(list(fit.sigmas.values())) + 1e-6).all(), (off, fit.sigmas)


def rendered(
    printed: tuple[Callable[[Floats, Floats], Floats], tuple[float, float, float, float]], target: Target, lens: Lens,
    rng: np.random.Generator, count: int, near: float, far: float,
) -> list[View]:  # fmt: skip
    middle, views = target.points.mean(axis=0), []
    for k, pose in enumerate(poses(rng, count, middle, lens, 0.35, near, far, 0.55)):
        seen = find_points(render(lens, pose, *printed, rng), target)
        if seen is not None:
            views.append(View(f"{k}.png", seen))
    return views


def test_a_chessboards_lens_is_found_within_its_standard_deviations(rng: np.random.Generator) -> None:
    target = parse_target("chessboard:9x6:0.025")
    views = rendered(chessboard(9, 6, 0.025), target, LENS, rng, 7, 0.32, 0.55)
    assert len(views) >= 6
    fit = fit_camera(views, 640, 480, "plumb_bob")
    assert fit is not None
    assert fit.total_rms_px < 0.08
    assert_true(fit, LENS)


@pytest.mark.parametrize("text", ["chessboard:10x6:0.025", "chessboard:9x7:0.025", "chessboard:8x6:0.025"])
def test_a_chessboard_of_another_size_is_not_found(rng: np.random.Generator, text: str) -> None:
    printed = chessboard(9, 6, 0.025)
    turn = exp_rotation(np.array([0.2, 0.1, 0.05]))
    pose = Pose.from_matrix(turn, np.array([0.0, 0.0, 0.45]) - turn @ np.array([0.1, 0.0625, 0.0]))
    image = render(LENS, pose, *printed, rng)
    assert find_points(image, parse_target("chessboard:9x6:0.025")) is not None
    assert find_points(image, parse_target(text)) is None


@pytest.mark.parametrize(("text", "inverted"), [("circles:7x5:0.03", False), ("acircles:4x9:0.02", True)])
def test_dots_are_centred_where_they_are_and_not_where_they_seem(
    rng: np.random.Generator, text: str, inverted: bool
) -> None:
    target = parse_target(text)
    printed = discs(target.points, 0.0095, 0.03, *((210.0, 25.0) if inverted else (25.0, 210.0)))
    views = rendered(printed, target, LENS, rng, 7, 0.3, 0.5)
    assert len(views) >= 6
    fit = fit_camera(views, 640, 480, "plumb_bob")
    assert fit is not None
    assert_true(fit, LENS, 6.0)
    # Seen aslant from near, the centre of gravity is not the centre's image.
    middle = target.points.mean(axis=0)
    turn = exp_rotation(np.array([0.6, 0.1, 0.0]))
    pose = Pose.from_matrix(turn, np.array([0.0, 0.0, 0.3]) - turn @ middle)
    seen = find_points(render(LENS, pose, *printed, rng), target)
    assert seen is not None
    off = seen.pixels - LENS.project(pose.map(seen.points))
    which = np.zeros(len(off), np.int64)
    shift = dot_shift(TRUE, pose.rotation[None], pose.position[None], seen.points, which, 0.0095)
    assert np.linalg.norm(shift, axis=1).mean() > 0.03
    assert (off * shift).sum() / (shift**2).sum() == pytest.approx(1.0, abs=0.15)
    assert np.linalg.norm(off - shift, axis=1).mean() < 0.02


def test_the_shift_of_a_dot_is_that_of_its_ellipse(rng: np.random.Generator) -> None:

    camera = Camera("c", 640, 480, np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]]), "plumb_bob", np.zeros(5))
    points = np.column_stack([rng.uniform(-0.1, 0.1, (20, 2)), np.zeros(20)])
    turn = exp_rotation(np.array([0.7, -0.3, 0.2]))
    pose = Pose.from_matrix(turn, np.array([0.02, 0.01, 0.5]))
    shift = dot_shift(
        camera, pose.rotation[None], pose.position[None], points, np.zeros(20, np.int64), 0.01
    )  # fmt: skip
    true = (conic_centres(pose, points, 0.01) - (pose.map(points)[:, :2] / pose.map(points)[:, 2:])) * 600.0
    np.testing.assert_allclose(shift, true, atol=0.02 * np.abs(true).max())
    assert np.abs(true).max() > 0.1


def test_a_charuco_board_is_known_in_part_and_of_whatever_dictionary(rng: np.random.Generator) -> None:
    target = parse_target("charuco:7x5:0.03")
    for name, share in (("DICT_5X5_100", 0.7), ("DICT_4X4_50", 0.55)):
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
        board = cv2.aruco.CharucoBoard((7, 5), 0.03, share * 0.03, dictionary)
        sheet = np.asarray(board.generateImage((1400, 1000)), np.float64)

        def printed(x: Floats, y: Floats, sheet: NDArray[np.float64] = sheet) -> Floats:
            # The sheet's corner is one square beside the first inner corner.
            u, v = np.floor((x / 0.03 + 1.0) * 200).astype(int), np.floor((y / 0.03 + 1.0) * 200).astype(int)
            inside = (u >= 0) & (u < 1400) & (v >= 0) & (v < 1000)
            light = np.where(inside, sheet[np.clip(v, 0, 999), np.clip(u, 0, 1399)] * 0.7 + 25.0, np.nan)
            rim = (u > -200) & (u < 1600) & (v > -200) & (v < 1200)
            return np.where(inside, light, np.where(rim, 210.0, np.nan))

        box = (-0.06, -0.06, 0.21, 0.15)
        middle = target.points.mean(axis=0)
        whole = Pose.from_matrix(exp_rotation(np.array([0.3, -0.2, 0.1])), np.array([0.0, 0.0, 0.4]) - middle)
        aside = Pose(whole.position + np.array([0.12, 0.0, 0.0]), whole.orientation)
        for pose, least in ((whole, 24), (aside, 8)):
            seen = find_points(render(LENS, pose, printed, box, rng), target)
            assert seen is not None
            assert least <= len(seen.points) <= 24
            off = np.linalg.norm(seen.pixels - LENS.project(pose.map(seen.points)), axis=1)
            assert np.median(off) < 0.1
            assert off.max() < 0.6


def test_an_led_board_is_told_from_the_lights_beside_it(rng: np.random.Generator) -> None:
    board = rng.uniform(-0.1, 0.1, (14, 2))
    while np.min(np.linalg.norm(board[:, None] - board[None], axis=-1) + np.eye(14)) < 0.02:
        board = rng.uniform(-0.1, 0.1, (14, 2))
    for layout in (board, board[:6]):
        right = 0
        for pose in poses(rng, 20, np.zeros(3), LENS, 0.4, 0.4, 0.8, 0.5):
            facing = Pose.from_matrix(pose.rotation @ np.diag([1.0, -1.0, -1.0]), pose.position)
            image = LENS.project(facing.map(np.column_stack([layout, np.zeros(len(layout))])))
            spots = np.concatenate([image, rng.uniform([0, 0], [640, 480], (5, 2))])
            order = rng.permutation(len(spots))
            chosen = match_layout(spots[order] + 0.02 * rng.standard_normal(spots.shape), layout)
            if chosen is None:
                continue
            lit = chosen >= 0
            assert (order[chosen[lit]] == np.nonzero(lit)[0]).mean() > 0.8 or len(layout) == 6
            right += bool((order[chosen[lit]] == np.nonzero(lit)[0]).all())
        assert right >= 15
    assert match_layout(rng.uniform([0, 0], [640, 480], (12, 2)), board) is None
    mirrored = LENS.project(np.column_stack([board, np.full(14, 0.6)]))
    assert match_layout(mirrored, board) is None


def test_auto_takes_the_lens_that_it_is(rng: np.random.Generator) -> None:
    target = parse_target("chessboard:9x6:0.025")
    for model, coefficients in (
        ("plumb_bob", LENS.coefficients), ("equidistant", (-0.02, 0.01, -0.004, 0.0)),
    ):  # fmt: skip
        focal = 610.0 if model == "plumb_bob" else 320.0
        camera = Camera(
            "c", 640, 480, np.array([[focal, 0, 325], [0, focal, 236], [0, 0, 1]]), model, np.array(coefficients)
        )
        views = seen_often(camera, target, rng, 10, reach=0.75)
        fit, held_out = calibrate_camera(views, 640, 480, target, "auto", silent)
        assert fit.camera.model == model
        assert set(held_out) == {"plumb_bob", "rational_polynomial", "equidistant"}
        assert held_out[model] < 0.09


def test_a_fisheye_is_found_from_rendered_views(rng: np.random.Generator) -> None:
    target = parse_target("chessboard:9x6:0.025")
    views = rendered(chessboard(9, 6, 0.025), target, FISHEYE, rng, 7, 0.16, 0.28)
    assert len(views) >= 5
    fit = fit_camera(views, 640, 480, "equidistant")
    assert fit is not None
    assert_true(fit, FISHEYE)


def test_sigmas_are_meant(rng: np.random.Generator) -> None:
    target = parse_target("chessboard:9x6:0.025")
    off = []
    for _ in range(12):
        fit = fit_camera(seen_often(TRUE, target, rng, 8), 640, 480, "plumb_bob")
        assert fit is not None
        wrong = values(fit.camera) - values(TRUE)
        off.append(wrong @ np.linalg.solve(fit.covariance, wrong))
    assert 5.5 < np.mean(off) < 14.0  # 9 on average, +- 1.2


def test_a_bad_view_and_a_bad_point_are_left_out_and_told(rng: np.random.Generator) -> None:
    target = parse_target("chessboard:9x6:0.025")
    views = seen_often(TRUE, target, rng, 12)
    bent = views[3].seen.pixels + 2.0 * np.sin(views[3].seen.points[:, :1] * 40.0)
    views[3] = View("bent.png", Seen(target.points, bent))
    views[5].seen.pixels[7] += [4.0, -3.0]
    fit = fit_camera(views, 640, 480, "plumb_bob")
    assert fit is not None
    assert [name for name, _ in fit.odd_views] == ["bent.png"]
    assert fit.odd_points == 1
    assert_true(fit, LENS)
    assert 0.06 < fit.total_rms_px < fit.total_held_out_px < 0.085  # 0.05 px in x and y


def test_what_was_not_covered_is_said(rng: np.random.Generator) -> None:
    target = parse_target("chessboard:9x6:0.025")
    good = fit_camera(seen_often(TRUE, target, rng, 30, reach=0.8), 640, 480, "plumb_bob")
    few = fit_camera(seen_often(TRUE, target, rng, 6, tilt=0.2, reach=0.1), 640, 480, "plumb_bob")
    assert good is not None
    assert few is not None
    assert missing(good) == []
    told = " ".join(missing(few))
    for words in ("top left", "bottom right", "tilt about x"):
        assert words in told


def test_a_films_views_are_thinned_to_those_that_differ(rng: np.random.Generator) -> None:
    target = parse_target("chessboard:9x6:0.025")
    still, others = seen_often(TRUE, target, rng, 1)[0], seen_often(TRUE, target, rng, 30)
    film = [still] * 400 + others
    chosen = distinct(film)
    assert len(chosen) < 80
    assert sum(view is still for view in chosen) < 20
    assert all(any(view is other for view in chosen) for other in others)


def test_views_that_tell_nothing_are_refused(rng: np.random.Generator) -> None:
    target = parse_target("chessboard:9x6:0.025")
    with pytest.raises(InputError, match=r"board's tilts differ by \d+ degrees .* tilted by 20 to 45 degrees"):
        calibrate_camera(seen_often(TRUE, target, rng, 10, tilt=0.01), 640, 480, target, "plumb_bob", silent)
    with pytest.raises(InputError, match="found in 3 of 9 images, expected it in 4 at least"):
        refuse_too_few(seen_often(TRUE, target, rng, 3), 9, target, "views/", [])
    wide = parse_target("chessboard:6x9:0.025")
    turned = [View(view.frame, Seen(wide.points, view.seen.pixels)) for view in seen_often(TRUE, target, rng, 8)]
    with pytest.raises(InputError, match=r"are columns and rows of chessboard:6x9:0\.025 right"):
        calibrate_camera(turned, 640, 480, wide, "plumb_bob", silent)


def test_absurd_distances_hint_at_the_unit(rng: np.random.Generator) -> None:
    target = parse_target("chessboard:9x6:0.025")
    fit = fit_camera(seen_often(TRUE, target, rng, 6), 640, 480, "plumb_bob")
    assert fit is not None
    assert implausible(fit) is None
    for scale, words in ((100.0, "m away; is PITCH in m"), (0.001, "mm away; is PITCH in m")):
        scaled = parse_target(f"chessboard:9x6:{min(0.025 * scale, 0.9)}")
        views = [View(v.frame, Seen(scaled.points * (0.025 * scale / scaled.pitch), v.seen.pixels)) for v in fit.views]
        other = fit_camera(views, 640, 480, "plumb_bob")
        assert other is not None
        assert words in (implausible(other) or "")


def test_the_written_file_is_the_lens(tmp_path: Path, rng: np.random.Generator) -> None:
    small = Camera("cam", 640, 480, TRUE.matrix, "plumb_bob", np.array([-0.1, 1e-5, -3e-12, 2e20, 0.0]))
    (tmp_path / "c.yaml").write_text(camera_text(small))
    again = load_camera(tmp_path / "c.yaml")
    np.testing.assert_allclose(again.matrix, small.matrix, rtol=1e-11)
    np.testing.assert_allclose(again.distortion, small.distortion, rtol=1e-11)
    assert not ends_inside(TRUE)
    assert ends_inside(Camera("cam", 640, 480, TRUE.matrix, "plumb_bob", np.array([-2.0, 0.0, 0.0, 0.0, 0.0])))


def test_a_film_by_hand_calibrates_the_simulated_camera(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from asterism.server.simulation.demo_rig import DEMO_RIG

    leds = "".join(f"  - {list(led)}\n" for led in _leds(DEMO_RIG))
    (tmp_path / "board.yaml").write_text("leds:\n" + leds)
    assert main(["simulate", str(DEMO_RIG), str(tmp_path / "film"), "--hand", "alpha", "--frames", "30"]) == 0
    out = tmp_path / "cam.yaml"
    target = f"leds:{tmp_path / 'board.yaml'}"
    arguments = ["calibrate", "camera", str(tmp_path / "film" / "frames"), "--target", target, "-o", str(out)]
    assert main(arguments) == 0
    true, found = load_camera(DEMO_RIG.parent / "camera.yaml"), load_camera(out)
    report = read_yaml(tmp_path / "cam.report.yaml").section("sigmas")
    for index, name in enumerate(("fx", "fy", "cx", "cy")):
        assert abs(values(found)[index] - values(true)[index]) < 5.0 * report.number(name)
    assert report.number("fx") < 5.0
    assert found.name == "cam"
    assert {path.name for path in tmp_path.glob("cam.*")} == {
        "cam.yaml", "cam.report.yaml", "cam.coverage.png", "cam.residuals.png",
    }  # fmt: skip
    capsys.readouterr()
    assert main(arguments) == 2
    assert "exists; choose another name, or --force" in capsys.readouterr().err


def _leds(rig: Path) -> list[list[float]]:
    from asterism.protocol.rig import load_rig

    rows: list[list[float]] = load_rig(rig).robot("alpha").leds.tolist()
    return rows


def test_the_real_chessboard() -> None:
    folder = shared("real", "chessboard")
    target = parse_target("chessboard:9x6:0.025")
    views = []
    for path in sorted(folder.glob("*.jpg")):
        ((name, image),) = read_pages(path, lambda *_: None)
        seen = find_points(to_grey8(image, None, name), target)
        if seen is not None:
            views.append(View(path.name, seen))
    assert len(views) == 13
    fit = fit_camera(views, 640, 480, "plumb_bob")
    assert fit is not None
    assert fit.total_rms_px < 0.25
    assert abs(fit.camera.focal_px / 535.916 - 1.0) < 0.01
    assert fit.total_held_out_px < 0.25


def test_a_live_camera_gives_still_and_new_views_and_is_told_where_next(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from asterism.server.command import calibrate_camera as command

    target = parse_target("chessboard:9x6:0.025")
    held = seen_often(TRUE, target, rng, 60, reach=0.8)
    # Moving, held, held a little longer; then on to the next place.
    shown = [view.seen for other in held for view in (seen_by(TRUE, target, _shaken(rng), rng), other, other, other)]

    class Live:
        live, length = True, None

        def frames(self) -> Iterator[Frame]:
            for index in range(len(shown)):
                yield Frame(np.zeros((480, 640), np.uint8), index, index, str(index))
            raise KeyboardInterrupt

    monkeypatch.setattr(command, "find_points", lambda *_: shown[search.looked_at - 1])
    search = command._Search(target)
    with telling():
        command._watch(Live(), search)  # type: ignore[arg-type]
    assert command.ENOUGH_VIEWS <= len(search.views) <= len(held)
    assert all(any(view.seen is other.seen for other in held) for view in search.views)
    told = capsys.readouterr().err
    first = told[told.index("1 views; ") :].splitlines()[0]
    assert "." in first
    assert "next: " in first
    assert told.rstrip().endswith("all covered")


def _shaken(rng: np.random.Generator) -> Pose:
    return Pose.from_matrix(
        exp_rotation(rng.uniform(-0.3, 0.3, 3)), np.array([*rng.uniform(-0.2, 0, 2), rng.uniform(0.5, 0.8)])
    )
