"""How far a robot turned in a film, and which direction of it kept still: along that a point stays open."""

from typing import NamedTuple

import numpy as np

from asterism.protocol.geometry import Floats

AXES = "xyz"
NEARLY = 0.97  # cosine from which on a direction is called that of an axis


class Turning(NamedTuple):
    """RMS angle, rad, by which the robot's directions turned from their mean: ``most`` that of any, ``least`` that of
    the unit vector ``still`` (3,), robot's frame, which turned least. Turned about one axis, it is ``still``.
    """

    most: float
    least: float
    still: Floats


def turning_of(rotations: Floats) -> Turning:
    """Of rotations (n, 3, 3). A direction u, turned to R u, is from the mean of these by u'(1 - M'M)u on average
    squared, M the mean of the rotations.
    """
    mean = rotations.mean(axis=0)
    values, vectors = np.linalg.eigh(np.eye(3) - mean.T @ mean)
    # About one axis by the angle a, two directions turn by it; about two by a and b, the three by a, b and both.
    spreads = np.arcsin(np.sqrt(np.clip(values, 0.0, 1.0)))
    return Turning(float(spreads[1]), float(spreads[0]), vectors[:, 0])


def direction_text(direction: Floats) -> str:
    """A unit vector of the robot's frame in words."""
    largest = int(np.abs(direction).argmax())
    if abs(direction[largest]) > NEARLY:
        return f"its {AXES[largest]}"
    upright = direction * np.sign(direction[largest])
    return f"its direction [{', '.join(f'{value:.2f}' for value in upright)}]"
