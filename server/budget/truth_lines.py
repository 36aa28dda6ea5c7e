"""Poses that were found before, as JSON lines of `locate` or `fuse`, as sightings beside a truth.

They come without spots: what a rig's camera alone would give is then reckoned for robots that show it all their LEDs.
"""

from pathlib import Path

import numpy as np

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig
from asterism.recordings.export.frames import ExportedFrame, ExportedRobot
from asterism.recordings.export.lines import SUFFIX, lines_of
from asterism.server.calibration.leds.observations import LedCentres, Sighting
from asterism.server.calibration.survey.survey import Survey, SurveyedFrame, match_frames
from asterism.server.pose.fit import LEDS


def is_lines(name: str) -> bool:
    """Whether a source is a file of lines."""
    return name.endswith(SUFFIX) and Path(name).is_file()


def sightings_of_lines(path: Path, rig: Rig) -> list[tuple[str, int, list[Sighting]]]:
    """Every line's frame and time, ns, with its robots as the ``rig``'s camera would see them.

    Raises InputError for a file that holds no such lines, or tells no covariance of a pose.
    """
    T_camera_parent = (rig.T_world_camera or Pose.identity()).inverse()
    known = {robot.id for robot in rig.robots}
    seen = []
    for frame in lines_of(path):
        located = [robot for robot in frame.robots if robot.pose is not None and robot.id in known]
        seen.append((frame.name, frame.exposed_ns, [_sighting(each, frame, T_camera_parent, path) for each in located]))
    return seen


def match_lines(
    survey: Survey, seen: list[tuple[str, int, list[Sighting]]], source: str
) -> tuple[list[tuple[str, list[Sighting]]], dict[str, SurveyedFrame], tuple[str, ...]]:
    """Lines beside a survey's, by their times where the survey tells them, else by the frames' names: what was seen and
    the truth under common names, and remarks. Raises InputError where nothing matches.
    """
    by_time = {frame.exposed_ns: frame for frame in survey.frames if frame.exposed_ns is not None}
    if not by_time:
        matched = match_frames(survey, [name for name, _, _ in seen], source)
        return [(name, sightings) for name, _, sightings in seen], matched.frames, matched.remarks
    truth = {str(time_ns): by_time[time_ns] for _, time_ns, _ in seen if time_ns in by_time}
    if not truth:
        raise InputError(
            f"{survey.name}: none of its lines is of an exposed_ns that {source} has, expected the same times"
        )
    without = len(seen) - len(truth)
    remarks = (f"{source}: {without} of {len(seen)} lines are of a time that {survey.name} does not tell; left out",)
    return (
        [(str(time_ns), sightings) for _, time_ns, sightings in seen],
        truth,
        (*survey.remarks, *remarks[: without > 0]),
    )


def _sighting(robot: ExportedRobot, frame: ExportedFrame, T_camera_parent: Pose, path: Path) -> Sighting:
    if robot.covariance is None:
        raise InputError(
            f"{path}: line {frame.sequence}: {robot.id}: tells no covariance, expected one, as locate and fuse write it"
        )
    assert robot.pose is not None
    turn = np.kron(np.eye(2), T_camera_parent.rotation)
    covariance: Floats = turn @ np.reshape(robot.covariance, (6, 6)) @ turn.T
    other = robot.alternative
    return Sighting(
        frame.name,
        frame.sequence,
        robot.id,
        LedCentres(np.zeros((LEDS, 2)), np.full((LEDS, 2, 2), np.nan)),
        T_camera_parent @ robot.pose,
        covariance,
        None if other is None else T_camera_parent @ Pose(np.array(other.position), np.array(other.orientation)),
    )
