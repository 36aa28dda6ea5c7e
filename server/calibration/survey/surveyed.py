"""Robots seen at surveyed poses: which survey belongs to which sighting, and whether it can be meant."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose, angle_between
from asterism.protocol.rig import Rig
from asterism.server.calibration.leds.observations import Sighting
from asterism.server.calibration.survey.survey import Survey, SurveyedPose, match_frames

FAR_M = 0.1  # a survey that is off by more (median) is not meant so
FAR_DEG = 10.0
UNITS = {"mm": 1e-3, "cm": 1e-2}
NARROWEST = 0.05  # of the places' spread along their line: how far they must spread across it

Pairs = list[tuple[Sighting, SurveyedPose]]


@dataclass(frozen=True, slots=True, eq=False)
class Paired:
    """Sightings with their surveyed poses, the frames' order kept; ``remarks`` say what has no counterpart."""

    pairs: Pairs
    remarks: tuple[str, ...]


def pair(survey: Survey, seen: Sequence[tuple[str, Sequence[Sighting]]], source: str) -> Paired:
    """Match ``seen`` (frame name, sightings) to the survey. Raises InputError where no frame matches."""
    matched = match_frames(survey, [name for name, _ in seen], source)
    remarks = list(matched.remarks)
    pairs: Pairs = []
    missing = 0
    for name, sightings in seen:
        line = matched.frames.get(name)
        if line is None:
            continue
        here = [(s, line.robots[s.robot]) for s in sightings if s.robot in line.robots]
        missing += len(line.robots) - len(here)
        pairs += here
    if missing:
        remarks.append(f"{missing} surveyed poses belong to robots that were not located in their frame; left out")
    return Paired(pairs, tuple(remarks))


def true_poses(pairs: Pairs, rig: Rig) -> list[Pose]:
    """The surveyed poses as T_camera_robot."""
    T_camera_parent = (rig.T_world_camera or Pose.identity()).inverse()
    return [T_camera_parent @ surveyed.pose for _, surveyed in pairs]


def check_survey(pairs: Pairs, rig: Rig, survey: str, fewest: int) -> None:
    """Raise InputError where there are fewer than ``fewest`` pairs, or the survey is far from what was seen: another
    unit, another frame, another order of the quaternion, with the likeliest of these said.
    """
    if len(pairs) < fewest:
        raise InputError(
            f"{survey}: {len(pairs)} of its poses belong to robots that were located in their frames, expected at "
            f"least {fewest}"
        )
    parent = rig.parent_frame if rig.T_world_camera is not None else "camera"
    T_parent_camera = rig.T_world_camera or Pose.identity()
    told = np.array([surveyed.position for _, surveyed in pairs])
    seen = [T_parent_camera @ sighting.pose for sighting, _ in pairs]
    places = np.array([pose.position for pose in seen])
    away = _median_distance(told, places)
    if away > FAR_M:
        hint = f"are they T_{parent}_robot of these frames and this rig?"
        for unit, metres in UNITS.items():
            if _median_distance(told * metres, places) < FAR_M:
                hint = f"is that {unit}?"
        if rig.T_world_camera is not None:
            camera = np.array([sighting.pose.position for sighting, _ in pairs])
            if _median_distance(told, camera) < FAR_M:
                hint = "are they T_camera_robot? This rig places its camera in the world"
        raise InputError(
            f"{survey}: the surveyed places are {away:.3g} m (median) from where the robots are seen, expected "
            f"T_{parent}_robot in m, within {FAR_M:g} m; {hint}"
        )
    turned = np.degrees(
        np.median([angle_between(s.pose.rotation, p.rotation) for (_, s), p in zip(pairs, seen, strict=True)])
    )
    if turned > FAR_DEG:
        hint = "are these the same frames?"
        swapped = [Pose(np.zeros(3), np.roll(surveyed.pose.orientation, -1)) for _, surveyed in pairs]
        if (
            np.degrees(np.median([angle_between(s.rotation, p.rotation) for s, p in zip(swapped, seen, strict=True)]))
            < FAR_DEG
        ):
            hint = "is that w x y z?"
        raise InputError(
            f"{survey}: the surveyed orientations are {turned:.0f} degrees (median) from those seen, expected "
            f"quaternions x, y, z, w of T_{parent}_robot, within {FAR_DEG:g} degrees; {hint}"
        )


def check_spread(pairs: Pairs, survey: str) -> None:
    """Raise InputError where the surveyed places are one, or lie on one line."""
    places = np.array([surveyed.position for _, surveyed in pairs])
    lengths = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    if lengths[1] <= NARROWEST * lengths[0] or lengths[0] < 1e-3:
        raise InputError(
            f"{survey}: the surveyed places lie on one line (or in one point), expected places spread over the "
            "workspace, at several distances from the camera"
        )


def _median_distance(a: Floats, b: Floats) -> float:
    return float(np.median(np.linalg.norm(a - b, axis=1)))
