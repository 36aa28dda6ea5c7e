"""How a mould differs from its drawing: a dent is found with its depth, and nothing where nothing differs."""

import numpy as np
import pytest

from asterism.protocol.surface import Surface
from asterism.server.calibration.surface.register import Placed, register
from asterism.server.calibration.surface.residual_map import (
    ResidualMap,
    as_drawn,
    as_it_is,
    places_of,
    residual_map,
    table_text,
)
from tests.calibration.surface.mould import DENT, LIES, Shape, dented, drawing_of, drives, free_form, touches_on

NOISE = (2e-5, 4e-5)  # m: as many touches of a 60 s drive have together what these few have


def mapped(shape: Shape, rng: np.random.Generator) -> tuple[ResidualMap, tuple[Surface, Surface]]:
    """The map, and both surfaces that a rig may have then."""
    xy, robots = drives(rng, 5, 240)
    contacts = touches_on(shape, xy, robots, rng, LIES, NOISE, offset_m=1e-5)
    found = register([Placed(drawing_of(free_form))], contacts, np.ones(len(contacts), np.bool_), 1e-5, "mould.stl")
    assert not found.others  # the same place found from elsewhere is no other, however many touches tell of it
    differs = residual_map(found)
    made = (make(found, differs) for make in (as_it_is, as_drawn))
    first, second = (Surface(heights, found.T_world_drawing) for heights in made)
    return differs, (first, second)


def test_a_dent_is_found_with_its_depth_and_nothing_else(rng: np.random.Generator) -> None:
    differs, (real, drawn) = mapped(dented, rng)
    place = places_of(differs)[0]
    assert place.off_m == pytest.approx(-3e-4, abs=5e-5)
    assert np.hypot(*(place.xy - DENT)) < 0.01
    i, j = np.indices(differs.values.shape)
    nodes = differs.origin + differs.step * np.stack([i, j], axis=-1)
    far = np.hypot(*np.moveaxis(nodes - DENT, -1, 0)) > 0.06
    assert not (differs.real & far).any()
    assert 0.5 < differs.visited.mean() < 1.0
    truth = dented(*np.moveaxis(nodes, -1, 0)) - free_form(*np.moveaxis(nodes, -1, 0))
    off = (differs.values - truth)[differs.visited]
    assert (np.abs(off) < 2.0 * differs.sigmas[differs.visited]).mean() > 0.9
    header, *rows = table_text(differs).splitlines()
    assert header == "x,y,differs,sigma,visited,real"
    assert len(rows) == np.isfinite(differs.values).sum()
    assert [row.split(",")[4] for row in rows].count("1") == differs.visited.sum()
    # A rig's surface is where the mould is, the drawing alone is not, and its sigma says so.
    x, y = np.meshgrid(np.linspace(0.02, 0.38, 60), np.linspace(0.02, 0.28, 40), indexing="ij")
    mould = LIES.map(np.column_stack([x.ravel(), y.ravel(), dented(x, y).ravel()]))
    away = [surface.touch(mould) for surface in (real, drawn)]
    rms = [float(np.sqrt((touch.distances**2).mean())) for touch in away]
    assert rms[0] < 3e-5
    assert rms[1] > 1.3 * rms[0]
    for touch in away:
        assert 0.9 < (np.abs(touch.distances) < 2.0 * touch.sigmas).mean() <= 1.0


def test_a_mould_as_drawn_differs_nowhere(rng: np.random.Generator) -> None:
    differs, _ = mapped(free_form, rng)
    assert not differs.real.any()
    assert not places_of(differs)
    assert differs.rms_m < 1e-5
