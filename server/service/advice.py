"""What a person can do where no robot is found: a sentence made from what the frames show."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from asterism.server.identity.follow import LEAST_LEDS
from asterism.server.service.tally import Seen

DARK = 40.0  # grey levels: an image without a brighter pixel shows no LED
SATURATED = 0.05  # of the pixels: no scene with LEDs of a few pixels is so bright
UNIT_RATIO = 30.0  # outside the rig's range by so much: millimetres
ODD_RATIO = 4.0  # and by so much: rather the constellation's size than the range
REJECTED = {
    "TOO_SMALL": "points of a pixel or two: hot pixels, or LEDs too far away or too small for this lens",
    "TOO_LARGE": (
        "larger than this rig's LEDs can be: expose for a shorter time, focus, or look at `range` and `led.radius`"
    ),
    "ELONGATED": "streaks: expose for a shorter time if the robots move, else they are reflections",
    "AT_EDGE": "cut off by the edge of the image: move the robots into view",
    "MASKED": "inside the rig's `masks`",
    "TOO_FAINT": "hardly brighter than what is around them: longer exposure, more gain, or less other light",
    "MISSHAPEN": "no single spots of light: out of focus, merged with others, or no LEDs",
}
CLOSE_BY = ("TOO_LARGE", "ELONGATED", "MISSHAPEN", "MASKED")  # fates that LEDs in full view may meet with


class Wider(NamedTuple):
    """A robot that is found where the rig's limits are not believed: how far off, m; whether as its mirror image."""

    robot: str
    distance_m: float
    mirrored: bool


def advice(seen: Seen, wider: Sequence[Wider], range_m: tuple[float, float]) -> str:
    """What is wrong, most likely, and what can be done; ``range_m`` is where the rig's robots are looked for."""
    if wider:
        return wider_advice(wider[0], range_m)
    if seen.saturated > SATURATED:
        return (
            f"{seen.saturated:.0%} of the image is saturated: expose for a shorter time, close the lens's aperture, or "
            "keep other light out"
        )
    kept = seen.spots.get("UNEXPLAINED", 0.0) + seen.spots.get("LED", 0.0)
    reason, rejected = _most_rejected(seen.spots)
    if kept < 1.0 and seen.brightest < DARK:
        return (
            f"the image is dark (its brightest pixel {seen.brightest:.0f} of 255): are the LEDs on, is the lens "
            "uncovered, the exposure long enough?"
        )
    if rejected > kept and (kept < LEAST_LEDS or reason in CLOSE_BY):
        total = sum(seen.spots.values())
        return f"of {total:.0f} spots a frame {rejected:.0f} are {reason}, {REJECTED[reason]}"
    if kept < LEAST_LEDS:
        found = f"only {kept:.1f} spots a frame look" if kept >= 0.05 else "no spot looks"
        return f"{found} like LEDs, a robot needs {LEAST_LEDS}: are its LEDs on, in view, turned to the camera?"
    return (
        f"{kept:.0f} spots a frame look like LEDs, but no robot of this rig fits them: are its robots in view, is it "
        "another rig, is an LED dead or not where the rig has it, is it the camera of camera.yaml?"
    )


def wider_advice(wider: Wider, range_m: tuple[float, float]) -> str:
    """What keeps a robot from being found that is there when the rig's limits are not believed."""
    robot, away = wider.robot, wider.distance_m
    near, far = range_m
    if wider.mirrored:
        return (
            f"{robot} is there as its mirror image: the camera's image is mirrored, or its LEDs were measured from "
            "behind (change the sign of their x)"
        )
    looked = f"the rig's range is {near:.3g} to {far:.3g} m"
    if away > UNIT_RATIO * far or away < near / UNIT_RATIO:
        return f"{robot} would be {away:.3g} m away, but {looked}: are its LEDs' positions in mm? Expected m"
    if away > ODD_RATIO * far or away < near / ODD_RATIO:
        return f"{robot} would be {away:.3g} m away, but {looked}: are its LEDs' positions right, and in m?"
    if not near <= away <= far:
        return f"{robot} is there, {away:.3g} m away, but {looked}: change `range`"
    return f"{robot} is there, but its spots are not as large as `led.radius` says: focus, measure it, or leave it out"


def _most_rejected(spots: Mapping[str, float]) -> tuple[str, float]:
    counts = {reason: spots.get(reason, 0.0) for reason in REJECTED}
    reason = max(counts, key=lambda name: counts[name])
    return reason, counts[reason]
