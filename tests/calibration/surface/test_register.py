"""A drawing registered to touches: found from nothing, with sigmas that are meant; what is open is said."""

from dataclasses import replace

import numpy as np
import pytest

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose, exp_rotation, log_rotation
from asterism.protocol.surface import Heights
from asterism.server.calibration.surface.contacts import Contacts
from asterism.server.calibration.surface.register import Placed, Registration, register
from asterism.server.calibration.surface.register_left import between
from asterism.server.calibration.surface.register_told import open_text, others_text, sigmas_of
from tests.calibration.surface.mould import LIES, LONG, WIDE, Shape, drawing_of, drives, free_form, touches_on


def found(drawing: Heights, contacts: Contacts, frame: Pose | None = None, offset_m: float = 1e-5) -> Registration:
    """With all touches allowed."""
    return register([Placed(drawing, frame)], contacts, np.ones(len(contacts), np.bool_), offset_m, "mould.stl")


def flat(x: Floats, y: Floats) -> Floats:
    """A plate."""
    return 0.0 * x + 0.0 * y


def ball(x: Floats, y: Floats) -> Floats:
    """The top of a ball of 0.5 m."""
    return np.asarray(np.sqrt(0.25 - (x - LONG / 2) ** 2 - (y - WIDE / 2) ** 2) - 0.5)


def twins(x: Floats, y: Floats) -> Floats:
    """Two hills, the same turned by half a turn."""
    u, v = x - LONG / 2, y - WIDE / 2
    hills = [np.exp(-((u - k * 0.08) ** 2 + (v - k * 0.05) ** 2) / (2 * 0.05**2)) for k in (-1, 1)]
    return np.asarray(0.015 * (hills[0] + hills[1]) + 0.2 * u * v)


@pytest.mark.parametrize("turned", [0.0, 2.6])
def test_it_is_found_from_nothing_wherever_it_lies(rng: np.random.Generator, turned: float) -> None:
    spin = Pose.from_matrix(exp_rotation(np.array([0.0, 0.0, turned])), np.array([0.3, -0.2, 0.0]))
    lies = spin @ LIES
    xy, robots = drives(rng, 5, 60)
    one = found(drawing_of(free_form), touches_on(free_form, xy, robots, rng, lies, (2e-5, 1e-4), offset_m=1e-5))
    off = between(one.drawing, one.T_world_drawing, lies)
    assert off @ np.linalg.solve(one.about_centre, off) < 22.5  # chi squared of six, 99.9 %
    assert np.sqrt(np.diag(one.about_centre)).max() < 2e-3
    assert not one.others
    assert open_text(one, "mould.stl") == ""
    # The covariance of the pose itself says the same of the same error.
    origin = lies.position - one.T_world_drawing.position
    error = np.concatenate([origin, log_rotation(lies.rotation @ one.T_world_drawing.rotation.T)])
    assert error @ np.linalg.solve(one.covariance, error) == pytest.approx(
        off @ np.linalg.solve(one.about_centre, off), rel=0.05
    )


def test_robots_that_were_lifted_do_not_move_it(rng: np.random.Generator) -> None:
    xy, robots = drives(rng, 5, 80)
    lifts = np.where(rng.random(len(xy)) < 0.15, 3e-3, 0.0)
    contacts = touches_on(free_form, xy, robots, rng, LIES, (2e-5, 1e-4), lifts)
    one = found(drawing_of(free_form), contacts)
    off = between(one.drawing, one.T_world_drawing, LIES)
    assert off @ np.linalg.solve(one.about_centre, off) < 22.5
    assert not one.laid.used[lifts > 0].any()
    assert one.laid.used[lifts == 0].mean() > 0.98


@pytest.mark.parametrize("shape", [flat, ball])
def test_a_plate_slides_and_a_ball_spins_which_is_said_and_a_frame_keeps_it(
    rng: np.random.Generator, shape: Shape
) -> None:
    drawing = drawing_of(shape)
    xy, robots = drives(rng, 3, 60, margin=0.08)
    contacts = touches_on(shape, xy, robots, rng, LIES, (2e-5, 5e-5))
    free = found(drawing, contacts)
    told = open_text(free, "mould.stl")
    assert "slides along its x (+- " in told
    assert "turns about its" in told
    assert "a rig whose `surface` has this `stl`" in told
    away = np.array([0.006, -0.004, 0.0])
    rough = Pose.from_matrix(exp_rotation(np.array([0.0, 0.0, 0.03])) @ LIES.rotation, LIES.position + away)
    kept = found(drawing, contacts, rough)
    assert sigmas_of(kept)[:2].max() < 0.021
    assert np.degrees(sigmas_of(kept)[5]) < 5.1
    off = between(drawing, kept.T_world_drawing, LIES)
    assert np.abs(off[:3]).max() < 0.02
    assert off @ np.linalg.solve(kept.about_centre, off) < 22.5
    assert "within 20 mm and 5 degrees" in open_text(kept, "mould.stl")
    if shape is flat:  # height and tilt are told all the same
        assert sigmas_of(free)[2] < 5e-5
        assert np.degrees(sigmas_of(free)[3:5]).max() < 0.02
        assert "and z" not in told.split("turns")[0]


def test_what_looks_the_same_turned_is_said(rng: np.random.Generator) -> None:
    xy, robots = drives(rng, 3, 60)
    contacts = touches_on(twins, xy, robots, rng, LIES, (2e-5, 5e-5))
    (line,) = others_text(found(drawing_of(twins), contacts))
    assert "turned by 180 degrees, mostly about its z" in line
    turned = LIES @ Pose(np.array([LONG, WIDE, 0.0]), np.array([0.0, 0.0, 1.0, 0.0]))
    one = found(drawing_of(twins), contacts, turned)  # a rough frame says which
    assert np.abs(between(one.drawing, one.T_world_drawing, turned)).max() < 0.01
    assert not others_text(one)


def test_another_drawing_or_one_in_mm_is_refused(rng: np.random.Generator) -> None:
    xy, robots = drives(rng, 3, 60)
    contacts = touches_on(free_form, xy, robots, rng)
    with pytest.raises(InputError, match=r"mould.stl: at best most touches are .* mm off it, expected 2 mm at most"):
        found(drawing_of(flat), contacts)
    small = drawing_of(free_form)
    small = replace(small, step=small.step / 1000.0, values=small.values / 1000.0)
    with pytest.raises(InputError, match="of the touches are on it, expected 50% at least"):
        found(small, contacts)
    with pytest.raises(InputError, match="12 touches are to tell where it lies, expected 30 at least"):
        found(drawing_of(flat), contacts[np.arange(12)])
