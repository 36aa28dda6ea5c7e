"""The surface in a report: where it ends it is drawn, and nowhere else."""

import numpy as np

from asterism.protocol.surface import Heights, Quadric, Surface
from asterism.server.budget.surface_plot import surface_grid


def test_a_surface_is_drawn_where_it_is() -> None:
    values = np.array([[0.0, 0.01, 0.02], [0.0, 0.01, np.nan], [0.0, 0.01, 0.02]])
    grid = surface_grid(
        Surface(Heights(np.zeros(2), np.array([0.1, 0.2]), values, np.full((3, 3), 3e-5)), sigma_m=4e-5)
    )
    assert grid is not None
    x, y, heights, sigmas = grid
    assert (x[0], x[-1], y[0], y[-1]) == (0.0, 0.2, 0.0, 0.4)
    here = y < 0.199
    np.testing.assert_allclose(heights[:, here], np.broadcast_to(0.05 * y[here], heights[:, here].shape), atol=1e-12)
    np.testing.assert_allclose(sigmas[:, here], 5e-5)
    assert np.isnan(heights[:, y > 0.201]).all()


def test_a_surface_that_goes_on_for_ever_is_not() -> None:
    plane = Quadric.plane(np.zeros(3), np.array([0.0, 0.0, 1.0]))
    assert surface_grid(None) is None
    assert surface_grid(Surface(plane)) is None
    edged = surface_grid(Surface(plane, edge=np.array([[0.0, 0.0], [0.2, 0.0], [0.0, 0.1]])))
    assert edged is not None
    assert 0.4 < np.isfinite(edged[2]).mean() < 0.6
