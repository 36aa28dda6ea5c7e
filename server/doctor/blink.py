"""From mid-exposure to the stamp: `capture.delay_us`, from an LED that blinks by the host's clock.

The LED is on during the first half of every period, periods beginning at whole multiples of it since the epoch. Which
frames show it, against their stamps taken by the period, is off by the delay; where lit turns to dark tells it, as
finely as stamps fall around there. It is told within half a period to either side: whole periods cannot be told.
"""

from fractions import Fraction
from typing import NamedTuple

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.protocol.messages import Fate
from asterism.server.doctor.finding import Finding, Verdict
from asterism.server.doctor.gather import Gathered, Ints, Pictures

CELL_PX = 4.0  # a light that blinks stays within so many
LIT = (0.25, 0.75)  # share of the frames that show it
FEWEST = 40  # frames
MOST_WRONG = 0.05  # share of the frames that contradict the best delay: jitter, and the frames in which it changes
FINE = 2000  # delays that are tried
FINEST = 1000  # the denominator of a frequency
SHOWN = (int(Fate.UNEXPLAINED), int(Fate.LED))


class Delay(NamedTuple):
    """``delay_s`` from mid-exposure to the stamp, give or take ``within_s``; ``x`` and ``y`` px of the LED."""

    delay_s: float
    within_s: float
    x: float
    y: float


def blinking(pictures: Pictures) -> list[tuple[float, float, Floats]]:
    """Lights that are seen in part of the frames at one place: x, y px, and whether each frame (n,) shows it."""
    n = len(pictures.spots)
    cells: dict[tuple[float, int, int], list[tuple[int, float, float]]] = {}
    for frame, spots in enumerate(pictures.spots):
        for x, y in spots[np.isin(spots[:, 3], SHOWN), :2].tolist():
            # Two nets of cells, so that a light on the border of one lies within the other's.
            for shift in (0.0, 0.5):
                cell = (shift, round(x / CELL_PX + shift), round(y / CELL_PX + shift))
                cells.setdefault(cell, []).append((frame, x, y))
    found = []
    for rows in cells.values():
        lit = np.zeros(n)
        lit[[frame for frame, _, _ in rows]] = 1.0
        if LIT[0] <= lit.mean() <= LIT[1] and np.ptp([x for _, x, _ in rows]) < 1.0:
            found.append((float(np.mean([x for _, x, _ in rows])), float(np.mean([y for _, _, y in rows])), lit))
    return found


def phases(exposed_ns: Ints, blink_hz: float) -> Floats:
    """Where in their periods stamps (n,) are, 0 to 1; in whole numbers, since there are billions of periods before."""
    hz = Fraction(blink_hz).limit_denominator(FINEST)
    whole = 1_000_000_000 * hz.denominator
    return np.array([(time * hz.numerator % whole) / whole for time in exposed_ns.tolist()])


def delay_of(exposed_ns: Ints, lit: Floats, blink_hz: float) -> tuple[float, float] | None:
    """The delay and half the width of what fits as well, s; None where no delay explains which frames are ``lit``."""
    phase = phases(exposed_ns, blink_hz)
    trials = np.arange(FINE) / FINE - 0.5
    told = ((phase[None] - trials[:, None]) % 1.0 < 0.5) != (lit[None] > 0.5)
    wrong = told.sum(axis=1)
    best = np.flatnonzero(wrong == wrong.min())
    if wrong.min() > MOST_WRONG * len(lit) or np.ptp(best) != len(best) - 1:
        return None
    scale = 1.0 / blink_hz
    return float(trials[best].mean() * scale), float((0.5 * len(best) / FINE + 0.5 / FINE) * scale)


def check_delay(gathered: Gathered, blink_hz: float | None) -> Finding:
    """What stamps are late by, as the rig's delay_us has it already taken off."""
    name, pictures = "stamp delay", gathered.pictures
    known = gathered.rig.capture.delay_us
    if blink_hz is None:
        told = f"delay_us: {known:g} as the rig says; no LED blinks by this clock"
        return Finding(name, Verdict.UNTOLD, told)
    if len(pictures.spots) < FEWEST:
        return Finding(name, Verdict.UNTOLD, f"fewer than {FEWEST} frames")
    delays = [
        Delay(*delay, x, y)
        for x, y, lit in blinking(pictures)
        if (delay := delay_of(pictures.exposed_ns, lit, blink_hz)) is not None
    ]
    if not delays:
        advice = f"Let an LED in view be on for the first half of every 1/{blink_hz:g} s of this computer's clock."
        return Finding(name, Verdict.UNTOLD, f"no light blinks at {blink_hz:g} Hz", advice)
    best = min(delays, key=lambda delay: delay.within_s)
    late = f"{1e6 * best.delay_s:+.0f} ± {1e6 * best.within_s:.0f} us"
    told = f"stamps are late by {late} (LED at {best.x:.0f}, {best.y:.0f} px)"
    if abs(best.delay_s) <= 2.0 * best.within_s:
        return Finding(name, Verdict.GOOD, told)
    new = known + 1e6 * best.delay_s
    return Finding(name, Verdict.LOOK, told, f"Set capture.delay_us: {new:.0f} in the rig.")
