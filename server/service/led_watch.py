"""Whether an LED of one robot has moved in its plate, or gone dark: against what the robot showed before.

A spot is off by much that is no move of its LED: how it lies on the pixels, how the lens is wrong just there, light
beside it. While a robot stands still all of that is the same in every frame, so a thousand frames say no more than one;
it is another where the robot has moved on. So what counts is places. A robot that was standing there before is
compared with itself at that place, by what changes there while nothing is wrong; else with the mean of all places
before, by how places differ. Both spreads are learned, as medians.
"""

from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.protocol.program import typed
from asterism.server.pose.fit import LEDS
from asterism.server.service.alarm import Finding, step_of
from asterism.server.service.sightings import Moves

SAME_PLACE_PX = 1.5  # no spot of the robot moves by more
RECENT = 20  # blocks that are judged
AT_LEAST = 8  # of them, before anything is said
SUSPECTED = 60  # blocks that are kept from the learning while something seems wrong
SETTLED = 10  # numbers that a spread is learned from, blocks that a place is told by
STOOD = 15  # blocks at a place, before the recent ones, that tell what is usual there
LEAST_PLACES = 12  # that tell what is usual anywhere
ALIKE = 3.0  # so many places that follow each other say as much as one: a lens is wrong over wide areas
MOST_PLACES = 100.0  # older ones fade
PLACES_PX, STANDING_PX = 0.02, 0.012  # one sigma of a coordinate between places, and at one, until they are learned
LEAST_PLACES_PX, LEAST_STANDING_PX = 0.012, 0.01  # and at least, whatever was learned
WIDER = 1.3  # of a median of squares, to be their mean and a little more
FAR_OFF = 6.0  # sigmas from which on a single place counts less
SURE, DOUBTFUL = 40.0, 16.0  # chi squared (two degrees of freedom) of a move that is said; that is not learned
WORTH_M, DOUBTFUL_M = 0.05e-3, 0.025e-3  # moves that are said; that are not learned


class Block(NamedTuple):
    """A second: the means of `Moves` (6, 2, 2), (6, 2), and the number of the place."""

    time_ns: int
    normals: Floats
    rights: Floats
    place: int


@dataclass(slots=True)
class _Mean:
    """The mean of blocks at a place, or of places; ``moves`` (6, 2) m are what it says of the LEDs."""

    count: float = 0.0
    normals: Floats = field(default_factory=lambda: np.zeros((LEDS, 2, 2)))
    rights: Floats = field(default_factory=lambda: np.zeros((LEDS, 2)))
    moves: Floats = field(default_factory=lambda: np.zeros((LEDS, 2)))

    def add(self, normals: Floats, rights: Floats, most: float = np.inf) -> None:
        self.count = min(1.0, most / (self.count + 1.0)) * self.count + 1.0
        self.normals += (normals - self.normals) / self.count
        self.rights += (rights - self.rights) / self.count
        self.moves = solved(self.normals, self.rights)


class _Compared(NamedTuple):
    """Recent blocks against what is usual: their equations (p, 6, 2, 2) and (p, 6, 2), the variances (p,) px^2."""

    normals: Floats
    rights: Floats
    variances: Floats


class LedWatch:
    """One robot's LEDs; `add` every second in which it was seen, then ask for a `finding`."""

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self._blocks: deque[Block] = deque()
        self._place, self._spots = 0, np.full((LEDS, 2), np.nan)
        self._stood: dict[int, _Mean] = {}  # by place: what it showed before the recent blocks
        self._usual = _Mean()  # of places
        self._between: deque[float] = deque(maxlen=60)  # squares of a coordinate, px^2, of places
        self._within: deque[float] = deque(maxlen=200)  # and of blocks at one
        self._places_px2, self._standing_px2 = PLACES_PX**2, STANDING_PX**2
        self._doubtful = False

    def add(self, time_ns: int, moves: Moves, spots: Floats, moved: bool) -> None:
        """One more second, of sightings (n, 6, ...) in which all LEDs are seen; ``spots`` (6, 2) px are where, on the
        mean; ``moved``: they were not the same all the time.
        """
        if moved or not float(np.abs(spots - self._spots).max()) <= SAME_PLACE_PX:
            self._place, self._spots = self._place + 1, spots
        n = len(moves.rights)
        self._blocks.append(Block(time_ns, moves.normals.sum(axis=0) / n, moves.rights.sum(axis=0) / n, self._place))
        most = SUSPECTED if self._doubtful else RECENT
        while len(self._blocks) > most:
            self._learn(self._blocks.popleft())

    def finding(self) -> Finding | None:
        """The LED that has moved, if one has."""
        recent = list(self._blocks)[-RECENT:]
        self._doubtful = False
        if (compared := self._compared(recent)) is None:
            return None
        normals, rights, variances = compared
        chi2 = weighed(normals, rights) / variances[:, None]
        weights = np.minimum(1.0, FAR_OFF / np.sqrt(np.maximum(chi2, 1e-12))) / variances[:, None]
        normals = (weights[..., None, None] * normals).sum(axis=0)
        rights = (weights[..., None] * rights).sum(axis=0)
        chi2, moves = weighed(normals, rights), solved(normals, rights)
        led = int(chi2.argmax())
        size = float(np.hypot(*moves[led]))
        self._doubtful = bool(chi2[led] > DOUBTFUL and size > DOUBTFUL_M)
        if chi2[led] < SURE or size < WORTH_M:
            return None
        self._keep_place()
        return self._told(led, moves[led], recent)

    def _compared(self, recent: list[Block]) -> _Compared | None:
        """What recent blocks say, place by place; None where too few can be compared."""
        by_place: dict[int, list[Block]] = {}
        for block in recent:
            by_place.setdefault(block.place, []).append(block)
        normals, rights, usual, variances, count = [], [], [], [], 0
        between = ALIKE * self._places_px2 * (1.0 + ALIKE / max(self._usual.count, 1.0))
        for place, here in by_place.items():
            stood = self._stood.get(place)
            if stood is None or stood.count < STOOD:
                if self._usual.count < LEAST_PLACES:
                    continue
                stood = self._usual
            count += len(here)
            normals.append(here[0].normals)
            # A glint that passes is no move.
            rights.append(here[0].rights if len(here) == 1 else np.median([block.rights for block in here], axis=0))
            usual.append(stood.moves)
            variances.append(between if stood is self._usual else self._standing_px2)
        if count < AT_LEAST:
            return None
        stacked = np.array(normals)
        return _Compared(stacked, np.array(rights) - across(stacked, np.array(usual)), np.array(variances))

    def _told(self, led: int, move: Floats, recent: list[Block]) -> Finding:
        size = float(np.linalg.norm(move))
        usual, shares = self._usual.moves[led], []
        for block in recent:
            stood = self._stood.get(block.place)
            before = stood.moves[led] if stood is not None and stood.count >= STOOD else usual
            now = solved(block.normals, block.rights)[led]
            shares.append(float((now - before) @ move) / size**2)
        return Finding(
            f"led {led}",
            f"{self._robot}: LED {led} is {1e3 * size:.2f} mm from where it was",
            f"bent, or light beside it? If it is bent, run "
            f"{typed('calibrate', 'leds', 'RIG', 'RECORDING', '--robot', self._robot, '-o', 'OUT')}",
            recent[step_of(shares)].time_ns,
        )

    def _learn(self, block: Block) -> None:
        """A block is no longer recent."""
        if self._doubtful:
            return
        stood = self._stood.setdefault(block.place, _Mean())
        if stood.count >= SETTLED:
            self._within.append(_square(block.normals, block.rights, stood.moves))
            if len(self._within) >= SETTLED:
                self._standing_px2 = max(WIDER * float(np.median(self._within)), LEAST_STANDING_PX**2)
        stood.add(block.normals, block.rights)
        if block.place != self._place and all(other.place != block.place for other in self._blocks):
            self._learn_place(self._stood.pop(block.place))

    def _learn_place(self, place: _Mean) -> None:
        if self._usual.count >= LEAST_PLACES:
            square = _square(place.normals, place.rights, self._usual.moves)
            self._between.append(square / (1.0 + ALIKE / self._usual.count))
            if len(self._between) >= SETTLED:
                self._places_px2 = max(WIDER * float(np.median(self._between)), LEAST_PLACES_PX**2)
        self._usual.add(place.normals, place.rights, MOST_PLACES)

    def _keep_place(self) -> None:
        """Before something went wrong the robot stood here: that stays known when it moves on."""
        for number, stood in list(self._stood.items()):
            if number != self._place:
                del self._stood[number]
                if stood.count >= STOOD:
                    self._learn_place(stood)


def solved(normals: Floats, rights: Floats) -> Floats:
    """The moves (..., 2) m of equations (..., 2, 2), (..., 2); 0 where they say nothing."""
    a, b, c = normals[..., 0, 0], normals[..., 0, 1], normals[..., 1, 1]
    u, v = rights[..., 0], rights[..., 1]
    per = 1.0 / np.maximum(a * c - b * b, 1e-9 * (a + c) ** 2 + 1e-30)
    return np.stack([(c * u - b * v) * per, (a * v - b * u) * per], axis=-1)


def across(normals: Floats, moves: Floats) -> Floats:
    """The right sides (..., 2) that moves (..., 2) m give."""
    rights: Floats = (normals @ moves[..., None])[..., 0]
    return rights


def weighed(normals: Floats, rights: Floats) -> Floats:
    """Squares (...), px^2, that each single move explains."""
    squares: Floats = (rights * solved(normals, rights)).sum(axis=-1)
    return squares


def _square(normals: Floats, rights: Floats, usual: Floats) -> float:
    """The mean square of a coordinate, px^2, beyond the ``usual`` moves: every LED's equations expect twice that."""
    return float(weighed(normals, rights - across(normals, usual)).mean() / 2.0)
