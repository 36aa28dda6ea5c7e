"""Centres and poses against what physics allows (Cramer-Rao): near the bound, and never below it by more than luck."""

import numpy as np
import pytest

from tests.bounds import centre_bound
from tests.rendering import Canvas
from tests.test_centres import centre

PHASES, EXPOSURES = 15, 12


@pytest.mark.parametrize(
    ("radius", "level", "read", "allowed"),
    [
        (1.5, 170.0, 1.2, 1.25),
        (2.5, 170.0, 1.2, 1.15),
        (4.0, 170.0, 1.2, 1.15),
        (2.5, 40.0, 2.0, 1.15),
        (3, 500, 1.2, 1.3),
    ],
)
def test_the_edge_model_is_near_the_bound(
    rng: np.random.Generator, radius: float, level: float, read: float, allowed: float
) -> None:
    errors, bounds = [], []
    for _ in range(PHASES):
        x, y, angle = *rng.uniform(-0.5, 0.5, 2), rng.uniform(0, np.pi)
        canvas = Canvas.of(72, 72).ellipse(36 + x, 36 + y, radius, 0.85 * radius, angle, level=level)
        errors += [centre(canvas.expose(rng, read=read))[0] - [36 + x, 36 + y] for _ in range(EXPOSURES)]
        bounds.append(np.trace(centre_bound(radius, 0.85 * radius, angle, level, x=x, y=y, read=read)) / 2)
    ratio = np.sqrt(np.mean(np.square(errors)) / np.mean(bounds))
    # 360 coordinates: one sigma of the ratio is 4 %.
    assert 0.88 < ratio < allowed


def test_the_bound_follows_its_laws() -> None:
    # Between pure read noise (ratio 4) and shot noise (1); brighter and larger spots have smaller errors.
    quiet = np.sqrt(centre_bound(2.5, 2.0, 0.3, 40.0, read=2.0)[0, 0])
    noisy = np.sqrt(centre_bound(2.5, 2.0, 0.3, 40.0, read=8.0)[0, 0])
    assert 2.5 < noisy / quiet < 4.0
    assert centre_bound(2.5, 2.0, 0.3, 160.0)[0, 0] < centre_bound(2.5, 2.0, 0.3, 80.0)[0, 0]
    assert centre_bound(4.0, 3.5, 0.3, 80.0)[0, 0] < centre_bound(2.0, 1.75, 0.3, 80.0)[0, 0]
