"""Cameras placed by robots that they share, against the truth: places, sigmas, clocks, and laws that must hold."""

from dataclasses import replace

import numpy as np
import pytest

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Pose, exp_rotation
from asterism.server.calibration.cameras.calibration import CamerasFit, calibrate_cameras
from asterism.server.pose.place import apart
from tests.calibration.cameras.drawn import ROBOTS, error_of, seen_by, three, times, with_leds_off
from tests.several import Drive

FRAMES = 60
NO_LENS_ERROR = np.zeros((9, 9))


def placed(rigs, seen, lens=False):  # type: ignore[no-untyped-def]
    return calibrate_cameras(seen, rigs[0].robots, [NO_LENS_ERROR] * len(rigs), lens)


def weighted(fit: CamerasFit, rigs) -> list[float]:  # type: ignore[no-untyped-def]
    """Squared errors of the cameras' places, weighted by the covariances: 6 on average where these are meant."""
    errors = [error_of(each.T_first_camera, rigs, c) for c, each in enumerate(fit.cameras)][1:]
    spreads = [each.covariance for each in fit.cameras][1:]
    return [float(error @ np.linalg.solve(spread, error)) for error, spread in zip(errors, spreads, strict=True)]


def test_cameras_are_where_they_stand(rng: np.random.Generator) -> None:
    rigs = three()
    fit = placed(rigs, seen_by(rigs, rigs, [times(FRAMES)] * 3, rng))
    for camera in (1, 2):
        error = error_of(fit.cameras[camera].T_first_camera, rigs, camera)
        assert np.linalg.norm(error[:3]) < 1.5e-4
        assert np.degrees(np.linalg.norm(error[3:])) < 0.01
    assert max(weighted(fit, rigs)) < 25.0
    assert 0.9 < fit.noise < 1.1
    for each in fit.cameras:
        assert 0.016 < each.rms_px < 0.02
        assert each.rms_px < each.held_out_px < 1.1 * each.rms_px
        assert each.robots == ROBOTS
    assert max(fit.misfits_m.values()) < 3e-6
    # Exposed together, by clocks that agree.
    assert abs(fit.cameras[1].clock.offset_s) < 4 * fit.cameras[1].clock.offset_sigma_s < 4e-4


def test_clocks_that_are_apart_are_found_and_cost_nothing(rng: np.random.Generator) -> None:
    rigs = three(1)
    stamps = [times(FRAMES), times(FRAMES, 0.02, 0.0123, 2e-5), times(FRAMES, 0.04, -1.3)]
    fit = placed(rigs, seen_by(rigs, rigs, stamps, rng))
    assert max(weighted(fit, rigs)) < 25.0
    middle = FRAMES / 2 / 15.0
    for camera, offset, drift in ((1, 0.0123, 2e-5), (2, -1.3, 0.0)):
        clock = fit.cameras[camera].clock
        assert clock.told
        assert clock.offset_sigma_s < 1e-4
        assert abs(clock.offset_s - offset - drift * middle) < 4 * clock.offset_sigma_s
        assert abs(clock.drift - drift) < 4 * clock.drift_sigma


def test_leds_that_are_off_are_told_and_widen_the_distance(rng: np.random.Generator) -> None:
    rigs = three(2)
    believed = with_leds_off(rigs, 4e-4, rng)
    fit = placed(believed, seen_by(rigs, believed, [times(FRAMES)] * 3, rng))
    assert max(weighted(fit, rigs)) < 30.0
    for misfit in fit.misfits_m.values():
        assert 1.5e-4 < misfit < 1.1e-3
    # Two cameras far apart: how far is as sure as the robots' sizes, where to is not touched.
    sigmas = np.sqrt(np.diag(fit.cameras[1].covariance))
    assert 5e-4 < np.linalg.norm(sigmas[:3]) < 1e-2
    assert np.degrees(sigmas[3:].max()) < 0.01
    assert fit.cameras[1].rms_px < 0.02


def test_the_world_of_the_rigs_changes_nothing(rng: np.random.Generator) -> None:
    rigs = three()
    elsewhere = [
        replace(rig, T_world_camera=Pose.from_matrix(exp_rotation(np.array([0.1, -0.2, c])), np.array([0.2, c, 0.1])))
        for c, rig in enumerate(rigs[:2])
    ] + [replace(rigs[2], T_world_camera=None)]
    stamps = [times(30)] * 3
    one, other = (
        placed(believed, seen_by(rigs, believed, stamps, np.random.default_rng(5))) for believed in (rigs, elsewhere)
    )
    for a, b in zip(one.cameras, other.cameras, strict=True):
        assert np.abs(apart(a.T_first_camera, b.T_first_camera)).max() < 1e-8
        sigmas = [np.sqrt(np.diag(each.covariance)) for each in (a, b)]
        assert np.allclose(*sigmas, rtol=1e-2)


def test_the_order_of_cameras_changes_the_origin_only(rng: np.random.Generator) -> None:
    rigs = three()
    seen = seen_by(rigs, rigs, [times(40), times(40, 0.02), times(40, 0.04)], rng)
    fit, turned = placed(rigs, seen), placed(rigs, seen[::-1])
    T_first_last = fit.cameras[2].T_first_camera
    # Other moments are asked, of the same frames: near by what noise makes.
    for c in (0, 1):
        away = apart(fit.cameras[c].T_first_camera, T_first_last @ turned.cameras[2 - c].T_first_camera)
        assert (np.abs(away) < np.sqrt(np.diag(fit.cameras[2].covariance)).max()).all()


def test_a_lens_that_is_off_is_found_from_what_is_known_of_it(rng: np.random.Generator) -> None:
    rigs = three()
    camera = rigs[1].camera
    wrong = replace(camera, matrix=camera.matrix + np.array([[1.0, 0, 0.6], [0, 1.0, -0.5], [0, 0, 0]]))
    believed = [rigs[0], replace(rigs[1], camera=wrong), rigs[2]]
    known = np.diag([1.0**2, 1.0**2, 0.5**2, 0.5**2, *[1e-10] * 5])
    exact = np.diag([1e-8] * 4 + [1e-14] * 5)
    seen = seen_by(rigs, believed, [times(FRAMES)] * 3, rng, Drive(ROBOTS, radius_m=0.3, speed=0.3))
    fit = calibrate_cameras(seen, rigs[0].robots, [exact, known, exact], lens=True)
    found, spread = fit.cameras[1].lens, fit.cameras[1].lens_covariance
    assert found is not None
    assert spread is not None
    away = (found.matrix - camera.matrix)[[0, 1, 0, 1], [0, 1, 2, 2]]
    sigmas = np.sqrt(np.diag(spread))[:4]
    assert sigmas[0] < 0.8  # of 1 before
    assert (np.abs(away) < 4 * sigmas).all()
    assert max(weighted(fit, rigs)) < 30.0


def test_a_lens_that_is_not_fitted_has_its_share(rng: np.random.Generator) -> None:
    rigs = three()
    seen = seen_by(rigs, rigs, [times(30)] * 3, rng)
    error = np.zeros((9, 9))
    error[2, 2] = 0.5**2  # the principal point's x
    fit = calibrate_cameras(seen, rigs[0].robots, [NO_LENS_ERROR, error, NO_LENS_ERROR])
    # A principal point that is off turns the camera by as much.
    turned = np.sqrt(np.trace(fit.cameras[1].lens_share[3:, 3:]))
    assert 0.3 * 0.5 / 1400 < turned < 1.5 * 0.5 / 1400
    assert np.sqrt(np.trace(fit.cameras[2].lens_share[3:, 3:])) < 0.5 * turned


def test_a_camera_that_shares_no_robot_is_named(rng: np.random.Generator) -> None:
    rigs = three()
    seen = seen_by(rigs, rigs, [times(40), times(40), times(40)], rng)
    late = replace(seen[2], views=replace(seen[2].views, times_s=seen[2].views.times_s + 1000.0))
    with pytest.raises(InputError, match="camera third shares no robot at the same time with left or right: drive one"):
        placed(rigs, [*seen[:2], late])


def test_robots_that_stand_still_tell_places_and_no_clock(rng: np.random.Generator) -> None:
    rigs = three()
    drive = Drive(ROBOTS)
    stops = [drive(4.0 * k) for k in range(12)]
    # Two seconds at each place: between them nobody sees it.
    stamps = {k * 2.0 + i / 15.0: k * 2.0 + i / 15.0 for k in range(12) for i in range(3)}
    fit = placed(rigs, seen_by(rigs, rigs, [stamps] * 3, rng, lambda at: stops[int(at / 2.0 + 1e-9)]))
    assert max(weighted(fit, rigs)) < 30.0


def test_a_robot_that_never_moves_tells_no_clock(rng: np.random.Generator) -> None:
    rigs = three()
    stood = Drive(ROBOTS)(1.0)
    fit = placed(rigs, seen_by(rigs, rigs, [times(60)] * 3, rng, lambda _: stood))
    assert not fit.cameras[1].clock.told
    assert fit.cameras[1].clock.offset_s == 0.0
    error = error_of(fit.cameras[1].T_first_camera, rigs, 1)
    assert np.linalg.norm(error[:3]) < 5e-3
