"""How robots move in moments: windows of a few frames in which place and turn are polynomials of the time.

Of three frames, polynomials of degree 2 say no more than three poses would; so cameras that expose together lose
nothing by it, and of those that do not, each is asked where the robot was when it exposed itself.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.pose.place import turning

DEGREE = 2
UNKNOWNS = 6 * (DEGREE + 1)  # places, then turns, by power of the time


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Of g moments: with s = (time - ``middles_s``) / ``halves_s``, (g,) each, the robot is at the sum of
    ``places`` (g, 3, 3) m times s^k, and turned by exp(sum of ``turns`` (g, 2, 3) times s^(k + 1)) after ``rotations``
    (g, 3, 3). Powers above ``degrees`` (g,) are none.
    """

    middles_s: Floats
    halves_s: Floats
    degrees: NDArray[np.int64]
    places: Floats
    rotations: Floats
    turns: Floats

    def used(self) -> NDArray[np.bool_]:
        """(g, 18): which unknowns there are."""
        powers = np.repeat(np.arange(DEGREE + 1), 3)
        return np.asarray(np.tile(powers, 2) <= self.degrees[:, None])

    def at(self, times_s: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """At times (g, n): the shares of a moment s (g, n), places (g, n, 3), rotations (g, n, 3, 3) and the rotation
        vectors (g, n, 3) that lead there from ``rotations``.
        """
        s = (times_s - self.middles_s[:, None]) / self.halves_s[:, None]
        powers = s[..., None] ** np.arange(DEGREE + 1)
        places = np.einsum("gnk,gki->gni", powers, self.places)
        vectors = np.einsum("gnk,gki->gni", powers[..., 1:], self.turns)
        return s, places, exp_rotations(vectors) @ self.rotations[:, None], vectors

    def moved(self, moves: Floats) -> "Motion":
        """Changed by (g, 18): places by power; a rotation before the turns, and these by power."""
        by_power = moves.reshape(len(moves), 2, DEGREE + 1, 3)
        return replace(
            self,
            places=self.places + by_power[:, 0],
            rotations=exp_rotations(by_power[:, 1, 0]) @ self.rotations,
            turns=self.turns + by_power[:, 1, 1:],
        )

    def derivatives(self, s: Floats, arms: Floats, vectors: Floats) -> tuple[Floats, Floats]:
        """Of points of the robot, ``arms`` (g, n, 3) from its origin, at ``s`` (g, n) and ``vectors`` (g, n, 3) of
        `at`: by the unknowns (g, n, 3, 18), and by the time (g, n, 3), 1/s.
        """
        by = np.zeros((*arms.shape, UNKNOWNS))
        by_turn = turning(arms)
        left = by_turn @ _left_jacobian(vectors)
        place_rate, turn_rate = np.zeros(arms.shape), np.zeros(arms.shape)
        for k in range(DEGREE + 1):
            power = (s**k)[..., None, None]
            by[..., 3 * k : 3 * k + 3] = power * np.eye(3)
            first = 3 * (DEGREE + 1 + k)
            by[..., first : first + 3] = power * left if k else by_turn @ exp_rotations(vectors)
            if k:
                rate = (k * s ** (k - 1) / self.halves_s[:, None])[..., None]
                place_rate += rate * self.places[:, None, k]
                turn_rate += rate * self.turns[:, None, k - 1]
        return by, place_rate + (left @ turn_rate[..., None])[..., 0]


def exp_rotations(vectors: Floats) -> Floats:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3) (Rodrigues)."""
    angles2 = (vectors**2).sum(axis=-1)[..., None, None]
    angles = np.sqrt(np.maximum(angles2, 1e-24))
    hats = -turning(vectors)
    turned: Floats = np.eye(3) + np.sin(angles) / angles * hats + (1.0 - np.cos(angles)) / angles**2 * (hats @ hats)
    return turned


def _left_jacobian(vectors: Floats) -> Floats:
    """d exp(v) = exp(J dv) exp(v), of small v: to the third order."""
    hats = -turning(vectors)
    jacobian: Floats = np.eye(3) + hats / 2.0 + hats @ hats / 6.0 + hats @ hats @ hats / 24.0
    return jacobian
