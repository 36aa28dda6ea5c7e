"""Robots that are found, but do not fit: which of their LEDs is not where the rig has it, and how far off.

The residuals of all sightings of a robot together, without what its poses take up (`residuals`), are explained by moves
of its LEDs in their plane. What one bent LED leaves behind is spread over all six; which one it is shows in that its
two numbers explain nearly as much as all twelve do, and much more than those of any other LED.
"""

from typing import NamedTuple

import numpy as np
from scipy import stats

from asterism.protocol.constellation import LEDS
from asterism.protocol.geometry import Floats
from asterism.protocol.messages import Fate
from asterism.protocol.program import typed
from asterism.protocol.rig import Rig
from asterism.server.doctor.finding import Finding, Verdict, graded
from asterism.server.doctor.gather import Gathered, Sightings
from asterism.server.doctor.patterns import by_leds
from asterism.server.doctor.residuals import explained_by, whitened

FREE_M = 1e-3  # LEDs may be anywhere within this, one sigma: it only keeps moves finite that poses take up
FEWEST = 5  # sightings
SURE = 1e-6  # of a false alarm in one robot
# calibrate leds leaves 2 to 3 um, a circuit board 50 to 100, a ruler 500. What poses do not take up of one bent LED is
# a quarter to a half of it, spread over all six.
LOOK_M, WRONG_M = 10e-6, 100e-6
LOOK_BENT_M, WRONG_BENT_M = 30e-6, 300e-6
BEYOND_NOISE = 0.5  # of a frame's own noise: less is lost in it
ALONE = 0.8  # share of what all LEDs together explain
CLEARER = 25.0  # chi squared, than any other LED
BESIDE = 0.5  # of the distance to the next LED: a spot so near where an LED should be is its own
MOSTLY = 0.5  # of the sightings


class Misfit(NamedTuple):
    """Of one robot: ``rms_m`` by which its LEDs are off, as far as poses do not take it up, ``rms_px`` and ``noise_px``
    of a spot; ``chance`` of as much without a cause; ``led`` which alone explains it, -1 for none, and by how much that
    is off, ``led_m`` give or take ``sigma_m``.
    """

    rms_m: float
    rms_px: float
    noise_px: float
    chance: float
    led: int = -1
    led_m: float = 0.0
    sigma_m: float = 0.0


def misfit_of(rig: Rig, seen: Sightings) -> Misfit | None:
    """What the sightings of one robot tell; None of too few."""
    told = whitened(rig, seen)
    free = float(told.freedom.sum())
    if len(seen.frames) < FEWEST or free < 2 * LEDS:
        return None
    by = explained_by(told, by_leds(rig, seen, told))
    matrix, right = np.einsum("mip,miq->pq", by, by), np.einsum("mip,mi->p", by, told.residuals)
    moves = np.linalg.solve(matrix + np.eye(2 * LEDS) / FREE_M**2, right)
    gain = float(2.0 * moves @ right - moves @ matrix @ moves)
    # What is left when LEDs have moved is noise of which nothing else is known: where it is more than spots say, so is
    # everything that is drawn from it.
    scale = max((float((told.residuals**2).sum()) - gain) / max(free - 2 * LEDS, 1.0), 1.0)
    noise_px = float(np.sqrt(np.nanmedian(0.5 * (seen.covariances[..., 0] + seen.covariances[..., 2]))))
    rms_px = noise_px * float(np.sqrt(max(gain - 2 * LEDS * scale, 0.0) / free))
    px_per_m = float(np.sqrt(np.trace(matrix) / (2 * LEDS * len(seen.frames)))) * noise_px
    found = Misfit(rms_px / max(px_per_m, 1e-9), rms_px, noise_px, float(stats.chi2.sf(gain / scale, 2 * LEDS)))
    return _single(found, matrix, right, gain, scale)


def _single(found: Misfit, matrix: Floats, right: Floats, gain: float, scale: float) -> Misfit:
    """The same, with the one LED that explains it, if there is one."""
    gains, moved, sigmas = np.zeros(LEDS), np.zeros(LEDS), np.zeros(LEDS)
    for led in range(LEDS):
        two = slice(2 * led, 2 * led + 2)
        inverse = np.linalg.inv(matrix[two, two] + np.eye(2) / FREE_M**2)
        move = inverse @ right[two]
        gains[led], moved[led] = float(move @ right[two]), float(np.linalg.norm(move))
        sigmas[led] = float(np.sqrt(scale * np.trace(inverse) / 2.0))
    first, second = np.argsort(-gains)[:2].tolist()
    if gains[first] < ALONE * gain or gains[first] - gains[second] < CLEARER * scale:
        return found
    return found._replace(led=first, led_m=float(moved[first]), sigma_m=float(sigmas[first]))


def left_out(gathered: Gathered, robot: int) -> Misfit | None:
    """An LED that its robot's poses do without, while a spot shines beside where it should be: it is bent."""
    rig, seen = gathered.rig, gathered.sightings.of(robot)
    if len(seen.frames) < FEWEST:
        return None
    unseen = ~seen.lit
    led = int(unseen.sum(axis=0).argmax())
    if unseen[:, led].mean() < MOSTLY:
        return None
    leds = rig.robots[robot].leds
    nearest_m = float(np.sort(np.linalg.norm(leds - leds[led], axis=1))[1])
    away = []
    for k in np.flatnonzero(unseen[:, led]).tolist():
        point = seen.poses[k].map(leds[led])
        spots = gathered.pictures.spots[int(seen.frames[k])]
        free = spots[spots[:, 3] == int(Fate.UNEXPLAINED), :2]
        m_per_px = float(point[2]) / rig.camera.focal_px
        off = np.linalg.norm(free - rig.camera.project(point), axis=1) * m_per_px
        if len(off) and off.min() < BESIDE * nearest_m:
            away.append(float(off.min()))
    if len(away) < MOSTLY * unseen[:, led].sum():
        return None
    middle, spread = float(np.median(away)), float(np.std(away))
    if spread > 0.3 * middle:  # something that passes by
        return None
    return Misfit(middle, middle / m_per_px, 0.0, 0.0, led, middle, spread / max(len(away), 1) ** 0.5)


def check_positions(gathered: Gathered, rig_name: str) -> Finding:
    """Every robot's LEDs against its residuals."""
    name, rig = "LED positions", gathered.rig
    found: dict[str, Misfit] = {}
    for number, robot in enumerate(rig.robots):
        mine = gathered.sightings.of(number)
        misfit = left_out(gathered, number) or (misfit_of(rig, mine) if len(mine.frames) else None)
        if misfit is not None:
            found[robot.id] = misfit
    if not found:
        return Finding(name, Verdict.UNTOLD, f"no robot with all its LEDs in {FEWEST} frames")
    verdicts = {robot: _verdict(misfit) for robot, misfit in found.items()}
    worst = max(found, key=lambda robot: (verdicts[robot], found[robot].led_m or found[robot].rms_m))
    misfit, verdict = found[worst], verdicts[worst]
    if verdict == Verdict.GOOD:
        most = max(misfit.rms_m for misfit in found.values())
        return Finding(name, verdict, f"all within {max(1e3 * most, 0.001):.2g} mm, as far as poses show it")
    advice = f"Run {typed('calibrate', 'leds', rig_name, 'RECORDING', '--robot', worst, '-o', 'OUT')}"
    others = sum(other > Verdict.GOOD for other in verdicts.values()) - 1
    more = f"; so are {others} others" if others > 1 else "; so is another's" if others else ""
    if misfit.led >= 0:
        told = f"{worst}: LED {misfit.led} is {_mm(misfit.led_m, misfit.sigma_m)} off{more}"
        return Finding(name, verdict, told, f"{advice}, or bend it back.")
    told = f"{worst}: LEDs {1e3 * misfit.rms_m:.2g} mm ({misfit.rms_px:.2g} px) off{more}"
    return Finding(name, verdict, told, f"{advice}.")


def _verdict(misfit: Misfit) -> Verdict:
    if misfit.chance > SURE or misfit.rms_px < BEYOND_NOISE * misfit.noise_px:
        return Verdict.GOOD
    if misfit.led >= 0:
        return graded(misfit.led_m, LOOK_BENT_M, WRONG_BENT_M)
    return graded(misfit.rms_m, LOOK_M, WRONG_M)


def _mm(value: float, sigma: float) -> str:
    return f"{1e3 * value:.2f} ± {max(1e3 * sigma, 0.01):.2f} mm"
