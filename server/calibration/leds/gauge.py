"""What no film of a robot can tell, fixed by convention: where its frame lies, and the scale.

The scale is one measured distance between two LEDs. The frame either fits the positions given at the start best (least
squares), or is held by two named LEDs: the first stays where it was given, the line to the second keeps its direction,
and about that line the plate keeps its tilt.
"""

import math
from dataclasses import dataclass

import numpy as np

from asterism.protocol.geometry import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Gauge:
    """``given`` (6, 3) m are the positions whose frame is kept; ``distance`` is (i, j, m) between two LEDs; ``anchors``
    the two LEDs that hold the frame, None for the best fit.
    """

    given: Floats
    distance: tuple[int, int, float]
    anchors: tuple[int, int] | None = None

    def placed(self, leds: Floats) -> tuple[float, Floats, Floats]:
        """Scale, rotation (3, 3) and shift (3,) that bring LEDs (6, 3) of any frame and size into this gauge."""
        first, second, metres = self.distance
        scale = metres / float(np.linalg.norm(leds[first] - leds[second]))
        if self.anchors is None:
            return scale, *rigid_fit(leds * scale, self.given)
        up = _farthest(self.given, *self.anchors)
        turn = _triad(self.given, *self.anchors, up) @ _triad(leds, *self.anchors, up).T
        return scale, turn, self.given[self.anchors[0]] - turn @ leds[self.anchors[0]] * scale

    def constraints(self, leds: Floats) -> Floats:
        """Changes of the LEDs, row by row, that the gauge forbids (7, 18), at LEDs that are in it."""
        first, second, _ = self.distance
        apart = np.zeros((6, 3))
        apart[first] = (leds[first] - leds[second]) / np.linalg.norm(leds[first] - leds[second])
        apart[second] = -apart[first]
        if self.anchors is None:
            frame = unseen_changes(self.given - self.given.mean(axis=0)).T[:6]
        else:
            frame = _held(leds, *self.anchors)
        return np.vstack([frame, apart.ravel()])

    def frame_sigmas(self, along: float, across: float, normal: Floats) -> tuple[float, float, float]:
        """How far off (one sigma, worst direction) the frame is - m, rad of tilt, rad about the ``normal`` (3,) of
        the plate - when every given position is off by ``along`` m an axis in the plate and ``across`` m out of it.
        """
        if self.anchors is None:
            flat = (self.given - self.given.mean(axis=0)) @ (np.eye(3) - np.outer(normal, normal))
            least, most = np.linalg.eigvalsh(flat.T @ flat)[1:]
            return max(along, across) / math.sqrt(6.0), across / math.sqrt(least), along / math.sqrt(least + most)
        first, second = self.anchors
        length = float(np.linalg.norm(self.given[second] - self.given[first]))
        beside = np.cross(self.given - self.given[first], self.given[second] - self.given[first]) / length
        turn = math.sqrt(2.0) / length
        tilt = max(turn, math.sqrt(2.0 / float((beside**2).sum())))
        return max(along, across), across * tilt, along * turn


def unseen_changes(leds: Floats) -> Floats:
    """Changes (18, 7) of the positions that no view can tell: shifts, turns, scale."""
    x, y, z = leds.T
    zero, one = np.zeros(len(leds)), np.ones(len(leds))
    columns = (
        *((one, zero, zero), (zero, one, zero), (zero, zero, one)),
        *((zero, -z, y), (z, zero, -x), (-y, x, zero)),
        (x, y, z),
    )
    return np.column_stack([np.column_stack(column).ravel() for column in columns])


def rigid_fit(points: Floats, fixed: Floats) -> tuple[Floats, Floats]:
    """Rotation (3, 3) and translation (3,) that bring ``points`` (n, 3) nearest to ``fixed`` (n, 3), least squares.

    Source: Kabsch (1976).
    """
    a, b = points - points.mean(axis=0), fixed - fixed.mean(axis=0)
    u, _, vt = np.linalg.svd(b.T @ a)
    turn: Floats = u * [1.0, 1.0, np.linalg.det(u @ vt)] @ vt
    return turn, fixed.mean(axis=0) - turn @ points.mean(axis=0)


def _triad(leds: Floats, first: int, second: int, up: int) -> Floats:
    """Axes (3, 3), in columns: from the first LED to the second; across that line, the plate's normal; across the line
    in the plate, to the side of the LED ``up``. The plate is the plane through the line that fits all LEDs best.
    """
    along = (leds[second] - leds[first]) / np.linalg.norm(leds[second] - leds[first])
    arms = leds - leds[first]
    across = arms - np.outer(arms @ along, along)
    aside = np.linalg.svd(across)[2][0]
    aside = aside if aside @ across[up] > 0.0 else -aside
    return np.column_stack([along, np.cross(along, aside), aside])


def _farthest(leds: Floats, first: int, second: int) -> int:
    """The LED that is farthest from the line through two."""
    away = np.cross(leds - leds[first], leds[second] - leds[first])
    return int(np.argmax(np.linalg.norm(away, axis=1)))


def _held(leds: Floats, first: int, second: int) -> Floats:
    """The changes (6, 18) that move what the two LEDs hold: the first LED, the line's direction, the slope across."""
    rows = np.zeros((6, 6, 3))
    rows[:3, first] = np.eye(3)
    _, normal, aside = _triad(leds, first, second, _farthest(leds, first, second)).T
    for row, direction in ((3, normal), (4, aside)):
        rows[row, second] = direction
    # Least squares of heights along the normal over the distances from the line.
    weights = (leds - leds[first]) @ aside
    rows[5] = weights[:, None] * normal
    return rows.reshape(6, 18)
