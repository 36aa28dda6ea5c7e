"""Do frames come as often as they should, are any missing, do their stamps hold."""

from typing import NamedTuple

import numpy as np

from asterism.protocol.messages import Clock
from asterism.server.doctor.finding import Finding, Verdict, graded
from asterism.server.doctor.gather import Gathered, Ints, Times

FEWEST = 10  # frames
PHASE_GAIN, PERIOD_GAIN = 0.25, 0.01  # of a stamp's error, in following the beat
RATE_LOOK, RATE_WRONG = 0.01, 0.1  # relative, from capture.rate
LOST_WRONG = 0.05  # share of the frames
# A robot at 0.5 m/s is elsewhere by 0.15 mm after the first, by 1 mm after the second.
JITTER_LOOK_S, JITTER_WRONG_S = 0.3e-3, 2e-3
COUNTED_NS = 2  # intervals as equal as that are counted, not measured


class Stamps(NamedTuple):
    """Frames' stamps against an even beat: ``period_s``; frames that ``lost`` says are missing; ``jitter_s`` of a
    stamp, one sigma; ``backwards``, how often time did not go on; ``counted``: nothing measured these times.
    """

    period_s: float
    lost: int
    jitter_s: float
    backwards: int
    counted: bool


def stamps_of(times: Times) -> Stamps | None:
    """What stamps and numbers tell; None of too few frames."""
    if len(times.exposed_ns) < FEWEST:
        return None
    gaps, steps = np.diff(times.exposed_ns), np.diff(times.indices)
    backwards = int((gaps <= 0).sum())
    if backwards:
        return Stamps(0.0, 0, 0.0, backwards, False)
    beats = beats_of(times.exposed_ns)
    period = float(gaps.sum()) / max(float(beats.sum()), 1.0)
    # A gap's error is that of two stamps.
    jitter = float(np.sqrt(np.mean((gaps - beats * period) ** 2) / 2.0))
    missing = max(int(beats.sum()) - len(gaps), int(np.maximum(steps - 1, 0).sum()), 0)
    counted = int(times.clocks[0]) == int(Clock.FILE) and float(np.ptp(gaps / np.maximum(steps, 1))) <= COUNTED_NS
    return Stamps(period * 1e-9, missing, jitter * 1e-9, 0, counted)


def beats_of(exposed_ns: Ints) -> Ints:
    """How many beats (n - 1,) each frame comes after the one before, 0 where a late stamp made the last gap too long.

    The beat is followed with part of each stamp's error, so that a stamp is held against many before it.
    """
    gaps = np.diff(exposed_ns)
    period, late = float(np.median(gaps)), 0.0
    beats = np.empty(len(gaps), np.int64)
    for k, gap in enumerate(gaps.tolist()):
        late += gap
        beats[k] = round(late / period)
        late -= beats[k] * period
        period += PERIOD_GAIN * late / max(int(beats[k]), 1)
        late *= 1.0 - PHASE_GAIN
    return beats


def check_rate(gathered: Gathered, found: Stamps | None) -> Finding:
    """Frames a second against `capture.rate`."""
    if found is None or not found.period_s:
        return Finding("frame rate", Verdict.UNTOLD, f"fewer than {FEWEST} frames")
    rate, asked = 1.0 / found.period_s, gathered.rig.capture.rate_hz
    if found.counted:
        return Finding("frame rate", Verdict.UNTOLD, f"{rate:.4g} Hz is counted: a film has no rate of its own")
    told = f"{rate:.2f} Hz" + (f" of {asked:g} asked for" if asked else "")
    verdict = graded(abs(rate / asked - 1.0), RATE_LOOK, RATE_WRONG) if asked else Verdict.GOOD
    if verdict == Verdict.GOOD:
        return Finding("frame rate", verdict, told)
    advice = "Is the exposure longer than a frame, the link too slow, an automatic on? Else change capture.rate."
    return Finding("frame rate", verdict, told, advice)


def check_lost(gathered: Gathered, found: Stamps | None) -> Finding:
    """Gaps in stamps and numbers."""
    name = "lost frames"
    if found is None or not found.period_s:
        return Finding(name, Verdict.UNTOLD, f"fewer than {FEWEST} frames")
    n = len(gathered.times.exposed_ns)
    share = found.lost / (n + found.lost)
    if not found.lost:
        return Finding(name, Verdict.GOOD, f"none of {n}")
    advice = "Look at cable, USB port or network (jumbo frames, rmem), and what else the computer does."
    verdict = Verdict.WRONG if share >= LOST_WRONG else Verdict.LOOK
    return Finding(name, verdict, f"{found.lost} of {n + found.lost} are missing ({share:.1%})", advice)


def check_jitter(gathered: Gathered, found: Stamps | None) -> Finding:
    """How evenly stamps follow one another."""
    name = "time stamps"
    if found is None:
        return Finding(name, Verdict.UNTOLD, f"fewer than {FEWEST} frames")
    if found.backwards:
        told = f"time stands still or runs backwards {found.backwards} times"
        return Finding(name, Verdict.WRONG, told, "Use the camera's own clock, and let nothing set the computer's.")
    if found.counted:
        return Finding(name, Verdict.UNTOLD, "counted, not measured: a film of images has no stamps")
    clock = Clock.Name(int(gathered.times.clocks[-1]))
    whose = "the file" if clock == "FILE" else clock
    told = f"{whose}'s jitter {found.jitter_s * 1e3:.2f} ms (one sigma)"
    verdict = graded(found.jitter_s, JITTER_LOOK_S, JITTER_WRONG_S)
    if verdict == Verdict.GOOD:
        return Finding(name, verdict, told)
    away = found.jitter_s * 0.5 * 1e3
    advice = f"At 0.5 m/s that is {away:.1f} mm: use the camera's or the driver's clock, or a computer less busy."
    return Finding(name, verdict, told, advice)
