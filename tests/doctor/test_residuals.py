"""Residuals without what poses take up: LEDs that are off, lenses that are off, cameras that moved."""

from dataclasses import replace

import numpy as np
import pytest

from asterism.protocol.geometry import Pose, exp_rotation
from asterism.protocol.rig import Rig
from asterism.server.doctor.calibration import lens_errors
from asterism.server.doctor.constellations import check_positions, misfit_of
from asterism.server.doctor.exposure import check_dim
from asterism.server.doctor.finding import Verdict
from asterism.server.doctor.gather import Gathered, Sightings
from asterism.server.doctor.place import check_place, judge_place
from asterism.server.doctor.residuals import Whitened, whitened
from asterism.server.doctor.shutter import check_shutter, line_time
from tests.doctor.drawn import PERIOD_NS, driving, gathered, moved_on, sightings, standing_still
from tests.measure.doctor_streams import standing, with_focal
from tests.rigs import make_rig

RIG = make_rig(3, 5)


def chi2_per_freedom(told: Whitened) -> float:
    """1 where the spots' covariances say all."""
    return float((told.residuals**2).sum() / told.freedom.sum())


def moved(rig: Rig, robot: int, led: int, off_m: float) -> Rig:
    """The rig with one LED elsewhere in its plane."""
    leds = rig.robots[robot].leds.copy()
    leds[led, :2] += off_m * np.array([0.6, 0.8])
    robots = list(rig.robots)
    robots[robot] = replace(robots[robot], leds=leds)
    return replace(rig, robots=tuple(robots))


def test_what_a_pose_takes_up_leaves_nothing_and_noise_leaves_one(rng: np.random.Generator) -> None:
    poses = driving(RIG, 60, rng)
    seen = sightings(RIG, RIG, poses, rng)
    assert chi2_per_freedom(whitened(RIG, seen)) == pytest.approx(1.0, abs=0.1)
    push = [Pose.from_matrix(exp_rotation(1e-4 * rng.normal(size=3)), 1e-4 * rng.normal(size=3)) for _ in RIG.robots]
    pushed = sightings(RIG, RIG, [[a @ b for a, b in zip(row, push, strict=True)] for row in poses], rng)
    away = pushed._replace(poses=seen.poses, residuals=pushed.centres - seen.centres + seen.residuals)
    assert chi2_per_freedom(whitened(RIG, away)) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("off_m", [0.1e-3, 0.5e-3])
def test_the_led_that_is_off_is_named_with_its_error(off_m: float, rng: np.random.Generator) -> None:
    for robot, led in ((0, 2), (1, 5), (2, 0)):
        told = moved(RIG, robot, led, off_m)
        seen = sightings(told, RIG, driving(RIG, 60, rng), rng)
        misfit = misfit_of(told, seen.of(robot))
        assert misfit is not None
        assert misfit.led == led
        assert misfit.led_m == pytest.approx(off_m, abs=4.0 * misfit.sigma_m + 0.05 * off_m)
        finding = check_positions(gathered(told, seen), "rig.yaml")
        assert finding.verdict > Verdict.GOOD
        assert finding.measured.startswith(f"{RIG.robots[robot].id}: LED {led} is")
        assert f"calibrate leds rig.yaml RECORDING --robot {RIG.robots[robot].id}" in finding.advice


def test_a_good_rig_is_called_good_whatever_the_seed() -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        seen = sightings(RIG, RIG, driving(RIG, 30, rng), rng)
        assert check_positions(gathered(RIG, seen), "rig.yaml").verdict == Verdict.GOOD
        errors = lens_errors(RIG, seen)
        assert errors is not None
        assert not errors.focal.sure
        assert not errors.bend.sure


def test_a_wrong_focal_length_is_as_far_off_as_its_sigma_says(rng: np.random.Generator) -> None:
    """Where poses are told by another lens, they take up what they can: here all of it is in the residuals."""
    told = replace(RIG, camera=with_focal(RIG.camera, 1.05))
    scores = []
    for _ in range(6):
        errors = lens_errors(told, sightings(told, RIG, driving(RIG, 60, rng), rng))
        assert errors is not None
        scores.append((errors.focal.value + 0.05) / errors.focal.sigma)
        assert errors.focal.sigma < 0.02
    assert abs(np.mean(scores)) < 3.0


def rolled(line_us: float, rng: np.random.Generator, hidden: float) -> Gathered:
    """Robots at 0.2 m/s, each LED where it is when its own row is exposed; some of them hidden."""
    step_m, still = 0.2 * PERIOD_NS * 1e-9, standing_still(RIG, rng)
    seen = sightings(RIG, RIG, [[moved_on(pose, frame, step_m) for pose in still] for frame in range(90)], rng)
    for k, (frame, robot) in enumerate(zip(seen.frames.tolist(), seen.robots.tolist(), strict=True)):
        for led in range(6):
            late = 1e3 * line_us * (seen.centres[k, led, 1] - 0.5 * RIG.camera.height) / PERIOD_NS
            moved = moved_on(still[robot], frame + late, step_m), moved_on(still[robot], frame, step_m)
            here, there = (RIG.camera.project(pose.map(RIG.robots[robot].leds[led])) for pose in moved)
            seen.centres[k, led] += here - there
            seen.residuals[k, led] += here - there
    dark = rng.random(seen.heights.shape) < hidden
    for column in (seen.centres, seen.residuals, seen.covariances, seen.heights):
        column[dark] = np.nan
    return gathered(RIG, seen)


@pytest.mark.parametrize("hidden", [0.0, 0.03])
def test_the_time_between_rows_is_told_within_its_sigma(hidden: float, rng: np.random.Generator) -> None:
    for line_us, verdict in ((0.0, Verdict.GOOD), (15.0, Verdict.WRONG), (-30.0, Verdict.WRONG)):
        told = rolled(line_us, rng, hidden)
        found = line_time(told)
        assert found is not None
        assert abs(found.value - line_us) < 4.0 * found.sigma
        assert found.sigma < 2.5
        assert check_shutter(told).verdict == verdict


def still(told: Rig, true: Rig, frames: int, rng: np.random.Generator) -> Sightings:
    """The sightings of what stands still."""
    assert true.T_world_camera is not None
    T_camera_world = true.T_world_camera.inverse()
    row = [T_camera_world @ (robot.T_world_fixed or Pose.identity()) for robot in true.robots]
    return sightings(told, true, [row] * frames, rng)


def fixed_only(seed: int) -> Rig:
    whole = standing(seed)
    return replace(whole, robots=whole.robots[2:])


def test_a_camera_that_moved_is_told_from_one_that_did_not(rng: np.random.Generator) -> None:
    rig = fixed_only(3)
    assert rig.T_world_camera is not None
    for tilt_deg, verdict in ((0.0, Verdict.GOOD), (0.02, Verdict.LOOK), (0.2, Verdict.WRONG)):
        turned = rig.T_world_camera.rotation @ exp_rotation(np.radians(tilt_deg) * np.array([1.0, 0.0, 0.0]))
        true = replace(rig, T_world_camera=Pose.from_matrix(turned, rig.T_world_camera.position))
        seen = still(rig, true, 20, rng)
        judged = judge_place(rig, seen)
        assert judged is not None
        finding = check_place(gathered(rig, seen), judged)
        assert finding.verdict == verdict
        assert not judged.lens


def test_an_led_that_is_dark_all_the_time_disturbs_nothing(rng: np.random.Generator) -> None:
    rig = fixed_only(6)
    seen = still(rig, rig, 20, rng)
    for column in (seen.centres, seen.residuals, seen.covariances, seen.heights):
        column[:, 3] = np.nan
    judged = judge_place(rig, seen)
    assert judged is not None
    assert not judged.sure
    assert check_positions(gathered(rig, seen), "rig.yaml").verdict == Verdict.GOOD
    assert check_dim(gathered(rig, seen)).measured.startswith("base0: LED 3 is dark")


def test_a_focal_length_is_told_from_a_motion(rng: np.random.Generator) -> None:
    rig = fixed_only(4)
    told = replace(rig, camera=with_focal(rig.camera, 1.003))
    judged = judge_place(told, still(told, rig, 20, rng))
    assert judged is not None
    assert "focal length -0.30 %" in judged.lens


def test_of_several_constellations_the_one_that_was_pushed_is_named(rng: np.random.Generator) -> None:
    rig = fixed_only(5)
    rest = replace(rig.robots[0], id="base2", T_world_fixed=Pose(np.array([0.3, 0.3, 0.0]), np.array([0, 0, 0, 1.0])))
    rig = replace(rig, robots=(*rig.robots, rest))
    pushed = replace(rig.robots[1], T_world_fixed=Pose(np.array([0.421, -0.3, 0.0]), np.array([0, 0, 0, 1.0])))
    true = replace(rig, robots=(rig.robots[0], pushed, rest))
    judged = judge_place(rig, still(rig, true, 20, rng))
    assert judged is not None
    assert judged.alone == "base1"
