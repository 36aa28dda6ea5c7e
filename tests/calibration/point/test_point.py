"""`calibrate_point`: on drawn spots, a point and sigmas that are meant; which frames it rests on; what is refused."""

import re
from dataclasses import replace

import numpy as np
import pytest

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.protocol.rig import Rig
from asterism.server.budget.uncertainty import Uncertainty
from asterism.server.calibration.point.calibration import PointCalibration
from asterism.server.simulation.hand_film import hand_pose
from tests.calibration.point.drawn import (
    ASSUMED,
    EXACT,
    POINT,
    calibrated,
    demo,
    drawn,
    pivots,
    tip_at,
    touches,
)

FRAMES = 60
PLACE = np.array([0.1, -0.05, 1.2])
FACING = np.diag([1.0, -1.0, -1.0])


@pytest.fixture(scope="module")
def rig() -> Rig:
    return demo()


def off(rig: Rig, found: PointCalibration) -> Floats:
    """Error (3,) m."""
    return np.asarray(found.point - rig.robots[0].points[POINT])


def shifted(poses: list[Pose], shifts: Floats) -> list[Pose]:
    """The poses moved by (n, 3) m: the point slips."""
    return [Pose(pose.position + shift, pose.orientation) for pose, shift in zip(poses, shifts, strict=True)]


def test_without_noise_the_point_is_exact(rig: Rig, rng: np.random.Generator) -> None:
    found = calibrated(drawn(rig, EXACT, pivots(rig, 30, 1), rng, noise=0.0), EXACT)
    assert np.abs(off(rig, found)).max() < 1e-8
    assert found.used.all()
    assert (found.play_m, found.wanders, found.leds_off) == (0.0, False, 1.0)


@pytest.mark.parametrize("told", [EXACT, ASSUMED], ids=["exact", "assumed"])
def test_sigmas_are_meant(rig: Rig, rng: np.random.Generator, told: Uncertainty) -> None:
    """Also where LEDs and lens are off, which no number of frames averages out."""
    cases = [calibrated(drawn(rig, told, pivots(rig, FRAMES, seed), rng), told) for seed in range(6)]
    errors, sigmas = np.array([off(rig, one) for one in cases]), np.array([one.sigmas for one in cases])
    weighted = np.mean([e @ np.linalg.solve(one.covariance, e) for e, one in zip(errors, cases, strict=True)])
    # 18 numbers of chi squared: 99.9 % of all.
    assert 0.8 < weighted < 7.1
    assert (np.abs(errors) < 3.0 * sigmas).mean() > 0.9
    if told is EXACT:
        assert np.sqrt((errors**2).mean(axis=0)).max() < 0.01e-3
    else:
        # LEDs that are off by 0.05 mm turn the plate, and a tool 42 mm away with it.
        assert sigmas.min() > 0.02e-3
        assert max(np.sqrt(np.diag(one.by_noise)).max() for one in cases) < 0.01e-3


def test_leds_that_are_farther_off_than_told_are_noticed(rig: Rig, rng: np.random.Generator) -> None:
    """A ruler's 0.4 mm, told as 0.05."""
    film = drawn(rig, Uncertainty(led_position_m=4e-4), pivots(rig, FRAMES, 2), rng)
    found = calibrated(film, ASSUMED)
    # Eleven numbers of the shape tell it, and so how sure the seven are that no film tells.
    assert 2.5 < found.leds_off < 16.0
    assert (np.abs(off(rig, found)) < 5.0 * found.sigmas).all()
    assert found.sigmas.min() > 0.1e-3


def test_one_mark_touched_from_many_sides(rig: Rig, rng: np.random.Generator) -> None:
    film = drawn(rig, EXACT, touches(rig, 6, 10, 8, rng), rng)
    found = calibrated(film, EXACT)
    rests = np.tile([True] * 10 + [False] * 8, 6)[[one.index for one in film.sightings]]
    assert (found.used != rests).sum() <= 1
    assert (np.abs(off(rig, found)) < 3.5 * found.sigmas).all()


@pytest.mark.parametrize("slip", [[0.3e-3, 0.0, 0.0], [0.0, 0.0, -2e-3]], ids=["aside", "lifted"])
def test_frames_in_which_it_slipped_are_left_out(rig: Rig, rng: np.random.Generator, slip: list[float]) -> None:
    slips = np.zeros((FRAMES, 3))
    slips[35:50] = slip
    found = calibrated(drawn(rig, EXACT, shifted(pivots(rig, FRAMES, 3), slips), rng), EXACT)
    assert (found.used == (slips == 0.0).all(axis=1)).sum() >= FRAMES - 2
    assert (np.abs(off(rig, found)) < 3.5 * found.sigmas).all()


def test_play_is_found_and_makes_sigmas_larger(rig: Rig, rng: np.random.Generator) -> None:
    poses = pivots(rig, FRAMES, 4)
    still = calibrated(drawn(rig, EXACT, poses, rng), EXACT)
    found = calibrated(drawn(rig, EXACT, shifted(poses, 1e-4 * rng.standard_normal((FRAMES, 3))), rng), EXACT)
    assert still.play_m < 0.02e-3
    assert 0.07e-3 < found.play_m < 0.13e-3
    assert found.used.mean() > 0.95
    assert (found.sigmas > 2.0 * still.sigmas).all()
    assert (np.abs(off(rig, found)) < 3.5 * found.sigmas).all()


def test_a_place_that_creeps_is_said(rig: Rig, rng: np.random.Generator) -> None:
    creeps = np.outer(np.linspace(0.0, 0.3e-3, FRAMES), [1.0, 0.0, 0.0])
    found = calibrated(drawn(rig, EXACT, shifted(pivots(rig, FRAMES, 5), creeps), rng), EXACT)
    assert found.wanders
    assert 0.02e-3 < found.wander_m < 0.2e-3
    assert (np.abs(off(rig, found)) < 3.5 * found.sigmas).all()


def test_of_two_tilts_that_by_which_the_point_rests(rig: Rig, rng: np.random.Generator) -> None:
    """Every frame says the wrong one first."""
    film = drawn(rig, EXACT, pivots(rig, FRAMES, 6), rng)
    swapped = []
    for one in film.sightings:
        sight = one.pose.position / np.linalg.norm(one.pose.position)
        normal = one.pose.rotation[:, 2]
        # Mirrored at the line of sight, roughly, as the other tilt of a plate that is seen from afar.
        axis = np.cross(normal, -sight)
        lean = np.arcsin(min(float(np.linalg.norm(axis)), 1.0))
        mirrored = exp_rotation(2.0 * lean * axis / np.linalg.norm(axis)) @ one.pose.rotation
        swapped.append(replace(one, pose=Pose.from_matrix(mirrored, one.pose.position), alternative=one.pose))
    found = calibrated(film._replace(sightings=swapped), EXACT)
    assert found.used.mean() > 0.95
    assert found.other_tilt > 0.5 * FRAMES
    assert (np.abs(off(rig, found)) < 3.5 * found.sigmas).all()


def about(rig: Rig, *tilts: Floats) -> list[Pose]:
    """Poses that rest with the tool at PLACE, tilted so, rotation vectors rad."""
    return [tip_at(rig.robots[0], PLACE, exp_rotation(tilt) @ FACING) for tilt in tilts]


def swung(axis: list[float], by: float) -> list[Floats]:
    """Rotation vectors about an axis."""
    return [by * np.sin(s) * np.array(axis) for s in np.linspace(0.0, 6.0, 40)]


def test_films_that_leave_it_open_are_refused_with_the_motion_that_is_missing(
    rig: Rig, rng: np.random.Generator
) -> None:
    slopes = np.outer(np.linspace(0.0, 0.02, FRAMES), [1.0, 0.0, 0.0])
    for poses, sentence in (
        (about(rig, *swung([1.0, 0.0, 0.0], 0.5)), r"alpha turns about one axis only, its x: by 20\.\d degrees, about"),
        (about(rig, *swung([0.6, 0.8, 0.0], 0.5)), r"its direction \[-?0\.[56]\d, -?0\.[78]\d, -?0\.0\d\]: by 20"),
        (about(rig, *[np.array([0.4, 0.0, 0.0])] * 40), r"alpha does not turn while its point rests \(by 0\.\d degr"),
        (pivots(rig, 10, 0), "alpha is located in 10 of its frames, expected 12 at least"),
        ([], "alpha is located in none of its frames"),
        (shifted(pivots(rig, FRAMES, 0), slopes), r"no point of alpha rests at one place: at best in \d+ of 60"),
        ([hand_pose(rig, rig.robots[0], k, FRAMES, 0) for k in range(FRAMES)], "no point of alpha rests at one"),
        (
            shifted(pivots(rig, FRAMES, 0), 0.8e-3 * rng.standard_normal((FRAMES, 3))),
            r"no point of alpha rests at one place|the point of alpha moves by 0\.\d+ mm \(one sigma\) about its pl",
        ),
    ):
        film = drawn(rig, EXACT, poses, rng) if poses else drawn(rig, EXACT, pivots(rig, 12, 0), rng)
        if not poses:
            film.sightings.clear()
        with pytest.raises(InputError) as refusal:
            calibrated(film, EXACT)
        assert re.search(sentence, str(refusal.value)), refusal.value
        assert str(refusal.value).startswith("film: ")
