"""Do frames come as often as they should, are any missing, do their stamps hold."""

from typing import NamedTuple

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.protocol.messages import Clock
from asterism.server.doctor.finding import Finding, Verdict, graded
from asterism.server.doctor.gather import Gathered, Pictures

FEWEST = 10  # frames
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


def stamps_of(pictures: Pictures) -> Stamps | None:
    """What stamps and numbers tell; None of too few frames."""
    if len(pictures.exposed_ns) < FEWEST:
        return None
    gaps = np.diff(pictures.exposed_ns)
    steps = np.diff(pictures.indices)
    forward = gaps[gaps > 0]
    if not len(forward):
        return Stamps(0.0, 0, 0.0, len(gaps), False)
    period = _period(forward.astype(np.float64))
    beats = np.maximum(np.rint(forward / period), 1.0)
    off = forward - beats * period
    # A gap's error is that of two stamps.
    jitter = float(np.sqrt(np.mean(off**2) / 2.0))
    missing = max(int(np.maximum(beats - 1.0, 0.0).sum()), int(np.maximum(steps - 1, 0).sum()))
    counted = int(pictures.clocks[0]) == int(Clock.FILE) and float(np.ptp(gaps / steps)) <= COUNTED_NS
    return Stamps(period * 1e-9, missing, jitter * 1e-9, int((gaps <= 0).sum()), counted)


def _period(gaps: Floats) -> float:
    """Of mostly single beats: the median, then the mean over the beats that it tells."""
    period = float(np.median(gaps))
    for _ in range(3):
        beats = np.maximum(np.rint(gaps / period), 1.0)
        near = np.abs(gaps - beats * period) < 0.35 * period
        if near.any():
            period = float(gaps[near].sum() / beats[near].sum())
    return period


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
    n = len(gathered.pictures.exposed_ns)
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
    clock = Clock.Name(int(gathered.pictures.clocks[-1]))
    told = f"{clock}'s jitter {found.jitter_s * 1e3:.2f} ms (one sigma)"
    verdict = graded(found.jitter_s, JITTER_LOOK_S, JITTER_WRONG_S)
    if verdict == Verdict.GOOD:
        return Finding(name, verdict, told)
    away = found.jitter_s * 0.5 * 1e3
    advice = f"At 0.5 m/s that is {away:.1f} mm: use the camera's or the driver's clock, or a computer less busy."
    return Finding(name, verdict, told, advice)
