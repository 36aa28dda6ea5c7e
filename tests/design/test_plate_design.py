"""Designed plates: what was asked for is kept, what cannot be is refused with what can."""

import re
from dataclasses import replace

import numpy as np
import pytest

from asterism.protocol.errors import InputError
from asterism.protocol.rig import hidden_led_warnings, parse_rig
from asterism.server.chain.frame import Frame
from asterism.server.chain.pipeline import localize
from asterism.server.design.constellation_search import (
    GRID,
    LEAST_RMS_RADIUS,
    LEAST_SPREAD,
    LEAST_SPREAD_OF_FIVE,
    fits,
    improve,
)
from asterism.server.design.plate_design import FOCAL_PX, Design, Request, design
from asterism.server.design.plate_files import camera_text, rig_text
from asterism.server.pose.solve import PoseEstimate
from asterism.server.pose.track import Tracks
from asterism.server.simulation.simulate import Scene
from tests.identity.separations import brute_force
from tests.rigs import random_layout

WORK = 8000
ASKED = Request(robots=6, disc=0.1, spacing=0.02, distance=1.5, sigma_px=0.05)


@pytest.fixture(scope="module")
def found() -> Design:
    return design(ASKED, WORK)


def test_plates_are_as_asked_for(found: Design) -> None:
    assert found.layouts.shape == (6, 6, 2)
    assert (np.linalg.norm(found.layouts, axis=2) <= 0.05 - 0.004).all()
    apart = np.linalg.norm(found.layouts[:, :, None] - found.layouts[:, None], axis=-1) + np.eye(6)
    assert apart.min() >= 0.02
    np.testing.assert_allclose(found.layouts / GRID, np.round(found.layouts / GRID), atol=1e-6)
    angles = np.arctan2(found.layouts[..., 1], found.layouts[..., 0]) % (2 * np.pi)
    assert (np.diff(angles, axis=1) > 0).all()


def test_their_separations_are_what_trying_everything_finds(found: Design) -> None:
    np.testing.assert_allclose(found.visible, brute_force(found.layouts, 0, True), rtol=1e-9)
    np.testing.assert_allclose(found.hidden, brute_force(found.layouts, 1, True), rtol=1e-9)
    assert min(found.visible.min(), found.hidden.min()) >= ASKED.needed


def test_what_is_needed_is_ten_sigma_in_a_tilted_image() -> None:
    assert ASKED.needed * FOCAL_PX / 1.5 * np.cos(np.radians(60)) == pytest.approx(10 * 0.05)


def test_any_five_leds_are_spread_over_the_plate(found: Design) -> None:
    for layout in found.layouts:
        assert np.sqrt(layout.var(axis=0).sum()) >= LEAST_RMS_RADIUS * ASKED.radius
        assert np.linalg.eigvalsh(np.cov(layout.T, bias=True))[0] >= (LEAST_SPREAD * ASKED.radius) ** 2
        for hidden in range(6):
            five = np.delete(layout, hidden, axis=0)
            assert np.linalg.eigvalsh(np.cov(five.T, bias=True))[0] >= (LEAST_SPREAD_OF_FIVE * ASKED.radius) ** 2
    line = np.column_stack([np.linspace(-0.045, 0.045, 6), 0.001 * np.arange(6)])
    assert not fits(line, 0.046, 0.01)


def test_the_same_request_gives_the_same_plates(found: Design) -> None:
    np.testing.assert_array_equal(design(ASKED, WORK).layouts, found.layouts)


def test_the_search_makes_the_weakest_pair_stronger(rng: np.random.Generator) -> None:
    layouts = np.array([random_layout(rng) for _ in range(6)])
    before = min(brute_force(layouts, 1, True).min(), brute_force(layouts, 0, True).min() / 3.2)
    strength = improve(rng, layouts, 0.05, 0.02, 3.2, 5000, 1000)
    after = min(brute_force(layouts, 1, True).min(), brute_force(layouts, 0, True).min() / 3.2)
    assert after == pytest.approx(strength, rel=1e-9)
    assert after > 1.5 * before


def test_the_rig_of_the_plates_loads_and_holds_their_positions(found: Design) -> None:
    rig = parse_rig(rig_text(found), camera_text(), "test")
    assert [robot.id for robot in rig.robots] == ["r001", "r002", "r003", "r004", "r005", "r006"]
    for robot, layout in zip(rig.robots, found.layouts, strict=True):
        np.testing.assert_array_equal(robot.leds, np.column_stack([layout, np.zeros(6)]))
    assert rig.range_m == (0.75, 1.5)
    assert rig.camera.focal_px == FOCAL_PX
    assert not hidden_led_warnings(rig)


@pytest.mark.parametrize("light_m", [0.0011, 0.0015, 0.0025])
def test_the_radius_of_the_light_costs_no_robot_whatever_the_leds_are(found: Design, light_m: float) -> None:
    """Clear or frosted, the holes are those of 5 mm LEDs: as many are found as by a rig that knows the light."""
    camera = camera_text()
    text = rig_text(found)
    assert "    led: {radius: 0.0017}" in text
    given = parse_rig(text, camera, "rig.yaml")
    true = replace(given, robots=tuple(replace(robot, led_radius=light_m) for robot in given.robots))
    scene = Scene(true, seed=3)
    counts = []
    for rig in (given, true):
        answers = [
            answer
            for k in range(4)
            for answer in localize(Frame(scene.render(k, scene.truth(k, 0.5 * k)), 1, k), rig, Tracks.none())[
                0
            ].answers.values()
        ]
        counts.append(sum(isinstance(answer, PoseEstimate) for answer in answers))
    assert counts[0] == counts[1] > 12


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"robots": 401}, "--robots: 401, expected at most 400"),
        ({"disc": 100.0}, "--disc: 100, expected m, at most 0.8, so that the drill plan fits on A0; is that mm?"),
        ({"spacing": 0.005}, "--spacing: 0.005, expected m, at least 0.006"),
        ({"spacing": 0.05}, "do not leave room for 6 constellations"),
        ({"spacing": 20.0}, "do not leave room for 6 constellations"),
        ({"disc": 0.006, "spacing": 0.006}, "or a larger --disc"),
        ({"distance": 0.1}, "--distance: 0.1, expected m, from 0.31 (nearer, at half of it, a plate of 0.1 m does not"),
        ({"distance": 1500.0}, "to 7 (farther, LEDs 0.02 m apart merge)"),
    ],
)
def test_what_cannot_be_is_refused_before_any_search(changed: dict[str, float], words: str) -> None:
    with pytest.raises(InputError, match=re.escape(words)):
        replace(ASKED, **changed)  # type: ignore[arg-type]


def test_a_disc_too_small_for_the_spacing_is_refused() -> None:
    with pytest.raises(InputError, match=r"six LEDs 0\.045 m apart, spread over a plate of 0\.1 m, do not leave room"):
        design(replace(ASKED, spacing=0.045), WORK)


def test_more_than_can_be_told_apart_is_refused_with_what_can() -> None:
    asked = replace(ASKED, sigma_px=1.0)
    with pytest.raises(InputError, match="--robots: 6 constellations were found") as refused:
        design(asked, WORK)
    told = str(refused.value)
    assert "expected 21.43 mm (10 sigma at 1.5 m, f = 1400 px, 60 degrees of tilt), which 0 of them keep" in told
    advice = re.search(r"6 need --sigma ([\d.]+) or --distance ([\d.]+), larger plates, or fewer robots", told)
    assert advice
    design(replace(asked, sigma_px=float(advice[1])), WORK)
    design(replace(asked, distance=float(advice[2])), WORK)
