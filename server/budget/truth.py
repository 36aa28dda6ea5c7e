"""Measured beside predicted: the chain's poses against surveyed ones, with the budget at the very same poses."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose, angle_between, log_rotation
from asterism.protocol.rig import Rig
from asterism.server.budget.budget import Light, Poses, covariances_of
from asterism.server.budget.uncertainty import Uncertainty
from asterism.server.calibration.leds.observations import Sighting
from asterism.server.calibration.survey.survey import SurveyedFrame
from asterism.server.centres.centre_noise import centre_covariances
from asterism.server.simulation.simulate import DEFAULT_LED_RADIUS

FLIPPED_RAD = np.radians(5.0)  # off by more, and nearer to the other tilt: the wrong one of two was chosen
MOST_BINS = 5
LEAST_IN_BIN = 10  # sightings


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """m sightings of surveyed robots: ``distances`` (m,) along the optical axis, m; ``errors`` (m, 6), m and rad about
    the camera's axes; ``predicted`` (m, sources, 6, 6) by source and ``told`` (m, 6, 6), the chain's own covariances.

    ``flips`` more were seen with the wrong one of both tilts, ``lost`` not at all.
    ``by_light`` (k, 6): errors by light alone of those sightings that rest on the surface too.
    """

    distances: Floats
    errors: Floats
    predicted: Floats
    told: Floats
    flips: int
    lost: int
    by_light: Floats = field(default_factory=lambda: np.zeros((0, 6)))

    @property
    def nees(self) -> tuple[float, float]:
        """Squared error weighted by the whole budget's covariance, and by the chain's own; 6 on average is honest."""
        return _nees(self.errors, self.predicted.sum(axis=1)), _nees(self.errors, self.told)


@dataclass(frozen=True, slots=True, eq=False)
class Bin:
    """Sightings between two distances: how many, their mean distance m, RMS errors (6,) measured and predicted."""

    count: int
    distance: float
    measured: Floats
    predicted: Floats


def light_of(rig: Rig, light: Light, sightings: Iterable[Sighting]) -> Light:
    """The light of a film: the variance of centres that its own frames tell, in place of the assumed."""
    ratios = []
    for sighting in sightings:
        robot = rig.robot(sighting.robot)
        points = sighting.pose.map(robot.leds)
        normals = np.tile(sighting.pose.rotation @ robot.T_robot_plane.rotation[:, 2], (len(points), 1))
        radius = robot.led_radius or DEFAULT_LED_RADIUS
        noise, rounding = centre_covariances(points, normals, radius, rig.camera.focal_px, light.look)
        bound = noise + rounding
        told = sighting.centres.covariances_px2
        there = np.isfinite(told[:, 0, 0])
        ratios += (np.trace(told[there], axis1=1, axis2=2) / np.trace(bound[there], axis1=1, axis2=2)).tolist()
    return replace(light, factor=float(np.median(ratios)), measured=True) if ratios else light


def compare(
    rig: Rig, seen: list[tuple[str, list[Sighting]]], truth: dict[str, SurveyedFrame], uncertainty: Uncertainty,
    light: Light,
) -> Compared:  # fmt: skip
    """Every sighting of a surveyed robot beside its truth. ``seen`` names a frame and who was found in it.

    Raises InputError where no surveyed robot was found.
    """
    T_camera_parent = (rig.T_world_camera or Pose.identity()).inverse()
    pairs: list[tuple[Sighting, Pose]] = []
    flips = lost = 0
    for name, sightings in seen:
        found = {sighting.robot: sighting for sighting in sightings}
        for robot_id, surveyed in truth[name].robots.items() if name in truth else ():
            if robot_id not in found:
                lost += 1
                continue
            true, sighting = T_camera_parent @ surveyed.pose, found[robot_id]
            off = angle_between(true.rotation, sighting.pose.rotation)
            other = sighting.alternative
            if off > FLIPPED_RAD and other is not None and angle_between(true.rotation, other.rotation) < off:
                flips += 1
                continue
            pairs.append((sighting, true))
    if not pairs:
        raise InputError(
            f"none of the surveyed robots was found where it was surveyed ({lost} lost, {flips} with the wrong tilt), "
            "expected frames that show them"
        )
    predicted = np.empty((len(pairs), 0))
    for robot in rig.robots:
        mine = [k for k, (sighting, _) in enumerate(pairs) if sighting.robot == robot.id]
        if not mine:
            continue
        poses = Poses(np.array([pairs[k][1].rotation for k in mine]), np.array([pairs[k][1].position for k in mine]))
        visible = np.array([np.isfinite(pairs[k][0].centres.centres_px[:, 0]) for k in mine]).astype(float)
        share = covariances_of(rig, robot, poses, uncertainty, light, visible)
        if not predicted.size:
            predicted = np.empty((len(pairs), *share.shape[1:]))
        predicted[mine] = share
    return Compared(
        np.array([true.position[2] for _, true in pairs]),
        np.array([_error(sighting.pose, true) for sighting, true in pairs]),
        predicted,
        np.array([sighting.covariance for sighting, _ in pairs]),
        flips,
        lost,
        np.array([_error(s.without, true) for s, true in pairs if s.without is not None]).reshape(-1, 6),
    )


def _error(pose: Pose, true: Pose) -> Floats:
    """(6,) m and rad about the camera's axes."""
    return np.concatenate([pose.position - true.position, log_rotation(pose.rotation @ true.rotation.T)])


def bins_of(compared: Compared) -> list[Bin]:
    """The sightings by distance, as many in each bin, at most MOST_BINS and at least LEAST_IN_BIN in each."""
    n = len(compared.distances)
    order = np.argsort(compared.distances, kind="stable")
    bins = []
    for rows in np.array_split(order, max(1, min(MOST_BINS, n // LEAST_IN_BIN))):
        variances = np.diagonal(compared.predicted[rows].sum(axis=1), axis1=1, axis2=2)
        bins.append(
            Bin(
                len(rows),
                float(compared.distances[rows].mean()),
                np.sqrt(np.square(compared.errors[rows]).mean(axis=0)),
                np.sqrt(variances.mean(axis=0)),
            )
        )
    return bins


def _nees(errors: Floats, covariances: Floats) -> float:
    return float(np.einsum("ni,ni->n", errors, np.linalg.solve(covariances, errors[..., None])[..., 0]).mean())
