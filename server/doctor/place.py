"""Has the camera moved: constellations that stand still (`fixed`), and the robots' normals, against the rig's world.

Where a fixed constellation's spots should be follows from the rig alone; what they are off by in the mean of all frames
is explained by a motion of the camera (six numbers), or by a focal length that is off (one).
"""

import math
from typing import NamedTuple

import numpy as np

from asterism.protocol.constellation import LEDS
from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig
from asterism.server.doctor.finding import Finding, Verdict, graded
from asterism.server.doctor.gather import Gathered, Sightings

# Where a constellation stands was measured too: to 0.1 mm, which is a tenth to a third of a pixel.
SURVEYED_PX = 0.1
LOOK_PX, WRONG_PX = 0.3, 1.0
SIGMAS = 5.0
FOCAL_SHARE = 0.9  # of the squared displacement that a focal length explains before it is called one
FEWEST = 5  # frames
STEP = 1e-5


class LensOrPlace(NamedTuple):
    """What fixed constellations tell: ``shift_px`` in the mean over their LEDs, whether it is ``sure``, ``tilt_deg``
    and ``moved_m`` of the camera if that moved; ``focal_limit``, the least error of the focal length that would
    show, relative; ``lens``, what is told where the focal length explains it; ``alone``, the one constellation that
    does not stand where it stood, while the others do.
    """

    shift_px: float
    sure: bool
    tilt_deg: float
    moved_m: float
    focal_limit: float
    lens: str = ""
    alone: str = ""


class Displaced(NamedTuple):
    """``off`` (k, 6, 2) px of k fixed constellations, observed minus the rig's, nan for LEDs not seen, one ``sigma``
    (k,) px of that, ``points`` (k, 6, 3) m in the camera's frame by the rig; ``names``.
    """

    off: Floats
    sigma: Floats
    points: Floats
    names: list[str]


def displaced(rig: Rig, seen: Sightings) -> Displaced:
    """Means over all frames."""
    T_camera_world = (rig.T_world_camera or Pose.identity()).inverse()
    off, sigma, points, names = [], [], [], []
    for number, robot in enumerate(rig.robots):
        mine = seen.of(number)
        if robot.T_world_fixed is None or len(mine.frames) < FEWEST:
            continue
        led = (T_camera_world @ robot.T_world_fixed).map(robot.leds)
        # By way of the poses, so that what shifts an LED's spot (its optics, its perspective) is in both.
        found = np.array([rig.camera.project(pose.map(robot.leds)) for pose in mine.poses])
        counts = mine.lit.sum(axis=0)[:, None]
        away = mine.residuals + found - rig.camera.project(led)
        total = np.where(mine.lit[..., None], away, 0.0).sum(axis=0)
        off.append(np.where(counts > 0, total / np.maximum(counts, 1), np.nan))
        own = float(np.nanmedian(0.5 * (mine.covariances[..., 0] + mine.covariances[..., 2]))) / len(mine.frames)
        sigma.append(math.hypot(math.sqrt(own), SURVEYED_PX))
        points.append(led)
        names.append(robot.id)
    shape = (len(names), LEDS)
    return Displaced(np.array(off).reshape(*shape, 2), np.array(sigma), np.array(points).reshape(*shape, 3), names)


def judge_place(rig: Rig, seen: Sightings) -> LensOrPlace | None:
    """What they say; None where there are none."""
    found = displaced(rig, seen)
    if not found.names:
        return None
    told = _explained(rig, found)
    if len(found.names) > 2 and told.sure:
        for k, name in enumerate(found.names):
            rest = np.arange(len(found.names)) != k
            names = [other for other in found.names if other != name]
            others = _explained(rig, Displaced(found.off[rest], found.sigma[rest], found.points[rest], names))
            if not others.sure:
                return told._replace(alone=name, lens="")
    return told


def _explained(rig: Rig, found: Displaced) -> LensOrPlace:
    lit = np.isfinite(found.off[..., 0])
    off, points = found.off[lit], found.points[lit]
    sigma = np.repeat(found.sigma, lit.sum(axis=1))
    by_motion = _by_motion(rig, points) / sigma[:, None, None]
    told = (off / sigma[:, None]).ravel()
    motion = np.linalg.lstsq(by_motion.reshape(-1, 6), told, rcond=None)[0]
    middle = rig.camera.matrix[:2, 2]
    zoom = ((rig.camera.project(points) - middle) / sigma[:, None]).ravel()
    focal = float(zoom @ told) / float(zoom @ zoom)
    whole = float(told @ told)
    left = float(((told - focal * zoom) ** 2).sum())
    # A single constellation's errors of survey are shared by its LEDs: it counts once.
    k = len(found.names)
    shift = float(np.sqrt((off**2).sum(axis=1).mean()))
    sure = shift > LOOK_PX and whole / lit.sum() * k > SIGMAS**2
    lens = ""
    if sure and left < (1.0 - FOCAL_SHARE) * whole:
        lens = f"focal length {100 * focal:+.2f} % off by what stands still"
    return LensOrPlace(
        shift,
        sure,
        math.degrees(float(np.linalg.norm(motion[3:]))),
        float(np.linalg.norm(motion[:3])),
        LOOK_PX / float(np.sqrt(((rig.camera.project(points) - middle) ** 2).sum(axis=1).mean())),
        lens,
    )


def _by_motion(rig: Rig, points: Floats) -> Floats:
    """Derivatives (n, 2, 6) of pixels by where the camera is: its place and its turn about its own axes."""
    by = np.empty((len(points), 2, 6))
    for k in range(3):
        axis = np.eye(3)[k]
        for column, move in ((k, -axis), (3 + k, -np.cross(axis, points))):
            ahead, behind = (rig.camera.project(points + sign * STEP * move) for sign in (1.0, -1.0))
            by[..., column] = (ahead - behind) / (2.0 * STEP)
    return by


def check_place(gathered: Gathered, judged: LensOrPlace | None) -> Finding:
    """Whether the camera, or what stands still, is where the rig has it."""
    name, rig = "camera's place", gathered.rig
    if judged is None:
        return _by_normals(gathered)
    verdict = graded(judged.shift_px, LOOK_PX, WRONG_PX) if judged.sure else Verdict.GOOD
    told = f"what stands still is {judged.shift_px:.2f} px from where the rig has it"
    if verdict == Verdict.GOOD:
        return Finding(name, verdict, told)
    if judged.alone:
        told = f"{judged.alone} has moved, the other fixed constellations have not"
        return Finding(name, verdict, told, f"Measure where {judged.alone} stands, or take its `fixed` out of the rig.")
    if judged.lens:
        return Finding(name, Verdict.LOOK, f"{told}, as a wrong focal length would do", "See calibration first.")
    told += f": the camera turned by {judged.tilt_deg:.2g}° or moved by {1e3 * judged.moved_m:.2g} mm"
    advice = "Place the camera anew: asterism calibrate world RIG SOURCE --fixed"
    assert rig.T_world_camera is not None
    return Finding(name, verdict, told, f"{advice}.")


def _by_normals(gathered: Gathered) -> Finding:
    """Where nothing stands still: robots that lean farther than `normal` allows."""
    name, rig, seen = "camera's place", gathered.rig, gathered.sightings
    leaning: dict[str, float] = {}
    for number, robot in enumerate(rig.robots):
        mine = seen.of(number)
        if robot.normal is None or rig.T_world_camera is None or len(mine.frames) < FEWEST:
            continue
        axes = np.array([rig.T_world_camera.rotation @ pose.rotation @ robot.axis for pose in mine.poses])
        angles = np.arccos(np.clip(axes @ robot.normal.world, -1.0, 1.0))
        leaning[robot.id] = float(np.median(angles)) / robot.normal.within_rad
    if not leaning:
        return Finding(name, Verdict.UNTOLD, "nothing in the rig stands still (`fixed`) or has a `normal`")
    worst = max(leaning, key=lambda robot: leaning[robot])
    told = f"robots lean by up to {leaning[worst]:.0%} of what their `normal` allows"
    if leaning[worst] <= 1.0:
        return Finding(name, Verdict.GOOD, f"{told}; nothing stands still (`fixed`)")
    return Finding(name, Verdict.WRONG, f"{told} ({worst})", "Has the camera been moved? asterism calibrate world.")
