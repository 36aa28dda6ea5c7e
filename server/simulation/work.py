"""How simulated robots work: about in their parts, or over them in lanes; and who is lifted off when."""

import math
from dataclasses import dataclass

SPEED = 0.12  # m/s, of the robots


@dataclass(frozen=True, slots=True)
class Lift:
    """A robot is ``height_m`` off the surface from one time to another, s."""

    robot: str
    height_m: float
    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class Work:
    """``lanes_m``: robots go over their parts in lanes that are at most so far apart, all in step."""

    lanes_m: float | None = None
    lift: Lift | None = None

    def lifted(self, robot: str, time_s: float) -> float:
        """How far a robot is off the surface at a time, m."""
        lift = self.lift
        if lift is None or lift.robot != robot or not lift.start_s <= time_s < lift.end_s:
            return 0.0
        return lift.height_m


class Lanes:
    """Lanes over a part of ``size`` (x, y) m, along its longer side, evenly ``apart_m`` or less apart.

    The outer ones are half of that from its border, their ends an eighth. They are driven forth and back at SPEED,
    first from the corner of least x and y. All robots are at the same place of their parts: so parts touch without
    robots that do.
    """

    def __init__(self, size: tuple[float, float], apart_m: float) -> None:
        self._along_y = size[1] > size[0]
        self._across = min(size)
        self.count = max(1, math.ceil(self._across / apart_m))
        self.apart = self._across / self.count
        self._length = max(max(size) - 0.25 * self.apart, 0.0)

    @property
    def once_s(self) -> float:
        """How long it takes to drive them all once."""
        return (self.count * self._length + (self.count - 1) * self.apart) / SPEED

    def at(self, time_s: float) -> tuple[float, float]:
        """Where a robot is at a time, m from its part's middle."""
        way = SPEED * self.once_s
        gone = SPEED * time_s % (2.0 * way) if way > 0.0 else 0.0
        gone = min(gone, 2.0 * way - gone)
        lane = min(int(gone // (self._length + self.apart)), self.count - 1)
        on = gone - lane * (self._length + self.apart)
        there = min(on, self._length) - 0.5 * self._length
        along = there if lane % 2 == 0 else -there
        across = (lane + 0.5) * self.apart + max(on - self._length, 0.0) - 0.5 * self._across
        return (across, along) if self._along_y else (along, across)
