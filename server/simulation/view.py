"""How far from its axis a camera sees."""

import numpy as np

from asterism.protocol.camera import Camera

SPOKES, STEPS = 32, 400
FARTHEST = 50.0  # tangent of an angle to the axis


def reach_of(camera: Camera) -> float:
    """The tangent of the angle to the axis beyond which nothing is in the image.

    A lens's polynomial may turn back beyond it and bring what is far outside into the image again, where no light goes.
    """
    tangents = np.geomspace(0.01, FARTHEST, STEPS)
    angles = np.linspace(0.0, 2.0 * np.pi, SPOKES, endpoint=False)
    x, y = tangents * np.cos(angles)[:, None], tangents * np.sin(angles)[:, None]
    pixels = camera.project(np.stack([x, y, np.ones_like(x)], axis=-1))
    last = np.array([camera.width, camera.height]) - 0.5
    inside = np.logical_and.reduce((pixels >= -0.5) & (pixels <= last), axis=-1)
    first = np.where(np.logical_and.reduce(inside, axis=1), STEPS - 1, inside.argmin(axis=1))
    return float(tangents[first].max())
