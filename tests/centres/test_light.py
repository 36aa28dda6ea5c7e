"""No lens is a Gaussian: what is symmetric moves no centre and costs no covariance, what is not widens it."""

import numpy as np
import pytest

from tests.centres.lenses import SYMMETRIC, coma, gauss
from tests.centres.lit_frames import Disturb, bound, centre_spots, light_beside, step_beside

FRAMES = 20  # of six spots: one sigma of an RMS error is 4.6 %, of a mean NEES 9 %
RADIUS = 2.5


@pytest.mark.parametrize("level", [60.0, 200.0])
@pytest.mark.parametrize("name", ["airy 1.683", "airy and gauss", "defocus 4"])
def test_centres_under_any_symmetric_lens_are_at_the_bound_and_their_covariances_are_meant(
    name: str, level: float
) -> None:
    lens = SYMMETRIC[name]
    centred = centre_spots(lens, RADIUS, level, FRAMES)
    assert centred.lost == 0
    assert centred.rms < 1.1 * bound(lens, RADIUS, level) * (1.0 + 3 * 0.046)
    assert 0.8 - 3 * 0.09 < np.mean(centred.nees) / 2.0 < 1.2 + 3 * 0.09


@pytest.mark.parametrize("name", [name for name in SYMMETRIC if name != "gauss 0.7"])
def test_a_symmetric_misfit_moves_no_centre_and_does_not_widen_its_covariance(name: str) -> None:
    lens = SYMMETRIC[name]
    least = bound(lens, RADIUS, 200.0)
    centred = centre_spots(lens, RADIUS, 200.0, FRAMES)
    assert centred.rms < 1.2 * least * (1.0 + 3 * 0.046)
    # A quarter of the variance for the sensor's gain, which six spots tell so well only.
    assert np.median(centred.variances) < 1.5 * least**2


@pytest.mark.parametrize("name", ["gauss 0.7", "airy 1.683", "defocus 2"])
def test_twofold_saturation_under_any_lens_costs_little(name: str) -> None:
    centred = centre_spots(SYMMETRIC[name], RADIUS, 500.0, FRAMES)
    assert centred.rms < 0.006
    assert 0.4 < np.mean(centred.nees) / 2.0 < 1.5


@pytest.mark.parametrize(("share", "away"), [(0.2, 1.5), (0.3, 2.0)])
def test_coma_widens_the_covariance(share: float, away: float) -> None:
    lens = coma(share, away)
    centred = centre_spots(lens, RADIUS, 200.0, FRAMES)
    # The bound is some 0.007 px, the tail pulls the centre by ten times that.
    assert centred.rms > 0.04
    assert np.sqrt(np.median(centred.variances)) > 0.04
    assert np.mean(centred.nees) / 2.0 < 3.0


@pytest.mark.parametrize(
    "disturb", [light_beside(15.0, 3.0), light_beside(15.0, 5.0), step_beside(30.0, 3.5)], ids=["near", "far", "step"]
)
def test_light_to_one_side_widens_the_covariance(disturb: Disturb) -> None:
    clean = centre_spots(gauss(0.8), RADIUS, 200.0, 4)
    centred = centre_spots(gauss(0.8), RADIUS, 200.0, FRAMES, disturb)
    assert centred.rms > 2.0 * clean.rms
    assert np.median(centred.variances) > 4.0 * np.median(clean.variances)
    assert np.mean(centred.nees) / 2.0 < 3.0
