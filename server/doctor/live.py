"""The page that is looked at while one turns the lens: the blur in large figures, several times a second."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from rich.console import Group, RenderableType
from rich.text import Text

from asterism.protocol.rig import Rig
from asterism.server.chain.frame import Frame
from asterism.server.doctor.blur import SHARP_PX, Blur
from asterism.server.doctor.exposure import check_bright_areas, check_exposure
from asterism.server.doctor.finding import Finding
from asterism.server.doctor.focus import blurs, check_focus
from asterism.server.doctor.gather import Gathered, Gatherer
from asterism.server.doctor.page import table_of

EVERY_NS = 200_000_000  # of the stream's time, a new figure
NEWEST = 1  # sightings of each robot that it rests on
GLYPHS = {
    "0": "###|# #|# #|# #|###",
    "1": " # |## | # | # |###",
    "2": "###|  #|###|#  |###",
    "3": "###|  #|###|  #|###",
    "4": "# #|# #|###|  #|  #",
    "5": "###|#  |###|  #|###",
    "6": "###|#  |###|# #|###",
    "7": "###|  #|  #|  #|  #",
    "8": "###|# #|###|# #|###",
    "9": "###|# #|###|  #|###",
    ".": " | | | |#",
    "-": "   |   |###|   |   ",
}
BAR = 40  # columns


class Now(NamedTuple):
    """What the newest frames tell: the ``blur_px``, nan for none, the least there was; ``robots`` found, of all."""

    blur_px: float
    best_px: float
    robots: int
    of: int
    findings: list[Finding]


def watch(rig: Rig, frames: Iterator[Frame]) -> Iterator[Now]:
    """What to show, as often as the stream's time says. Raises InputError as `localize` does."""
    gatherer, began_ns, best = Gatherer(rig), 0, math.inf
    for frame in frames:
        if not len(gatherer):
            began_ns = frame.exposed_ns
        gatherer.add(frame)
        if frame.exposed_ns - began_ns < EVERY_NS:
            continue
        now = _now(gatherer.gathered(), blurs(gatherer.cutter.newest(NEWEST), rig), best)
        best = min(best, now.best_px)
        yield now
        gatherer = Gatherer(rig, gatherer.tracks)


def _now(gathered: Gathered, found: dict[int, Blur], best: float) -> Now:
    blur = float(np.median([blur.blur_px for blur in found.values()])) if found else math.nan
    robots = len(np.unique(gathered.sightings.robots))
    findings = [check_focus(found, gathered.rig), check_exposure(gathered), check_bright_areas(gathered)]
    return Now(blur, min(best, blur) if found else best, robots, len(gathered.rig.robots), findings)


def page(now: Now) -> RenderableType:
    """The page."""
    figure = "-" if math.isnan(now.blur_px) else f"{now.blur_px:.2f}"
    rows = [" ".join(GLYPHS[char].split("|")[row] for char in figure) for row in range(5)]
    large = Text("\n".join("  " + "".join(char * 2 for char in row).replace("#", "█") for row in rows), "bold")
    best = "" if math.isinf(now.best_px) else f", the least so far {now.best_px:.2f}"
    told = f"  px of blur (sharp: {SHARP_PX:g} and less){best}; robots seen: {now.robots} of {now.of}"
    return Group(Text(), large, Text(), Text(told), Text("  " + _bar(now)), Text(), table_of(now.findings))


def _bar(now: Now) -> str:
    """Longer the sharper; a mark where it was sharpest."""
    if math.isnan(now.blur_px):
        return "·" * BAR
    long, mark = (min(round(BAR * SHARP_PX / max(px, SHARP_PX)), BAR) for px in (now.blur_px, now.best_px))
    bar = "█" * long + "·" * (BAR - long)
    return bar if mark <= long else bar[: mark - 1] + "|" + bar[mark:]
