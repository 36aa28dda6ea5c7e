"""How far off the rig has a robot's LEDs: one number for all cameras, by what the rays of each leave.

Every camera's rays are fitted by themselves, so that cameras which contradict each other say nothing of LEDs. Of every
sigma that there may be, the rays' likelihood with the pose taken out (restricted maximum likelihood: chi squared and
the logarithms of both determinants, `joint_rays.Poses`) tells how likely it is; the mean of the variance over all of
them is taken, weighted by the size as well, as in `pose.systematic`. Errors of LEDs are the same in every frame and for
every camera: many say hardly more of their size than one, so their likelihoods' logarithms are averaged, not summed.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.server.fusing.gather import Sight, Wanted
from asterism.server.fusing.joint_solve import solve_joint
from asterism.server.fusing.memory import Known
from asterism.server.fusing.sighting import Sighting
from asterism.server.pose.planar import NO_SOLUTION

TRIED_M = np.array([0.0, *(1e-5 * 2.0 ** np.arange(9))])  # 0.01 to 2.6 mm
# Odds beforehand: LEDs as the rig has them, of a plate made with care, and any other.
NONE, PLATE, ANYTHING = 20.0, 2.0, 0.05
PLATE_M = 5e-5
SPREAD = 0.8  # one sigma of the logarithm of a sigma, about a plate's
LIKE_KNOWN, UNLIKE_KNOWN = 0.4, 20.0  # as the cameras have it, and odds of that against any other
LEAST_LEDS = 5  # of a camera, to tell anything of them
LEAST_M = 5e-6  # less than that is none
AGAIN_NS = 500_000_000  # until it is looked at again
GAIN = 0.25  # of a new look


def learned(robot: str, sightings: Sequence[Sighting]) -> float:
    """How far off the cameras found the robot's LEDs, m: their root mean square, 0 where none knows."""
    known = [misfit for sighting in sightings if (misfit := sighting.misfits_m.get(robot, 0.0)) > 0.0]
    return math.sqrt(sum(misfit**2 for misfit in known) / len(known)) if known else 0.0


def is_due(known: Known, exposed_ns: int) -> bool:
    """Whether it is time to look at a robot's LEDs."""
    return not known.misfit_ns or not 0 <= exposed_ns - known.misfit_ns < AGAIN_NS


def looked_at(wanted: Wanted, sight: Sight, known: Known) -> Known:
    """What is known of a robot once more of its rays were looked at."""
    alone = [{camera: of} for camera, of in wanted.spots.items() if np.count_nonzero(of >= 0) >= LEAST_LEDS]
    if not alone:
        return replace(known, misfit_ns=sight.exposed_ns)
    tried = [replace(wanted, misfit_m=float(sigma), spots=spots) for spots in alone for sigma in TRIED_M]
    bundle, motion, poses = sight.bundle(tried)
    solve_joint(sight.eyes, sight.bodies, bundle, motion, poses)
    costs = (poses.costs + poses.logdets).reshape(len(alone), -1)
    costs = costs[np.all(poses.costs.reshape(costs.shape) < NO_SOLUTION, axis=1)]
    if not len(costs):
        return replace(known, misfit_ns=sight.exposed_ns)
    told = learned(wanted.robot, list(sight.sightings.values()))
    logs = _prior(told) - 0.5 * costs.mean(axis=0)
    likely = np.exp(logs - logs.max())
    sizes = likely * TRIED_M  # none counts as none
    share = float(likely[1:].sum() / likely.sum())
    variance = share * float(sizes @ TRIED_M**2) / max(float(sizes.sum()), 1e-300)
    gain = GAIN if known.misfit_ns else 1.0
    mixed = (1.0 - gain) * known.misfit_m**2 + gain * variance
    return replace(known, misfit_m=math.sqrt(mixed), misfit_ns=sight.exposed_ns)


def _prior(told_m: float) -> Floats:
    """Logarithms of how likely the sigmas are beforehand, where cameras found one, 0 if they did not."""
    steps = np.log(TRIED_M[1:] / (told_m if told_m > LEAST_M else PLATE_M))
    weights = np.empty(len(TRIED_M))
    if told_m > LEAST_M:
        bell = np.exp(-0.5 * (steps / LIKE_KNOWN) ** 2)
        weights[1:] = UNLIKE_KNOWN * bell / max(bell.sum(), 1e-300) + 1.0 / len(TRIED_M)
        weights[0] = 1.0 / len(TRIED_M)
    else:
        bell = np.exp(-0.5 * (steps / SPREAD) ** 2)
        weights[1:] = (0.1 if told_m > 0.0 else 1.0) * PLATE * bell / bell.sum() + ANYTHING / len(steps)
        weights[0] = NONE
    logs: Floats = np.log(weights / weights.sum())
    return logs
