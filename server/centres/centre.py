"""Sub-pixel centres of the kept spots, by the estimator that the rig asks for, each with its covariance."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.centres.clip import fit_clip
from asterism.server.centres.edge_model import edge_room, fit_edge_model
from asterism.server.centres.grey_square import fit_grey_square
from asterism.server.centres.near_spots import MOST_NEIGHBOURS, neighbours_of
from asterism.server.centres.picture_noise import OUT, accompanied, picture_noise
from asterism.server.centres.zernike import fit_zernike
from asterism.server.compiled import compiled
from asterism.server.segmentation.order import ascending
from asterism.server.segmentation.pixels import room_for
from asterism.server.segmentation.spot_table import (
    FATE,
    HEIGHT,
    MISFIT,
    NOISE,
    SEMI_A,
    SEMI_B,
    SHOULDER,
    TOUCHING,
    UNEXPLAINED,
    WX0,
    WX1,
    WY0,
    WY1,
    X,
    Y,
)

GAIN = 0.035  # expected variance per grey level of light: a sensor of 7000 electrons at grey level 255
GAIN_SIGMA = 0.02  # how well that is known before a frame's own residuals have told
CLEAN_MISFIT = 1.5  # chi squared per degree of freedom up to which a spot tells of the sensor's noise
LEAST_TELLING_PX, ROUND = 1.8, 0.7  # small and flat spots do not: the model's own error looks like noise there
USUAL_MISFIT = 1.3  # what is left when all that is even is free; more is other light,
STRANGE = 2.0  # which moves the centre by about this many times its noise for every unit of misfit, squared
SLIGHT, EVEN = 0.5, 2.5  # raised by no more, and with no more light to one side, a spot has nothing beside it
LEANING = 3.0  # raised by more than this, the variance is other light's: it is looked for when a robot claims the spot
ONE_SIDED = 4.5  # sigmas of light to one side of a spot beyond which there is other light
UNEXPLAINED_LIGHT_PX = 0.15  # light to one side that no fit explains moves the centre about this far


class Fits(NamedTuple):
    """What an estimator found of n spots: ``outs`` (n, OUT) as `edge_model.fit_edge_model` fills them; whether each
    was split from another, ``touched`` (n,).
    """

    outs: Any
    touched: Any


@compiled
def _room_for(spots):
    return Fits(np.zeros((spots.shape[0], OUT)), np.zeros(spots.shape[0], np.bool_))


@compiled
def _survey(spots, centres, covariances):
    """Set all to the coarse centre; returns the spots' order by x, the widest semi-axis, the cells of the largest
    window, and what is expected of the sensor's gain (2,): weighted, and its weight.
    """
    widest, largest = 0.0, 0.0
    for k in range(spots.shape[0]):
        spot = spots[k]
        centres[k, 0], centres[k, 1] = spot[X], spot[Y]
        for i in range(3):
            covariances[k, i] = 0.0
        widest = max(widest, spot[SEMI_A])
        if spot[FATE] == UNEXPLAINED:
            largest = max(largest, (spot[WX1] - spot[WX0]) * (spot[WY1] - spot[WY0]))
    # The expected gain counts as much as a measurement of that sigma.
    gain = np.empty(2)
    gain[0], gain[1] = 2.0 * GAIN / GAIN_SIGMA**2, 2.0 / GAIN_SIGMA**2
    return ascending(spots[:, X]), widest, largest, gain


@compiled
def _raised(out, noise, accompanied):
    """By how many parts light that is odd raises the variance of a spot, beyond what is usual in its picture.

    A shape that other spots share (``accompanied``) is even, and what it leaves is not counted.
    """
    misfit = out[6]
    if accompanied and out[12] > 0.0:
        misfit = min(misfit, out[11] / out[12])
    strange = misfit / noise.ratio - USUAL_MISFIT * noise.uneven
    odd = out[9] / (max(misfit, noise.ratio) * noise.uneven)
    beyond = out[13] * max(odd - out[10] - math.sqrt(2.0 * out[10]), 0.0)
    return (1.0 + STRANGE * max(strange, 0.0)) * (1.0 + beyond) - 1.0, misfit / noise.ratio


@compiled
def _take(spot, out, judged, knows_misfit, noise, centre, covariance):
    """Write what an estimator found (``out`` as in `edge_model.fit_edge_model`) of a spot; whether it is clean.

    ``judged``: by how much its variance is raised, its misfit, and whether another touches it. ``knows_misfit``: the
    estimator tells how well its model fits. ``noise``: `picture_noise.PictureNoise`.
    """
    # Odd light raises the variance; where it is much, as a shift that other light explains.
    raised, misfit, touched = judged
    side = out[5] / math.sqrt(noise.ratio * noise.uneven)
    alone = knows_misfit and side < EVEN and spot[TOUCHING] == 0.0
    if alone and (raised < SLIGHT or raised > LEANING):
        spot[SHOULDER] = 0.0  # the moments were misled, by saturation or by noise
    if side > ONE_SIDED or touched:
        spot[SHOULDER] = max(spot[SHOULDER], UNEXPLAINED_LIGHT_PX)
    elif raised > LEANING:
        shift = min(math.sqrt(0.5 * raised * noise.ratio * (out[2] + out[4])), UNEXPLAINED_LIGHT_PX)
        spot[SHOULDER] = max(spot[SHOULDER], shift)
    spot[MISFIT] = misfit
    centre[0], centre[1] = out[0], out[1]
    scale = 1.0 if raised > LEANING else 1.0 + raised
    covariance[0], covariance[1], covariance[2] = scale * out[2], scale * out[3], scale * out[4]
    round_enough = spot[SEMI_B] >= max(LEAST_TELLING_PX, ROUND * spot[SEMI_A])
    return out[6] < CLEAN_MISFIT and spot[SHOULDER] == 0.0 and (not knows_misfit or round_enough)


@compiled
def _take_all(spots, fits, knows_misfit, centres, covariances, gain):
    """Write what was found of all spots, in the light of what is usual in their picture; returns the sensor's gain."""
    outs = fits.outs
    noise = picture_noise(spots, outs)
    for k in range(spots.shape[0]):
        if spots[k, FATE] != UNEXPLAINED:
            continue
        out = outs[k]
        shared = out[6] > USUAL_MISFIT * noise.ratio and accompanied(spots, outs, k)
        raised, misfit = _raised(out, noise, shared)
        judged = raised, misfit, fits.touched[k]
        clean = _take(spots[k], out, judged, knows_misfit, noise, centres[k], covariances[k])
        if clean:
            gain[0] += out[7]
            gain[1] += out[8]
    return _scale(spots, covariances, gain, noise)


@compiled
def _scale(spots, covariances, gain, noise):
    """Make the covariances those of the gain that the spots showed, or of the ``noise`` that the whole picture shows,
    whichever is more; returns the gain.
    """
    found = max(gain[0] / gain[1], 0.1 * GAIN)
    for k in range(spots.shape[0]):
        spot = spots[k]
        if spot[FATE] != UNEXPLAINED:
            continue
        # What matters is the noise at the spot's edge, half way up.
        read, light = spot[NOISE] ** 2, 0.5 * min(spot[HEIGHT], 255.0)
        scale = (read + found * light) / (read + GAIN * light)
        if noise.ratio > 1.0:
            scale = max(scale, noise.ratio)
        for i in range(3):
            covariances[k, i] *= scale
        # Light that pulls the foot of the profile pulls the fitted centre about as far.
        covariances[k, 0] += spot[SHOULDER] ** 2
        covariances[k, 2] += spot[SHOULDER] ** 2
    return found


# A kernel for every estimator, so that only the one that a rig asks for is compiled.


@compiled
def _refine_edge_model(image, spots, centres, covariances):
    order, widest, largest, gain = _survey(spots, centres, covariances)
    neighbours, other, fits = np.empty((MOST_NEIGHBOURS, 3)), np.empty(6), _room_for(spots)
    room = edge_room(largest)
    for place in range(order.shape[0]):
        k = order[place]
        if spots[k, FATE] == UNEXPLAINED:
            count = neighbours_of(spots, order, place, widest, neighbours, other)
            fit_edge_model(image, spots[k], neighbours[:count], GAIN, room, fits.outs[k])
            fits.touched[k] = other[2] > 0.0
    return _take_all(spots, fits, True, centres, covariances, gain)


@compiled
def _refine_grey_square(image, spots, centres, covariances):
    order, widest, _, gain = _survey(spots, centres, covariances)
    neighbours, other, fits = np.empty((MOST_NEIGHBOURS, 3)), np.empty(6), _room_for(spots)
    for place in range(order.shape[0]):
        k = order[place]
        if spots[k, FATE] == UNEXPLAINED:
            count = neighbours_of(spots, order, place, widest, neighbours, other)
            fit_grey_square(image, spots[k], neighbours[:count], GAIN, fits.outs[k])
            fits.touched[k] = other[2] > 0.0
    return _take_all(spots, fits, False, centres, covariances, gain)


@compiled
def _refine_clip(image, spots, centres, covariances):
    order, widest, largest, gain = _survey(spots, centres, covariances)
    neighbours, other, fits = np.empty((MOST_NEIGHBOURS, 3)), np.empty(6), _room_for(spots)
    pixels = room_for(largest)
    for place in range(order.shape[0]):
        k = order[place]
        if spots[k, FATE] == UNEXPLAINED:
            count = neighbours_of(spots, order, place, widest, neighbours, other)
            fit_clip(image, spots[k], neighbours[:count], GAIN, pixels, fits.outs[k])
            fits.touched[k] = other[2] > 0.0
    return _take_all(spots, fits, False, centres, covariances, gain)


@compiled
def _refine_zernike(image, spots, centres, covariances):
    order, widest, _, gain = _survey(spots, centres, covariances)
    neighbours, other, fits = np.empty((MOST_NEIGHBOURS, 3)), np.empty(6), _room_for(spots)
    for place in range(order.shape[0]):
        k = order[place]
        if spots[k, FATE] == UNEXPLAINED:
            count = neighbours_of(spots, order, place, widest, neighbours, other)
            fit_zernike(image, spots[k], neighbours[:count], GAIN, fits.outs[k])
            fits.touched[k] = other[2] > 0.0
    return _take_all(spots, fits, False, centres, covariances, gain)


REFINERS = {
    "edge-model": _refine_edge_model,
    "grey-square": _refine_grey_square,
    "clip": _refine_clip,
    "zernike": _refine_zernike,
}


def refine_centres(
    image: NDArray[np.uint8], spots: Floats, estimator: str, centres: Floats, covariances: Floats
) -> float:
    """Fill ``centres`` (n, 2) px and ``covariances`` (n, 3) xx, xy, yy px^2 of the rows of the spot table.

    ``estimator`` is one of protocol.rig.ESTIMATORS. Rejected spots keep the coarse centre of the table, with covariance
    0. Spots that other light leans on get their SHOULDER set and their covariance widened by it. The covariances are
    those of the shot noise that the residuals of all clean spots together show; returns that gain.
    """
    gain: float = REFINERS[estimator](image, spots, centres, covariances)
    return gain
