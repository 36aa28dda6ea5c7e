"""What frames themselves show: blur and size of spots, brightness, other light; on small rendered frames."""

from dataclasses import replace

import numpy as np
import pytest

from asterism.protocol.messages import Fate
from asterism.protocol.rig import Rig
from asterism.server import Frame
from asterism.server.doctor.blur import centre_cost
from asterism.server.doctor.exposure import check_bright_areas, check_dim, check_exposure
from asterism.server.doctor.finding import Verdict
from asterism.server.doctor.focus import blurs, check_focus, check_sizes, check_streaks
from asterism.server.doctor.foreign import check_clutter, check_hot_pixels
from asterism.server.doctor.gather import Gathered, Gatherer
from asterism.server.doctor.shutter import check_shutter
from asterism.server.simulation.simulate import Look, Scene
from tests.doctor.drawn import gathered, nobody, pictures, spot
from tests.rigs import make_camera, make_rig

RIG = make_rig(1, 2, make_camera(480, 400, 900.0), range_m=(0.6, 1.0))
GOOD, LOOK, WRONG, UNTOLD = Verdict.GOOD, Verdict.LOOK, Verdict.WRONG, Verdict.UNTOLD
PIXEL_PX = 12.0**-0.5  # sigma of the blur of a pixel


def film(look: Look, frames: int = 12, told: Rig = RIG, dark: int | None = None, streak: int = 1) -> Gathered:
    """A few frames through the chain; one LED ``dark``; ``streak``: so many exposures in each frame."""
    scene, gatherer = Scene(RIG, 3, look), Gatherer(told)
    if dark is not None:
        scene.led_brightness[0, dark] = 0.3
    for index in range(frames):
        parts = [scene.render(index, scene.truth(index, (index + 0.1 * k) / 10.0)) for k in range(streak)]
        image = np.mean(parts, axis=0).round().astype(np.uint8)
        gatherer.add(Frame(image, round(index * 1e8) + 1, index))
    return gatherer.gathered()


@pytest.mark.parametrize(("psf_px", "verdict"), [(0.6, GOOD), (1.0, GOOD), (2.2, LOOK), (3.5, WRONG)])
def test_the_blur_is_that_of_the_lens_and_the_pixel(psf_px: float, verdict: Verdict) -> None:
    told = film(Look(psf_px=psf_px))
    found = blurs(told.cuts, RIG)
    assert found[0].blur_px == pytest.approx(np.hypot(psf_px, PIXEL_PX), rel=0.06)
    assert check_focus(found, RIG).verdict == verdict
    assert psf_px > 2.0 or found[0].radius_m == pytest.approx(0.0025, rel=0.03)


def test_the_blur_is_told_without_the_leds_radius_and_of_nobodys_spots() -> None:
    bare = replace(RIG, robots=(replace(RIG.robots[0], led_radius=None),))
    assert blurs(film(Look(), told=bare).cuts, bare)[0].blur_px == pytest.approx(0.85, rel=0.05)
    stranger = make_rig(1, 9, RIG.camera, RIG.range_m)
    found = blurs(film(Look(), told=stranger).cuts, stranger)
    assert found[-1].blur_px == pytest.approx(0.85, rel=0.1)
    assert check_focus(found, stranger).verdict == GOOD


def test_blur_costs_large_spots_less() -> None:
    for radius in (1.2, 2.2, 5.0):
        costs = [centre_cost(radius, blur) for blur in (0.75, 1.0, 1.5, 2.5, 4.0)]
        assert costs[0] == pytest.approx(1.0)
        assert costs == sorted(costs)
    assert centre_cost(5.0, 2.5) < centre_cost(1.2, 2.5)


def test_a_light_of_another_size_than_the_rig_says_is_told() -> None:
    for radius_m, verdict in ((0.0025, GOOD), (0.0018, LOOK), (0.0055, WRONG)):
        told = replace(RIG, robots=(replace(RIG.robots[0], led_radius=radius_m),))
        seen = film(Look(), told=told)
        finding = check_sizes(blurs(seen.cuts, told), seen)
        assert finding.verdict == verdict, finding
    assert "led.radius: 0.0025" in finding.advice


@pytest.mark.parametrize(
    ("brightness", "verdict"), [(18.0, WRONG), (45.0, LOOK), (150.0, GOOD), (400.0, LOOK), (6000.0, WRONG)]
)
def test_exposure_is_judged_from_both_sides(brightness: float, verdict: Verdict) -> None:
    finding = check_exposure(film(Look(brightness=brightness), 6))
    assert finding.verdict == verdict, finding
    if verdict != GOOD:
        assert ("shorter" if brightness > 150 else "longer") in finding.advice


def test_a_dim_led_is_named() -> None:
    finding = check_dim(film(Look(), dark=4))
    assert finding.verdict == WRONG
    assert "r00: LED 4 has 3" in finding.measured
    assert check_dim(film(Look())).verdict == GOOD


def test_streaks_are_seen_and_a_shutter_that_does_not_roll_is_not() -> None:
    for streak, verdict in ((1, GOOD), (6, LOOK)):
        told = film(Look(), streak=streak)
        assert check_streaks(told, blurs(told.cuts, RIG)).verdict >= verdict
        assert check_shutter(told).verdict <= GOOD or streak > 1


def test_pixels_that_stay_are_hot_and_those_that_come_and_go_are_not(rng: np.random.Generator) -> None:
    places = rng.uniform(0, 400, (30, 2))
    small = int(Fate.TOO_SMALL)
    stay = [np.concatenate([spot(x, y, small) for x, y in places]) for _ in range(20)]
    go = [np.concatenate([spot(x, y, small) for x, y in rng.uniform(0, 400, (30, 2))]) for _ in range(20)]
    for rows, hot, clutter in ((stay, LOOK, GOOD), (go, GOOD, LOOK)):
        told = gathered(RIG, nobody(RIG), pictures(0, rows, np.arange(20)))
        assert check_hot_pixels(told).verdict == hot
        assert check_clutter(told).verdict == clutter
    assert check_hot_pixels(gathered(RIG, nobody(RIG), pictures(0, stay[:3], np.arange(3)))).verdict == UNTOLD


def test_areas_that_glare_are_told_by_their_share() -> None:
    for share, verdict in ((0.0, GOOD), (0.01, LOOK), (0.5, WRONG)):
        told = gathered(RIG, nobody(RIG), pictures(3)._replace(bright=np.full(3, share)))
        assert check_bright_areas(told).verdict == verdict
