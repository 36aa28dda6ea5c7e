"""The surface that robots work on: whether the camera sees it, and whether those that stand on it are near it."""

import numpy as np

from asterism.protocol.surface_sight import sight_of, sight_sentence
from asterism.server.doctor.finding import Finding, Verdict, graded
from asterism.server.doctor.gather import Gathered

LOOK_M, WRONG_M = 2e-3, 20e-3  # a lifted tool is looked at; a surface elsewhere is wrong
FEWEST = 5  # sightings
SHARE = 0.2  # of the surface: less is hardly meant


def check_surface(gathered: Gathered) -> list[Finding]:
    """One finding, or none where the rig has no surface."""
    rig, name = gathered.rig, "surface"
    sight = sight_of(rig)
    if sight is None or rig.surface is None or rig.T_world_camera is None:
        return []
    told = sight_sentence(sight)
    if sight.share == 0.0 or sight.in_range == 0.0:
        advice = "Are `world`, `range` and `surface.frame` right? Does its z point out of the material?"
        return [Finding(name, Verdict.WRONG, told, advice)]
    verdict = Verdict.GOOD if sight.share >= SHARE and sight.in_range >= SHARE else Verdict.LOOK
    advice = "" if verdict == Verdict.GOOD else "Is the camera aimed at where robots work, and `range` right?"
    worst = ("", 0.0)
    for number, robot in enumerate(rig.robots):
        mine = gathered.sightings.of(number)
        if robot.stands is None or len(mine.frames) < FEWEST:
            continue
        point = robot.points[robot.stands.point]
        touch = rig.surface.touch(np.array([(rig.T_world_camera @ pose).map(point) for pose in mine.poses]))
        if touch.inside.any():
            off = float(np.median(touch.distances[touch.inside]))
            worst = max(worst, (robot.id, off), key=lambda entry: abs(entry[1]))
    if worst[0]:
        told += f"; robots' points within {1e3 * abs(worst[1]):.2g} mm of it"
        near = graded(abs(worst[1]), LOOK_M, WRONG_M)
        if near > verdict:
            side = "above" if worst[1] > 0 else "below"
            advice = f"{worst[0]} is {1e3 * abs(worst[1]):.2g} mm {side} it: run asterism calibrate surface."
            verdict = near
    return [Finding(name, verdict, told, advice)]
