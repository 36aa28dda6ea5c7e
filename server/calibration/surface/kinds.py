"""Which kind of surface tells best what it was not fitted to."""

from typing import NamedTuple

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.protocol.surface import Quadric
from asterism.server.calibration.surface.fitting import Fitted, Noise, fitted, settled
from asterism.server.calibration.surface.held_out import Blocks, HeldOut, held_out, stiffest
from asterism.server.calibration.surface.normal_equations import Priors
from asterism.server.calibration.surface.shapes import (
    Shape,
    middle_and_size,
    moved_quadric,
    paraboloid,
    plane,
    polynomial_quadric,
    spline,
    whole_quadric,
)
from asterism.server.calibration.surface.splines import INTERVALS, Grid
from asterism.server.calibration.surface.touches import Touches
from asterism.server.calibration.surface.visited import GAP_M

ROUNDS = 6  # of Gauss and Newton
CROWDED = 0.4  # of a spline's numbers in use, from which on it gets twice as many along either axis
FREE = Priors(1.0)


class Tried(NamedTuple):
    """A kind of surface, with its shape at which it is linear, and what it makes of held-out touches."""

    found: HeldOut
    quadric: Quadric | None  # that `found.shape` is a base of


def smooth(touches: Touches) -> tuple[Fitted, HeldOut]:
    """The spline that most touches agree on, as stiff as held-out ones want it, and which touches those are."""
    intervals, start = INTERVALS, FREE
    while True:
        shape = spline(Grid.over(touches.xy, 0.5 * GAP_M, intervals))
        first = settled(touches, shape, start)
        kept = touches[first.used]
        found = stiffest(kept, shape, Blocks.of(kept), first.noise, first.numbers)
        if found.numbers < CROWDED * shape.numbers or intervals > INTERVALS:
            return settled(touches, shape, found.priors, first.residuals), found
        intervals, start = 2 * intervals, found.priors


def try_kinds(touches: Touches, noise: Noise, free: HeldOut, about: Floats) -> list[Tried]:
    """Planes, quadrics and a spline over touches that all count, the simplest first; ``free``: the spline's shape and
    stiffness, linear at numbers ``about``.
    """
    blocks, simple = Blocks.of(touches), Priors(0.0)
    flat, bent = plane(touches.xy), paraboloid(touches.xy)
    tried = [Tried(held_out(touches, flat, simple, blocks, noise, None), None)]
    every = np.ones(len(touches), np.bool_)
    numbers = fitted(touches, bent, simple, every, noise).numbers
    tried.append(Tried(held_out(touches, bent, simple, blocks, noise, numbers), None))
    whole = _whole(touches, polynomial_quadric(touches.xy, numbers), noise)
    if whole is not None:
        shape, quadric = whole
        tried.append(Tried(held_out(touches, shape, Priors(1.0), blocks, noise, np.zeros(shape.numbers)), quadric))
    tried.append(Tried(held_out(touches, free.shape, free.priors, blocks, noise, about), None))
    return tried


def best_of(tried: list[Tried]) -> Tried:
    """The simplest that no richer one beats by more than chance."""
    best = tried[0]
    for richer in tried[1:]:
        if richer.found.beats(best.found):
            best = richer
    return best


def _whole(touches: Touches, quadric: Quadric, noise: Noise) -> tuple[Shape, Quadric] | None:
    """The best quadric whose z counts, from one over x and y; None where there is none near."""
    _, size = middle_and_size(touches.xy)
    every = np.ones(len(touches), np.bool_)
    shape = whole_quadric(quadric, size)
    for _ in range(ROUNDS):
        numbers = fitted(touches, shape, Priors(1.0), every, noise).numbers
        quadric = moved_quadric(quadric, size, numbers)
        *_, inside = quadric.ground(touches.xy)
        if not inside.all():
            return None
        shape = whole_quadric(quadric, size)
    return shape, quadric
