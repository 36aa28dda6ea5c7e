"""`asterism calibrate world --fixed`: the camera's place from constellations that stand still."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.protocol.rig import Rig, load_rig
from asterism.server.__main__ import main
from asterism.server.calibration.rewrite import rewrite
from asterism.server.calibration.survey.fixed import FixedFit, Standing, fit_fixed
from asterism.server.pose.lens import lens_of
from asterism.server.pose.place import Pinned, apart, fit_place, linearized, moved
from asterism.server.pose.spot_shift import optics_of, spots_at
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.simulation.simulate import Scene
from tests.helpers import assert_poses_close, numeric_jacobian, random_pose
from tests.measure.drawn_frames import stage_rig

NO_LENS = np.zeros((9, 9))


def standing(rig: Rig, rng: np.random.Generator, noise_px: float, wrong: Rig | None = None) -> list[Standing]:
    """The rig's fixed constellations as its camera sees them; ``wrong``: the rig as it truly is."""
    true = wrong or rig
    assert true.T_world_camera is not None
    out = []
    for told, robot in zip(rig.robots, true.robots, strict=True):
        if robot.T_world_fixed is None:
            continue
        pose = true.T_world_camera.inverse() @ robot.T_world_fixed
        plane, pixels = pose @ robot.T_robot_plane, np.empty((1, 6, 2))
        spots_at(
            lens_of(true.camera), robot.leds_plane[None].copy(), optics_of(robot)[None].copy(), plane.rotation[None],
            plane.position[None].copy(), pixels,
        )  # fmt: skip
        off = Pose.from_matrix(exp_rotation(0.01 * rng.normal(size=3)), 2e-3 * rng.normal(size=3))
        out.append(Standing(told, 10, pixels[0] + noise_px * rng.normal(size=(6, 2)), (pose @ off,)))
    return out


def knocked(rig: Rig, rng: np.random.Generator, m: float = 3e-3, rad: float = 5e-3) -> Rig:
    """The rig with its camera elsewhere than it is."""
    assert rig.T_world_camera is not None
    move = np.concatenate([m * rng.normal(size=3), rad * rng.normal(size=3)])
    return replace(rig, T_world_camera=moved(rig.T_world_camera, move))


def fitted(rig: Rig, seen: list[Standing]) -> FixedFit:
    return fit_fixed(rig, seen, NO_LENS, {}, "film")


@pytest.mark.parametrize("fixed", [1, 2, 4])
def test_without_noise_the_place_is_exact(rng: np.random.Generator, fixed: int) -> None:
    rig = stage_rig(0, fixed, 3)
    assert rig.T_world_camera is not None
    fit = fitted(knocked(rig, rng), standing(rig, rng, 0.0))
    # What shifts spots is taken at poses that are 2 mm off here.
    assert_poses_close(fit.T_world_camera, rig.T_world_camera, 3e-5, 3e-5)


@pytest.mark.parametrize("fixed", [1, 2, 4])
def test_covariances_are_meant(rng: np.random.Generator, fixed: int) -> None:
    rig, nees = stage_rig(0, fixed, 3), []
    assert rig.T_world_camera is not None
    for _ in range(60):
        fit = fitted(knocked(rig, rng, 5e-4, 1e-3), standing(rig, rng, 0.05))
        off = apart(rig.T_world_camera, fit.T_world_camera)
        nees.append(float(off @ np.linalg.solve(fit.covariance, off)))
    assert 2.0 < float(np.median(nees)) < 9.0  # one constellation tells its own noise from six numbers


def moved_one(rig: Rig, which: int, by: Floats) -> Rig:
    """The rig in which one constellation truly stands elsewhere."""
    robots = list(rig.robots)
    place = robots[which].T_world_fixed
    assert place is not None
    robots[which] = replace(robots[which], T_world_fixed=Pose(place.position + by, place.orientation))
    return replace(rig, robots=tuple(robots))


def test_the_constellation_that_contradicts_the_others_is_named(rng: np.random.Generator) -> None:
    rig = stage_rig(0, 4, 3)
    true = moved_one(rig, 2, np.array([4e-3, -2e-3, 0.0]))
    with pytest.raises(InputError, match=r"film: r02 is [45]\.\d mm .* from where the other fixed constellations"):
        fitted(rig, standing(rig, rng, 0.03, true))
    pair = stage_rig(0, 2, 3)
    with pytest.raises(InputError, match="r00 and r01 contradict each other"):
        fitted(pair, standing(pair, rng, 0.03, moved_one(pair, 1, np.array([0.0, 0.0, 3e-2]))))


def test_a_survey_that_is_a_little_off_widens_the_covariance(rng: np.random.Generator) -> None:
    rig = stage_rig(0, 4, 3)
    assert rig.T_world_camera is not None
    exact = fitted(rig, standing(rig, rng, 0.03)).covariance
    true = moved_one(moved_one(rig, 1, np.array([3e-4, 0.0, 0.0])), 2, np.array([0.0, -4e-4, 2e-4]))
    fit = fitted(rig, standing(rig, rng, 0.03, true))
    assert np.trace(fit.covariance) > 2.0 * np.trace(exact)
    off = apart(rig.T_world_camera, fit.T_world_camera)
    assert off @ np.linalg.solve(fit.covariance, off) < 20.0


def test_derivatives_of_rays_by_the_place(rng: np.random.Generator) -> None:
    T = random_pose(rng)
    points = T.map(np.column_stack([rng.uniform(-0.4, 0.4, (9, 2)), rng.uniform(1.0, 1.5, 9)]))

    def rays(move: Floats) -> Floats:
        seen = moved(T, move).inverse().map(points)
        return np.asarray((seen[:, :2] / seen[:, 2:]).ravel(), np.float64)

    unit = np.tile(np.eye(2), (9, 1, 1))
    pinned = Pinned(points, rays(np.zeros(6)).reshape(-1, 2), 1e-10 * unit, 1e-12 * unit)
    by_move, off = linearized(pinned, T)
    np.testing.assert_allclose(by_move.reshape(18, 6), numeric_jacobian(rays, np.zeros(6)), atol=1e-8)
    assert np.abs(off).max() < 1e-12
    assert_poses_close(fit_place(pinned, moved(T, np.full(6, 0.02))).T_world_camera, T, 1e-9, 1e-9)


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Pose]:
    """Two of the demo's robots stand still before its camera, which is not where the rig has it any more."""
    folder = tmp_path_factory.mktemp("fixed")
    rig = load_rig(DEMO_RIG)
    scene = Scene(rig, 3)
    truth = scene.truth(0, 0.0)
    assert rig.T_world_camera is not None
    changes: dict[tuple[str, ...], dict[str, list[float]]] = {}
    for entry in truth[:2]:
        place = rig.T_world_camera @ entry.T_camera_robot
        fixed = {"position": place.position.round(7).tolist(), "orientation": place.orientation.round(9).tolist()}
        changes["robots", entry.robot, "fixed"] = fixed
    off = moved(rig.T_world_camera, np.array([2e-3, -1e-3, 3e-3, 4e-3, -2e-3, 3e-3]))
    changes[("world",)] = {"position": off.position.tolist(), "orientation": off.orientation.tolist()}
    (folder / "rig.yaml").write_text(rewrite(rig.rig_text, changes, "rig.yaml"))
    (folder / "camera.yaml").write_text(rig.camera_text)
    (folder / "frames").mkdir()
    for index in range(4):
        cv2.imwrite(str(folder / "frames" / f"{index}.png"), scene.render(index, truth))
    return folder, rig.T_world_camera


def test_the_command_puts_the_camera_where_it_is(
    film: tuple[Path, Pose], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, true = film
    monkeypatch.chdir(folder)
    assert main(["calibrate", "world", "rig.yaml", "frames", "--fixed", "-o", "new.yaml"]) == 0
    printed = capsys.readouterr().out
    assert "the camera is 3.7" in printed
    assert "camera in the world: " in printed
    new = load_rig(folder / "new.yaml")
    assert new.T_world_camera is not None
    assert_poses_close(new.T_world_camera, true, 2e-4, 2e-4)
    assert [robot.T_world_fixed is not None for robot in new.robots[:3]] == [True, True, False]


def test_a_rig_without_anything_fixed_is_refused(
    film: tuple[Path, Pose], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(film[0])
    Path("none.yaml").write_text(load_rig(DEMO_RIG).rig_text)
    assert main(["calibrate", "world", "none.yaml", "frames", "--fixed", "-o", "x.yaml"]) == 2
    assert "none.yaml: no robot is `fixed`" in capsys.readouterr().err
