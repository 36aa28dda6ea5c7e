"""The film of a robot that rests with a point at one place: its spots frame by frame, and both tilts of each pose."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.protocol.rig import Rig, Robot
from asterism.server.calibration.leds.observations import Sighting
from asterism.server.pose.fit import LEDS
from asterism.server.pose.led_doubt import own_scatter
from asterism.server.pose.lens import lens_of
from asterism.server.pose.matched import LEAST_SIGMA_PX
from asterism.server.pose.spot_shift import OPTICS, optics_of, spots_at

NUMBERS = 2 * LEDS


class Views(NamedTuple):
    """n frames. ``spots`` (n, 12) px, 0 where not seen; ``noise`` (n, 6, 2, 2) px^2; ``seen`` (n, 6).

    ``rotations`` (n, 2, 3, 3) and ``ts`` (n, 2, 3) m are T_camera_robot by both tilts, twice the same where there is no
    doubt; ``covariances`` (n, 6, 6) of the first, m and rad about the camera's axes.
    """

    spots: Floats
    noise: Floats
    seen: NDArray[np.bool_]
    rotations: Floats
    ts: Floats
    covariances: Floats

    def of(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> "Views":
        """Some of the frames."""
        return Views(
            self.spots[rows], self.noise[rows], self.seen[rows], self.rotations[rows], self.ts[rows],
            self.covariances[rows],
        )  # fmt: skip


def views_of(robot: Robot, sightings: Sequence[Sighting], bias_px: float) -> Views:
    """The sightings of one robot; ``bias_px`` is what a centre is off beside its noise, anew in every frame."""
    centres = np.array([s.centres.centres_px for s in sightings])
    seen = np.isfinite(centres[..., 0])
    noise = np.array([s.centres.covariances_px2 for s in sightings]) + (LEAST_SIGMA_PX**2 + bias_px**2) * np.eye(2)
    scatter = np.array([own_scatter(robot.led_offset, s.centres.strange_px) for s in sightings])
    noise += scatter[..., None, None] * np.eye(2)
    tilts = [(s.pose, s.alternative or s.pose) for s in sightings]
    return Views(
        np.where(seen[..., None], centres, 0.0).reshape(-1, NUMBERS),
        np.where(seen[..., None, None], noise, np.eye(2)),
        seen,
        np.array([[pose.rotation for pose in both] for both in tilts]),
        np.array([[pose.position for pose in both] for both in tilts]),
        np.array([s.covariance for s in sightings]),
    )


def spots_of(rig: Rig, robot: Robot, leds: Floats, rotations: Floats, ts: Floats) -> Floats:
    """Where the spots (n, 12) px of a robot lie at poses T_camera_robot, (n, 3, 3) and (n, 3) m, when its LEDs are at
    ``leds`` (6, 3) m.
    """
    n, plane = len(ts), robot.T_robot_plane
    layouts, optics, pixels = np.empty((n, LEDS, 3)), np.empty((n, OPTICS)), np.empty((n, LEDS, 2))
    layouts[:], optics[:] = plane.inverse().map(leds), optics_of(robot)
    spots_at(lens_of(rig.camera), layouts, optics, rotations @ plane.rotation, ts + rotations @ plane.position, pixels)
    return pixels.reshape(n, NUMBERS)


def information_of(noise: Floats, seen: NDArray[np.bool_], beyond: float) -> Floats:
    """Inverse covariances (n, 12, 12) px^-2 of frames' spots, of which each has the variance ``beyond`` more."""
    inverse = np.linalg.inv(noise + beyond * np.eye(2)) * seen[..., None, None]
    whole = np.zeros((len(noise), LEDS, 2, LEDS, 2))
    for led in range(LEDS):
        whole[:, led, :, led] = inverse[:, led]
    return whole.reshape(-1, NUMBERS, NUMBERS)
