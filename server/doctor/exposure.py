"""Is the light right: LEDs too bright or too dark, areas that glare, LEDs dimmer than their neighbours."""

import numpy as np
from scipy import stats

from asterism.protocol.constellation import LEDS
from asterism.protocol.geometry import Floats
from asterism.protocol.messages import Fate
from asterism.server.doctor.constellations import left_out
from asterism.server.doctor.finding import Finding, Verdict, graded
from asterism.server.doctor.gather import Gathered, Sightings

GAIN = 0.035  # variance a grey level of light, as `centres.centre` expects it
GOOD_HEIGHT = 150.0  # grey levels: the middle of what docs/hardware.md advises
LOOK_COST, WRONG_COST = 2.0, 4.0  # times as uncertain as at that height: as in `focus`
SATURATED = 0.05  # share of a spot's upper pixels from which on its top is cut off
LOOK_SATURATED = 0.5  # share of LEDs whose tops are cut off; centres bear twice and four times the range
FLAT = 0.85  # share of a spot's upper pixels that are saturated where light is several times the sensor's range
LOOK_BRIGHT, WRONG_BRIGHT = 0.005, 0.05  # share of the image
# LEDs of one batch differ by a fifth; by less than this share of its robot's middle one is weak, and soon not seen.
LOOK_DIM, WRONG_DIM = 0.6, 0.35
MISSING = 0.6  # share of its robot's sightings in which a dark LED is not seen
CHANCE = 1e-6


def check_exposure(gathered: Gathered) -> Finding:
    """How bright LEDs are: what their centres lose by it."""
    seen, name = gathered.sightings, "exposure"
    lit = seen.lit
    if not lit.any():
        return _unknown(gathered)
    saturated = float((seen.saturated[lit] > SATURATED).mean())
    flat = float((seen.saturated[lit] > FLAT).mean())
    height, noise = float(np.median(seen.heights[lit])), float(np.median(seen.noises[lit]))
    told = f"LEDs {height:.0f} grey levels above their surroundings, {saturated:.0%} of them saturated"
    if saturated >= LOOK_SATURATED:
        verdict = Verdict.WRONG if flat >= LOOK_SATURATED else Verdict.LOOK
        return Finding(name, verdict, told, "Expose for a shorter time, or less gain, until few LEDs are saturated.")
    cost = noise_cost(height, noise)
    verdict = graded(cost, LOOK_COST, WRONG_COST)
    if verdict > Verdict.GOOD:
        told = f"{told}: centres {cost:.1f} times as uncertain as at {GOOD_HEIGHT:.0f}"
        return Finding(name, verdict, told, "Expose for longer, open the aperture, or give the LEDs more current.")
    return Finding(name, verdict, told)


def noise_cost(height: float, noise: float) -> float:
    """How many times less sure a centre is than at GOOD_HEIGHT, by the noise half way up its edge."""
    variances = [(noise**2 + GAIN * 0.5 * level) / level**2 for level in (max(height, 1.0), GOOD_HEIGHT)]
    return float(np.sqrt(variances[0] / variances[1]))


def _unknown(gathered: Gathered) -> Finding:
    """Where nobody was found: what the brightest spots say."""
    spots = np.concatenate([np.empty((0, 4)), *gathered.pictures.spots])
    heights = spots[~np.isin(spots[:, 3], (int(Fate.TOO_SMALL), int(Fate.MASKED))), 2]
    if not len(heights):
        advice = "Are the LEDs on, is the lens uncovered and about in focus, the exposure long enough?"
        return Finding("exposure", Verdict.WRONG, "no light stands out of the image", advice)
    height = float(np.quantile(heights, 0.8))
    if height < 30.0:
        advice = "Expose for longer, open the aperture, or give the LEDs more current."
        return Finding("exposure", Verdict.WRONG, f"the brighter spots reach {height:.0f} grey levels", advice)
    return Finding("exposure", Verdict.UNTOLD, f"no robot was found; spots reach {height:.0f} grey levels")


def check_bright_areas(gathered: Gathered) -> Finding:
    """What of the image is saturated: lamps, sun, an exposure that lights the room."""
    share = float(np.median(gathered.pictures.bright))
    verdict = graded(share, LOOK_BRIGHT, WRONG_BRIGHT)
    told = f"{share:.1%} of the image is saturated"
    if verdict == Verdict.GOOD:
        return Finding("bright areas", verdict, told)
    return Finding("bright areas", verdict, told, "Keep other light out (filter, shade, masks), or expose for shorter.")


def check_dim(gathered: Gathered) -> Finding:
    """Single LEDs that are weaker than their robot's others, or dark."""
    rig, seen, name = gathered.rig, gathered.sightings, "LEDs lit"
    if not len(seen.frames):
        return Finding(name, Verdict.UNTOLD, "no robot was found")
    weak: list[tuple[float, str, int]] = []
    for number, robot in enumerate(rig.robots):
        mine = seen.of(number)
        if len(mine.frames) >= LEDS:
            shares = led_shares(mine)
            if (bent := left_out(gathered, number)) is not None:
                shares[bent.led] = 1.0  # it shines, elsewhere
            weak += [(float(share), robot.id, led) for led, share in enumerate(shares) if share < LOOK_DIM]
    if not weak:
        return Finding(name, Verdict.GOOD, "every robot's LEDs are about equally bright")
    worst = min(weak)
    verdict = Verdict.WRONG if worst[0] < WRONG_DIM else Verdict.LOOK
    told = "; ".join(f"{robot}: LED {led} {_weakness(share)}" for share, robot, led in sorted(weak)[:4])
    return Finding(name, verdict, told, f"Look at LED {worst[2]} of {worst[1]}: its wire, its current, what covers it.")


def _weakness(share: float) -> str:
    return "is dark, or too dim to be used" if share == 0.0 else f"has {share:.0%} of the others' light"


def led_shares(seen: Sightings) -> Floats:
    """Brightness (6,) of one robot's LEDs over the middle one of their robot; 0 for one that is missing while the
    others are seen, by more than chance.
    """
    lit = seen.lit
    relative = seen.heights / np.nanmedian(seen.heights, axis=1)[:, None]
    shares = np.array([np.median(relative[lit[:, led], led]) if lit[:, led].any() else 0.0 for led in range(LEDS)])
    missing, m = 1.0 - lit.mean(axis=0), len(lit)
    for led in range(LEDS):
        others = float(np.median(np.delete(missing, led)))
        # As often as that by chance, if it were as often hidden as the others?
        chance = stats.binom.sf(round(missing[led] * m) - 1, m, max(others, 0.02))
        if missing[led] >= MISSING and chance < CHANCE:
            shares[led] = 0.0
    return shares
