"""What a frame has to say of every robot of the rig: a pose, or why there is none."""

import math
from dataclasses import fields, replace
from typing import Any, NamedTuple, cast

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.protocol.messages import Fate
from asterism.server.centres.blobs import Blobs, Ints
from asterism.server.chain.standing import told_of
from asterism.server.compiled import compiled
from asterism.server.identity.identify import Matches
from asterism.server.identity.plan import Plan
from asterism.server.identity.rays import Rays
from asterism.server.pose.choose import Choices
from asterism.server.pose.fit import LEDS
from asterism.server.pose.solve import Alternative, Lost, PoseEstimate, Solutions
from asterism.server.pose.stood import ON_SURFACE, Stood

ALL_LEDS = tuple(range(LEDS))
NO_POSE = "no pose that faces the camera explains its spots"
SURE = 1e4  # odds beyond which the other tilt is not worth telling
LED = int(Fate.LED)  # as a plain integer for the compiled code

# A frozen object takes four times as long to make. This one becomes one when it is filled.
_Open: Any = type("_Open", (), {"__slots__": [field.name for field in fields(PoseEstimate)]})


class Owners(NamedTuple):
    """Columns of the blobs: their ``fates``, and whose LEDs they are, ``robots`` and ``leds``, each (n,)."""

    fates: Ints
    robots: Ints
    leds: Ints


class Told(NamedTuple):
    """What is told of m robots: ``spots`` (m, 6), rows of the blobs, -1 for LEDs not seen; ``residuals`` (m, 6, 2) px
    of the chosen minimum, and ``rms`` (m,), their root mean square over the LEDs seen, px.
    """

    spots: Ints
    residuals: Floats
    rms: Floats

    @staticmethod
    def room(robots: int) -> "Told":
        """Room for so many robots."""
        return Told(np.empty((robots, LEDS), np.int64), np.empty((robots, LEDS, 2)), np.empty(robots))


@compiled
def tell_whose(robots, assignment, rows, best, residuals, owners, told):
    """Write into the blobs' columns, `Owners`, whose LEDs they are, and fill `Told` of the robots.

    ``robots`` (m,) of the rig; ``assignment`` (m, 6) places in ``rows``, which are rows of the blobs, -1 for LEDs not
    seen; ``best`` (m,) of the two minima, -1 for none; ``residuals`` (m, 2, 6, 2) px.
    """
    for k in range(robots.shape[0]):
        square, count = 0.0, 0
        for led in range(LEDS):
            place = assignment[k, led]
            told.spots[k, led] = rows[place] if place >= 0 else -1
            told.residuals[k, led] = residuals[k, best[k], led]
            if place < 0:
                continue
            square += told.residuals[k, led, 0] ** 2 + told.residuals[k, led, 1] ** 2
            count += 1
            if best[k] >= 0:
                row = rows[place]
                owners.fates[row], owners.robots[row], owners.leds[row] = LED, robots[k], led
        told.rms[k] = math.sqrt(square / max(count, 1))


def answers_of(
    plan: Plan,
    blobs: Blobs,
    seen: Rays,
    matches: Matches,
    solutions: Solutions,
    choices: Choices,
    stood: Stood | None = None,
) -> dict[str, PoseEstimate | Lost]:
    """An answer for every robot of the rig, by its id: with the surface, where it ``stood`` on it. Writes the blobs'
    fates.
    """
    found, m = matches.found, len(matches.found.robots)
    extrapolated = _correct_z(plan, choices)
    # What can be done for all robots at once is; Python is slow at small arrays.
    told = Told.room(m)
    owners = Owners(blobs.fates, blobs.robots, blobs.leds)
    tell_whose(found.robots, found.assignment, seen.rows, choices.best, solutions.residuals, owners, told)
    numbers = (found.robots, choices.best, choices.odds, told.spots, told.rms)
    columns = [column.tolist() for column in numbers]
    # Walking along an array makes its rows in half the time that asking for each takes.
    poses = choices.positions, choices.quaternions, choices.covariances, told.residuals
    answers: dict[int, PoseEstimate | Lost] = {}
    for robot, best, *row in zip(*columns, extrapolated, *poses, strict=True):
        answers[robot] = _estimate(*row) if best >= 0 else Lost(NO_POSE)
    if stood is not None:
        _stand(plan, found.robots.tolist(), stood, answers)
    return {
        robot.id: answers[index] if index in answers else _lost(matches, index, len(seen.rows))
        for index, robot in enumerate(plan.rig.robots)
    }


def _estimate(
    odds: float, spots: list[int], rms_px: float, extrapolated: bool, positions: Floats, quaternions: Floats,
    covariance: Floats, residuals: Floats,
) -> PoseEstimate:  # fmt: skip
    """The pose of a matched robot, from its rows of `Choices` and `Told`."""
    alternative = Alternative(positions[1], quaternions[1], odds) if odds < SURE else None
    lit, seen = ALL_LEDS, tuple(spots)
    if -1 in spots:
        lit = tuple(led for led in ALL_LEDS if spots[led] >= 0)
        seen, residuals = tuple(spots[led] for led in lit), residuals[list(lit)]
    estimate = _Open()
    estimate.position, estimate.orientation, estimate.covariance = positions[0], quaternions[0], covariance
    estimate.leds, estimate.spots, estimate.residuals_px, estimate.rms_px = lit, seen, residuals, rms_px
    estimate.alternative, estimate.smoothed_by, estimate.extrapolated = alternative, "", extrapolated
    estimate.surface = None
    estimate.__class__ = PoseEstimate
    return cast(PoseEstimate, estimate)


def _stand(plan: Plan, robots: list[int], stood: Stood, answers: dict[int, PoseEstimate | Lost]) -> None:
    """Put in place of light's answers those with the surface, where it was used; say of the others why it was not."""
    for row, robot in enumerate(robots):
        alone = answers[robot]
        if not isinstance(alone, PoseEstimate) or not stood.standing[row]:
            continue
        told = told_of(plan, robot, row, stood, (alone.pose, alone.covariance, alone.alternative))
        if stood.standing[row] != ON_SURFACE:
            answers[robot] = replace(alone, surface=told)
            continue
        odds, positions, quaternions = float(stood.odds[row]), stood.positions[row], stood.quaternions[row]
        residuals = stood.residuals[row, list(alone.leds)]
        answers[robot] = replace(
            alone,
            position=positions[0],
            orientation=quaternions[0],
            covariance=stood.covariances[row],
            residuals_px=residuals,
            rms_px=math.sqrt(float((residuals**2).sum()) / len(residuals)),
            alternative=Alternative(positions[1], quaternions[1], odds) if odds < SURE else None,
            surface=told,
        )


def _correct_z(plan: Plan, choices: Choices) -> list[bool]:
    """Add the rig's correction of the camera's Z to both candidates' positions, and its variance to the chosen one's
    covariances; returns whose was extrapolated.
    """
    correction, positions, turn = plan.rig.z_correction, choices.positions, plan.mounts.camera_rotation
    m = len(positions)
    if correction is None:
        return [False] * m
    found = correction.at((positions.reshape(-1, 3) - plan.mounts.camera_origin) @ turn)
    along = turn[:, 2]
    positions += found.dz.reshape(m, 2, 1) * along
    choices.covariances[:, :3, :3] += found.variances[::2, None, None] * np.outer(along, along)
    extrapolated: list[bool] = found.extrapolated[::2].tolist()
    return extrapolated


def _lost(matches: Matches, robot: int, spots: int) -> Lost:
    doubt = matches.doubts.get(robot)
    if doubt is not None:
        return Lost(doubt, "IDENTITY_AMBIGUOUS")
    nothing = "none of its LEDs is visible" if spots == 0 else "its constellation is not among the spots"
    return Lost(matches.reasons.get(robot, nothing))
