"""What all frames of a film have in common and may be wrong: where the LEDs are, their optics, the lens.

Such errors do not average out over frames, so a calibration that rests on many has to know them.
"""

from dataclasses import replace

import numpy as np

from asterism.protocol.constellation import LEDS
from asterism.protocol.geometry import Floats
from asterism.protocol.rig import Rig, Robot
from asterism.server.budget.budget import Light, Poses, image_by_pose, image_factors
from asterism.server.budget.uncertainty import LedError, Uncertainty
from asterism.server.calibration.lens.values import pixels_by_lens

NUMBERS = 2 * LEDS


def led_shapes(robot: Robot, error: LedError) -> Floats:
    """How a robot's LEDs may be off (18, m), m for one sigma: each alone, and all together in size."""
    larger = error.size_relative * (robot.leds - robot.leds.mean(axis=0)).reshape(-1, 1)
    return np.hstack([error.position_m * np.eye(3 * LEDS), larger])


def common_causes(rig: Rig, robot: Robot, poses: Poses, uncertainty: Uncertainty, lens: Floats) -> Floats:
    """How the spots of a robot's n poses move (n, 12, k), px, for one sigma of each of k independent causes beside the
    LEDs' places. ``lens`` (p, p) is the covariance of fx, fy, cx, cy and coefficients.
    """
    noiseless = replace(uncertainty, centre_px=0.0)
    by_point, _ = image_by_pose(rig, robot, poses)
    factors = image_factors(rig, robot, poses, noiseless, Light.assumed(rig.centre), by_point)
    points = np.einsum("nij,lj->nli", poses.rotations, robot.leds) + poses.ts[:, None]
    by_lens = pixels_by_lens(rig.camera, points.reshape(-1, 3)).reshape(len(poses), NUMBERS, -1)
    # Beside every centre's own bias there may be one of all: that of discs which the solver takes for points.
    shared = factors["centre bias"][..., NUMBERS:]
    return np.concatenate([factors["LED angular offset"], shared, by_lens @ _root(lens)], axis=-1)


def _root(covariance: Floats) -> Floats:
    """Factor (p, p) of a covariance, whose variables may be of very different sizes."""
    sigmas = np.sqrt(np.diag(covariance))
    unit = np.where(sigmas > 0.0, sigmas, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(unit, unit))
    root: Floats = unit[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    return root
