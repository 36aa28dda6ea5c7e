"""Plates whose constellations cannot be confused, even with one LED hidden: what is asked for, what was found."""

import math
from dataclasses import dataclass

import numpy as np

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats
from asterism.server.design.constellation_search import GRID, improve, throw_layouts
from asterism.server.design.drill_plan import LARGEST_DISC
from asterism.server.design.telling_apart import SIGMAS, TILT_DEG, needed_m
from asterism.server.identity.separation import separations

# Nominal: the demonstration's camera, since plates are made before there is one.
FOCAL_PX, WIDTH_PX, HEIGHT_PX = 1400.0, 1280, 1024
FILLS = 0.9  # of the image's height: the most that a plate may take
MERGE_PX = 4.0  # LEDs nearer than this are one spot
HOLE_RADIUS = 0.0025  # m: of a 5 mm LED's plastic
# m, of the light that it shows: 1.5 mm where a clear dome enlarges the reflector's cup, 2.5 mm where the plastic
# is frosted. The chain takes an LED for one whose light is from half to one and a half of what the rig says.
LIGHT_RADIUS = 0.0017
RIM = 0.004  # m from an LED's centre to the plate's edge at least: its collar (2.9 mm), and a millimetre of plate
LEAST_SPACING = 0.006  # m: collars of two LEDs side by side
MOST_ROBOTS = 400
# Random layouts are about three times as far apart with all LEDs visible as with one hidden: ask for both alike.
RATIO = 3.2
WORK = 800_000  # strengths of pairs that the search may compute
LAST_WORK = 0.7  # of that again, where what is needed was not reached and the RATIO is given up
_TRIES = 20_000  # throws a layout, until the disc is too small for it
_PATIENCE = 100_000


@dataclass(frozen=True, slots=True)
class Request:
    """What is asked for; lengths in m. Raises InputError where no plate can be like that."""

    robots: int
    disc: float  # the plates' diameter
    spacing: float  # between two LEDs at least
    distance: float  # from the camera at most
    sigma_px: float  # of an LED's centre

    def __post_init__(self) -> None:
        if self.robots > MOST_ROBOTS:
            raise InputError(f"--robots: {self.robots}, expected at most {MOST_ROBOTS}")
        if self.disc > LARGEST_DISC:
            raise InputError(
                f"--disc: {self.disc:g}, expected m, at most {LARGEST_DISC:g}, so that the drill plan fits on A0; "
                "is that mm?"
            )
        if self.spacing < LEAST_SPACING:
            raise InputError(
                f"--spacing: {self.spacing:g}, expected m, at least {LEAST_SPACING:g}, so that 5 mm LEDs fit side by "
                "side"
            )
        if self.spacing > self.radius:
            raise InputError(f"--spacing: {self.no_room}")
        far = FOCAL_PX * self.spacing / MERGE_PX
        if not self.least_distance <= self.distance <= far:
            raise InputError(
                f"--distance: {self.distance:g}, expected m, from {_ceil(self.least_distance)} (nearer, at half of it, "
                f"a plate of {self.disc:g} m does not fit the image of a camera with f = {FOCAL_PX:g} px) to "
                f"{_floor(far)} (farther, LEDs {self.spacing:g} m apart merge)"
            )

    @property
    def least_distance(self) -> float:
        """At half of that a plate fills the image."""
        return 2.0 * FOCAL_PX * self.disc / (FILLS * HEIGHT_PX)

    @property
    def radius(self) -> float:
        """Of the disc in which LED centres may lie."""
        return self.disc / 2 - RIM

    @property
    def needed(self) -> float:
        """The separation that tells constellations apart at the distance."""
        return needed_m(self.sigma_px, FOCAL_PX, self.distance)

    @property
    def no_room(self) -> str:
        """A sentence for a spacing that is too large."""
        return (
            f"six LEDs {self.spacing:g} m apart, spread over a plate of {self.disc:g} m, do not leave room for "
            f"{self.robots} constellations (LED centres keep {RIM * 1e3:g} mm from the edge), expected well below "
            f"{max(self.radius, 0.0):.3g} m, or a larger --disc"
        )


@dataclass(frozen=True, slots=True, eq=False)
class Design:
    """What was found: ``layouts`` (robots, 6, 2) m in the plates' frames, whose origins are the plates' centres; and
    the separations (robots, robots), m: row what is seen, or its mirror image, column what it would be taken for.
    """

    request: Request
    layouts: Floats
    visible: Floats  # all LEDs
    hidden: Floats  # one hidden

    @property
    def names(self) -> list[str]:
        """The robots' ids."""
        return [f"r{number:03d}" for number in range(1, len(self.layouts) + 1)]


def design(request: Request, work: int = WORK) -> Design:
    """Choose the constellations; ``work`` bounds the search. The same request gives the same plates.

    Raises InputError where so many constellations were not found that far apart.
    """
    rng = np.random.default_rng(0)
    layouts = np.empty((request.robots, 6, 2))
    bounds = (request.radius, request.spacing * (1.0 + 1e-9))  # not less, however numbers are rounded
    if throw_layouts(rng, *bounds, _TRIES, layouts) < request.robots:
        raise InputError(f"--spacing: {request.no_room}")
    if improve(rng, layouts, *bounds, RATIO, work, _PATIENCE) < request.needed:
        improve(rng, layouts, *bounds, 1.0, int(LAST_WORK * work), _PATIENCE)
    layouts = _in_turn(layouts)
    found = Design(request, layouts, separations(layouts, 0, True), separations(layouts, 1, True))
    worse = np.minimum(found.visible, found.hidden)
    if worse.min() < request.needed:
        raise InputError(_refusal(request, float(worse.min()), _reached(worse, request.needed)))
    return found


def _in_turn(layouts: Floats) -> Floats:
    """LEDs counted counter-clockwise from the plate's x axis, on exact multiples of GRID."""
    angles = np.arctan2(layouts[:, :, 1], layouts[:, :, 0]) % (2 * math.pi)
    turned = np.take_along_axis(layouts, np.argsort(angles, axis=1)[:, :, None], axis=1)
    decimals: Floats = np.round(turned, round(-math.log10(GRID))) + 0.0
    return decimals


def _reached(separation: Floats, needed: float) -> int:
    """How many are left when those with most conflicts are taken away until there is none."""
    conflicts = np.minimum(separation, separation.T) < needed
    left = ~np.diag(conflicts)
    while (many := (conflicts & left & left[:, None]).sum(axis=1)).any():
        left[int(np.argmax(many))] = False
    return int(left.sum())


def _refusal(request: Request, least: float, reached: int) -> str:
    share = least / request.needed
    advice = f"--sigma {_floor(request.sigma_px * share)}"
    if float(nearer := _floor(request.distance * share)) >= request.least_distance:
        advice += f" or --distance {nearer}"
    return (
        f"--robots: {request.robots} constellations were found {least * 1e3:.2f} mm apart with one LED hidden, "
        f"expected {request.needed * 1e3:.2f} mm ({SIGMAS:g} sigma at {request.distance:g} m, f = {FOCAL_PX:g} px, "
        f"{TILT_DEG:g} degrees of tilt), which {reached} of them keep; {request.robots} need "
        f"{advice}, larger plates, or fewer robots"
    )


def _floor(value: float) -> str:
    """Rounded down to two digits, so that the advice holds."""
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f"{math.floor(value / step) * step:.6g}"


def _ceil(value: float) -> str:
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f"{math.ceil(value / step) * step:.6g}"
