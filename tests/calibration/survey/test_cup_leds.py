"""LEDs with chip and reflector cup: the tracer, the offset learned from rendered ones, and what it leaves open."""

from dataclasses import replace

import numpy as np
import pytest

from asterism.protocol.geometry import Floats
from asterism.protocol.led_offset import LedOffset, parse_offset
from asterism.protocol.rig import Rig
from asterism.server.calibration.leds.labelled import solve_sightings
from asterism.server.calibration.survey.offset import OffsetCalibration, calibrate_offset, with_offset
from asterism.server.calibration.survey.surveyed import Pairs
from asterism.server.calibration.survey.surveyed_fit import errors_of, weighted_errors
from asterism.server.command.calibrate_offset import led_text
from asterism.server.pose.led_doubt import own_scatter
from tests.calibration.survey.cup_films import USUAL, centred, cup_pairs
from tests.calibration.survey.cup_leds import CupLed
from tests.calibration.survey.surveys import survey_pairs
from tests.helpers import facing_pose
from tests.rigs import make_camera, make_rig

LED = CupLed(rim=1.1e-3, deep=0.5e-3, wide=0.8e-3, dull=0.15, mirror=0.7)


def plain_rig() -> Rig:
    return make_rig(1, seed=3, camera=replace(make_camera(), distortion=np.zeros(5)))


@pytest.fixture(scope="module")
def surveyed() -> tuple[Rig, Pairs, Pairs, OffsetCalibration]:
    """A rig, poses to learn from, others, and what is learned."""
    rig, rng = plain_rig(), np.random.default_rng(31)
    films = [
        cup_pairs(rig, [facing_pose(rng, (0.8, 1.5), (0.0, 52.0)) for _ in range(count)], LED, rng)
        for count in (32, 24)
    ]
    return rig, films[0], films[1], calibrate_offset(rig, films[0], "film")


def rms(errors: Floats) -> Floats:
    root: Floats = np.sqrt((errors**2).mean(axis=0))
    return root


def test_a_chip_without_a_cup_is_seen_where_the_dome_puts_it() -> None:
    """Near the axis, n d / (1 - (n - 1) d / R) below the dome's centre: findings/algorithms.md, E."""
    chip = CupLed(rim=1.2e-3, deep=0.3e-3, tall=0.05e-3, mirror=0.0, dull=0.0)
    depth = chip.rim + chip.deep - chip.tall
    tilt = np.radians(3.0)
    axis = np.array([np.sin(tilt), 0.0, -np.cos(tilt)])
    points, light = chip.seen(np.array([0.0, 0.0, 5.0]), axis)
    aside = (points * light[:, None]).sum(axis=0) / light.sum()
    assert aside[0] / np.sin(tilt) == pytest.approx(-1.5 * depth / (1.0 - 0.5 * depth / chip.radius), rel=0.03)
    assert abs(aside[1]) < 1e-6


def test_poses_of_cups_that_were_not_surveyed_are_right_and_know_how_right(
    surveyed: tuple[Rig, Pairs, Pairs, OffsetCalibration],
) -> None:
    rig, _, others, found = surveyed
    compensated = with_offset(rig, found.offset)
    solved = solve_sightings(compensated, [s for s, _ in others])
    left = rms(errors_of(others, compensated, solved)[0])
    before = rms(errors_of(others, rig, solve_sightings(rig, [s for s, _ in others]))[0])
    assert found.helps
    assert (left[:2] < 0.06e-3).all()
    assert left[2] < 0.4e-3
    assert (left < 0.3 * before).all()
    assert 3.0 < weighted_errors(others, compensated, solved).mean() < 10.0


def test_weighted_means_follow_a_cup_more_steadily_than_an_edge(rng: np.random.Generator) -> None:
    """At 30 degrees, from 0.8 to 1.5 m and at every phase: how far the light seems to lie behind the LED."""
    rig, tilt = plain_rig(), np.radians(30.0)
    axis = np.array([np.sin(tilt), 0.0, -np.cos(tilt)])
    places = np.column_stack([rng.uniform(-2e-3, 2e-3, (24, 2)), rng.uniform(0.8, 1.5, 24)])
    spread = []
    for weighted in (False, True):
        centres = centred(rig, places, np.tile(axis, (24, 1)), CupLed(), np.random.default_rng(5), USUAL, weighted)[0]
        away = (centres - rig.camera.project(places)) * places[:, 2:] / rig.camera.focal_px
        shift = np.polynomial.Polynomial.fit(places[:, 2], away[:, 0], 1)
        spread.append(np.std(away[:, 0] - shift(places[:, 2])))
    assert spread[1] < 0.6 * spread[0]


def test_the_file_holds_what_was_found(surveyed: tuple[Rig, Pairs, Pairs, OffsetCalibration]) -> None:
    found = surveyed[3].offset
    read = parse_offset(led_text(surveyed[3], "film", "truth.jsonl", ["alpha"]), "led.yaml")
    for name in ("values", "per_metre", "doubts"):
        np.testing.assert_allclose(getattr(read, name), getattr(found, name), atol=1e-9)
    assert read.weighted
    assert read.up_to_rad == pytest.approx(found.up_to_rad, abs=1e-6)
    assert (read.scatter_px, read.strange_px) == pytest.approx((found.scatter_px, found.strange_px), abs=1e-3)


def test_what_changes_with_the_distance_needs_distances(rng: np.random.Generator) -> None:
    rig = plain_rig()

    def apparent(led: Floats, axis: Floats) -> Floats:
        return led + (-1e-3 + 2e-3 * (np.linalg.norm(led) - 1.0)) * axis

    def changes(depths: tuple[float, float]) -> OffsetCalibration:
        poses = [facing_pose(rng, depths, (0.0, 55.0)) for _ in range(50)]
        return calibrate_offset(rig, survey_pairs(rig, rig, poses, rng, 0.01, apparent), "film")

    wide, narrow = changes((0.7, 1.3)), changes((0.97, 1.0))
    np.testing.assert_allclose(wide.offset.per_metre[5:], 2e-3, atol=3e-4)
    np.testing.assert_allclose(wide.offset.shift(wide.offset.angles, 1.0)[3:], -1e-3, atol=0.06e-3)
    assert not narrow.told_distance
    assert not narrow.offset.per_metre.any()


@pytest.mark.parametrize("known", [True, False])
def test_a_shift_that_all_leds_share_is_in_the_covariance(rng: np.random.Generator, known: bool) -> None:
    """It leaves no residuals: without a name for it, poses are surer than they are."""
    rig = plain_rig()
    doubts = np.array([[0.05e-3] * 6, [0.0, 0.01e-3, 0.03e-3, 0.05e-3, 0.08e-3, 0.1e-3]])
    offset = LedOffset(np.full(6, -2e-3), np.radians(60.0), np.zeros(6), 1.0, doubts if known else doubts[:0], 0.0, 0.0)
    given = with_offset(rig, offset)
    squared = []
    for _ in range(150):
        drawn = rng.standard_normal(2) @ doubts
        true = LedOffset.table(offset.values + drawn, offset.up_to_rad)
        pose = facing_pose(rng, (0.8, 1.5), (10.0, 55.0))

        def apparent(led: Floats, axis: Floats, true: LedOffset = true) -> Floats:
            angle = np.arccos(-(led @ axis) / np.linalg.norm(led))
            return led + float(true.shift(np.array(angle))) * axis

        pairs = survey_pairs(rig, given, [pose], rng, 0.005, apparent)
        squared.append(weighted_errors(pairs, given, [(pairs[0][0].pose, pairs[0][0].covariance)])[0])
    mean = float(np.mean(squared))
    assert (4.5 < mean < 7.5) if known else mean > 30.0


def test_scatter_takes_the_place_of_what_was_allowed_for_strange_light() -> None:
    offset = LedOffset(np.zeros(2), 1.0, np.zeros(2), 1.0, np.zeros((0, 2)), 0.02, 0.1)
    strange = np.array([0.0, 0.05, 0.1, 0.3])
    np.testing.assert_allclose(own_scatter(offset, strange), [4e-4, 4e-4 - 25e-4, 4e-4 - 1e-2, 0.0])
    assert not own_scatter(LedOffset.table(np.zeros(2), 1.0), strange).any()
    assert not own_scatter(None, strange).any()
