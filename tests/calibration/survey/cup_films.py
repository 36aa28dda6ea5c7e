"""Sightings of robots with LEDs as they are built (`cup_leds`): each rendered, then centred as with a led.yaml."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig
from asterism.server.calibration.leds.labelled import solve_sightings
from asterism.server.calibration.leds.observations import LedCentres, Sighting
from asterism.server.calibration.survey.survey import SurveyedPose
from asterism.server.calibration.survey.surveyed import Pairs
from asterism.server.centres.blobs import find_blobs
from asterism.server.centres.weighted import weigh_spots
from asterism.server.segmentation.segment import Scratch
from asterism.server.segmentation.spot_table import SHOULDER
from tests.calibration.survey.cup_leds import FINER, CupLed, add_light, blurred

TILE = 48  # px, of one LED
PER_ROW = 24


class Light(NamedTuple):
    """How LEDs are exposed: the lens's blur px, peak of one seen in front at 0.8 m and background, grey; noise of
    reading grey, and its growth with the light.
    """

    psf_px: float = 0.7
    peak: float = 230.0
    background: float = 10.0
    read: float = 1.0
    gain: float = 0.03


USUAL = Light()


def cup_pairs(rig: Rig, poses: Sequence[Pose], led: CupLed, rng: np.random.Generator, light: Light = USUAL) -> Pairs:
    """Sightings of the rig's first robot at T_camera_robot ``poses``, located by the rig without any offset, and the
    poses; LEDs that are not found are nan. A lens without distortion.
    """
    robot = rig.robots[0]
    axes = [pose.rotation @ robot.axis for pose in poses]
    leds = [pose.map(robot.leds) for pose in poses]
    centres, spreads, strange = centred(rig, np.concatenate(leds), np.repeat(axes, 6, axis=0), led, rng, light)
    sightings = []
    for k, pose in enumerate(poses):
        six = slice(6 * k, 6 * k + 6)
        known = LedCentres(centres[six], spreads[six], strange[six])
        sightings.append(Sighting(f"{k:05d}.png", k, robot.id, known, pose, np.eye(6), None))
    seen = [k for k, sighting in enumerate(sightings) if sighting.centres.count >= 4]
    located = solve_sightings(rig, [sightings[k] for k in seen])
    pairs = []
    for k, answer in zip(seen, located, strict=True):
        if answer is not None:
            told = SurveyedPose(robot.id, poses[k].position, poses[k].orientation)
            pairs.append((replace(sightings[k], pose=answer[0], covariance=answer[1]), told))
    return pairs


def centred(
    rig: Rig, leds: Floats, axes: Floats, led: CupLed, rng: np.random.Generator, light: Light, weighted: bool = True
) -> tuple[Floats, Floats, Floats]:
    """Centres (n, 2) px, covariances (n, 2, 2) px^2 and strange light (n,) px of spots of LEDs at ``leds`` (n, 3) m:
    weighted means, or by the rig's estimator.
    """
    n = len(leds)
    rows = -(-n // PER_ROW)
    canvas = np.zeros((rows * TILE, PER_ROW * TILE))
    full = _tile(rig, np.array([0.0, 0.0, 0.8]), np.array([0.0, 0.0, -1.0]), led, light)[0].max()
    origins, corners = np.empty((n, 2)), np.empty((n, 2))
    for k in range(n):
        tile, origins[k] = _tile(rig, leds[k], axes[k], led, light)
        corners[k] = TILE * (k % PER_ROW), TILE * (k // PER_ROW)
        x, y = corners[k].astype(int)
        canvas[y : y + TILE, x : x + TILE] = light.peak / full * tile
    noise = np.sqrt(light.read**2 + light.gain * canvas) * rng.standard_normal(canvas.shape)
    image = np.clip(np.rint(canvas + light.background + noise), 0, 255).astype(np.uint8)
    blobs = find_blobs(image, 12.0, np.zeros((0, 4), np.int64), rig.centre, Scratch.of(*image.shape))
    kept = blobs.kept
    if weighted:
        weigh_spots(image, blobs.table, kept[:, None], blobs.centres_px)
    centres, spreads, strange = np.full((n, 2), np.nan), np.full((n, 2, 2), np.nan), np.zeros(n)
    places = blobs.centres_px[kept]
    tiles = (places[:, 0] // TILE + PER_ROW * (places[:, 1] // TILE)).astype(int)
    for row in np.argsort(blobs.heights[kept]).tolist():  # the brightest last
        k = tiles[row]
        if k < n:
            centres[k] = places[row] - corners[k] + origins[k]
            xx, xy, yy = blobs.covariances_px2[kept[row]]
            spreads[k] = [[xx, xy], [xy, yy]]
            strange[k] = blobs.table[kept[row], SHOULDER]
    return centres, spreads, strange


def _tile(rig: Rig, place: Floats, axis: Floats, led: CupLed, light: Light) -> tuple[Floats, Floats]:
    """The light (TILE, TILE) of one LED, and where in the image its first pixel is (2,)."""
    points, bright = led.seen(place, axis)
    origin = np.floor(rig.camera.project(place[None])[0]) - TILE // 2
    fine = np.zeros((TILE * FINER, TILE * FINER))
    # In units of the light a surface as bright as the chip sends, whatever the rays' spacing.
    area = np.linalg.norm(place) ** 2 / rig.camera.focal_px**2
    add_light(fine, rig.camera.project(points) - origin, bright * led.spacing**2 / area)
    return blurred(fine, light.psf_px) * FINER**2, origin
