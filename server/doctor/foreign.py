"""What is in the image beside LEDs: hot pixels, lamps, glints."""

from collections import Counter

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.protocol.messages import Fate
from asterism.server.doctor.finding import Finding, Verdict, graded
from asterism.server.doctor.gather import Gathered, Pictures

STAYS = 0.8  # share of the frames in which a hot pixel is seen: its noise takes it below the threshold at times
FEWEST_FRAMES = 5
SAME_PX = 1.0
# Sensors' data sheets allow a few in a million; each costs a spot's time, and one beside an LED pulls its centre.
LOOK_HOT, WRONG_HOT = 10, 1000
# Spots a frame that are nobody's, before they count at all: so many cost no time, and noise and the blocks of a JPEG
# make a dozen points.
LEAST_FOREIGN = 24
OWN = (int(Fate.LED), int(Fate.MASKED))
REASONS = {
    "UNEXPLAINED": "like LEDs, but no robot's",
    "TOO_SMALL": "points",
    "TOO_LARGE": "large",
    "ELONGATED": "streaks",
    "AT_EDGE": "at the edge",
    "TOO_FAINT": "faint",
    "MISSHAPEN": "ragged",
}


def hot_pixels(pictures: Pictures) -> Floats:
    """Places (k, 2) px of single pixels that are bright in (almost) every frame."""
    n = len(pictures.spots)
    if n < FEWEST_FRAMES:
        return np.empty((0, 2))
    places: Counter[tuple[int, int]] = Counter()
    for spots in pictures.spots:
        small = spots[spots[:, 3] == int(Fate.TOO_SMALL), :2]
        places.update({(round(x / SAME_PX), round(y / SAME_PX)) for x, y in small.tolist()})
    staying = [place for place, count in places.items() if count >= STAYS * n]
    return SAME_PX * np.array(staying, np.float64).reshape(-1, 2)


def check_hot_pixels(gathered: Gathered) -> Finding:
    """Single pixels that never move."""
    if len(gathered.pictures.spots) < FEWEST_FRAMES:
        return Finding("hot pixels", Verdict.UNTOLD, f"fewer than {FEWEST_FRAMES} frames")
    found = hot_pixels(gathered.pictures)
    verdict = graded(len(found), LOOK_HOT, WRONG_HOT)
    told = f"{len(found)} single pixels shine in every frame" if len(found) else "none"
    if verdict == Verdict.GOOD:
        return Finding("hot pixels", verdict, told)
    x, y = found[0]
    advice = (
        f"Less gain, a cooler or shorter exposed sensor, or the camera's own correction (one is at {x:.0f}, {y:.0f})."
    )
    return Finding("hot pixels", verdict, told, advice)


def check_clutter(gathered: Gathered) -> Finding:
    """Spots a frame that are no LEDs, by the reason they are rejected for; hot pixels are told elsewhere."""
    pictures, n = gathered.pictures, max(len(gathered.pictures.fates), 1)
    total: Counter[int] = Counter()
    for fates in pictures.fates:
        total.update(fates)
    total[int(Fate.TOO_SMALL)] = max(total[int(Fate.TOO_SMALL)] - n * len(hot_pixels(pictures)), 0)
    counts = {Fate.Name(fate): count / n for fate, count in total.items() if fate not in OWN and count}
    foreign = sum(counts.values())
    # As many again as the rig's robots have LEDs.
    allowed = max(LEAST_FOREIGN, 6 * len(gathered.rig.robots))
    verdict = graded(foreign, allowed, 10.0 * allowed)
    few = sorted(counts.items(), key=lambda item: -item[1])[:3]
    told = ", ".join(f"{count:.1f} {REASONS.get(reason, reason)}" for reason, count in few if count >= 0.05)
    told = f"{foreign:.1f} other spots a frame" + (f": {told}" if told else "")
    if verdict == Verdict.GOOD:
        return Finding("clutter", verdict, told)
    return Finding("clutter", verdict, told, "Cover or switch off what shines, use a filter, or `masks` in the rig.")
