"""Surveyed truth: where robots really were, as JSON lines in the format that `asterism locate` writes.

One line a frame: ``{"frame": "00012.png", "robots": [{"id": "alpha", "position": [x, y, z], "orientation": [x, y, z,
w]}]}``. A pose is T_world_robot where the rig places its camera in a world and T_camera_robot where it does not (for
`calibrate world` always T_world_robot). What else locate, fuse and simulate write is accepted and not looked at.

A file whose name ends in `.csv` is a spreadsheet's, as `survey_csv` says.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.text_file import read_text
from asterism.protocol.yaml_file import Section, describe
from asterism.server.calibration.survey.survey_csv import SUFFIX as CSV
from asterism.server.calibration.survey.survey_csv import SurveyRows, read_survey_csv

LONGEST = 256 << 20  # bytes of a survey
_LINE_KEYS = ("frame", "robots", "exposed_ns", "lost", "left_out")
_ROBOT_KEYS = (
    *("id", "position", "orientation"),
    *(
        "state",
        "covariance",
        "leds",
        "rms_px",
        "alternative",
        "visible",
        "extrapolated",
        "smoothed",
        "filter",
        "velocity",
        "cameras",
    ),
)


@dataclass(frozen=True, slots=True, eq=False)
class SurveyedPose:
    """Where a robot was: ``position`` (3,) m, ``orientation`` (4,) x y z w or None where it was not surveyed."""

    robot: str
    position: Floats
    orientation: Floats | None

    @property
    def pose(self) -> Pose:
        """The pose; the orientation must be there."""
        assert self.orientation is not None
        return Pose(self.position, self.orientation)


@dataclass(frozen=True, slots=True, eq=False)
class SurveyedFrame:
    """One line of a survey; ``exposed_ns`` is None where it tells no time of its own."""

    name: str
    line: int
    robots: dict[str, SurveyedPose]
    exposed_ns: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """A survey's frames in the file's order; ``remarks`` are what a person should know of how it was read."""

    name: str
    frames: tuple[SurveyedFrame, ...]
    remarks: tuple[str, ...] = ()


def read_survey(path: Path, robots: Collection[str], orientations: bool = True) -> Survey:
    """The survey in a file; ``robots`` are the rig's. With ``orientations`` every pose must have one.

    Raises InputError with file, line, what was found and what is accepted.
    """
    if path.suffix.lower() == CSV:
        return _of_rows(path, read_survey_csv(path), robots, orientations)
    text = read_text(path, "JSON lines as asterism locate writes them", LONGEST)
    frames: list[SurveyedFrame] = []
    lines: dict[str, int] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip():
            continue
        frame = _frame(line, f"{path}: line {number}", number, robots, orientations)
        if frame.name in lines:
            raise InputError(
                f"{path}: line {number}: frame {frame.name!r} is in line {lines[frame.name]} already, expected once"
            )
        lines[frame.name] = number
        frames.append(frame)
    if not any(frame.robots for frame in frames):
        raise InputError(f"{path}: holds no surveyed robot, expected JSON lines as asterism locate writes them")
    return Survey(str(path), tuple(frames))


def _of_rows(path: Path, read: SurveyRows, robots: Collection[str], orientations: bool) -> Survey:
    frames: dict[str, SurveyedFrame] = {}
    for row in read.rows:
        where = f"{path}: line {row.line}"
        if row.robot not in robots:
            raise InputError(f"{where}: {describe(row.robot)} is not in the rig, expected one of {', '.join(robots)}")
        if orientations and row.orientation is None:
            raise InputError(f"{where}: tells no orientation, expected qx, qy, qz, qw or roll_deg, pitch_deg, yaw_deg")
        frame = frames.setdefault(row.frame, SurveyedFrame(row.frame, row.line, {}))
        frame.robots[row.robot] = SurveyedPose(row.robot, row.position, row.orientation)
    return Survey(str(path), tuple(frames.values()), read.remarks)


def _frame(line: str, where: str, number: int, robots: Collection[str], orientations: bool) -> SurveyedFrame:
    try:
        values = msgspec.json.decode(line)
    except (msgspec.DecodeError, RecursionError) as error:
        raise InputError(
            f"{where}: is no JSON ({error}), expected one JSON object a line as asterism locate writes them"
        ) from None
    if not isinstance(values, dict):
        raise InputError(f"{where}: {describe(values)}, expected one JSON object a line as asterism locate writes them")
    section = Section(values, where, "")
    section.only(_LINE_KEYS)
    name = section.text("frame")
    listed = section.values.get("robots")
    if not isinstance(listed, list):
        raise section.error("robots", f"{describe(listed)}, expected a list of robots")
    found: dict[str, SurveyedPose] = {}
    for index, entry in enumerate(listed):
        part = Section(entry, where, f"robots[{index}]")
        part.only(_ROBOT_KEYS)
        robot = part.text("id")
        if robot not in robots:
            raise part.error("id", f"{robot!r} is not in the rig, expected one of {', '.join(robots)}")
        if robot in found:
            raise part.error("id", f"{robot!r} is given twice, expected once")
        position = np.array(part.numbers("position", 3, "x, y, z of the robot, m"))
        orientation = None
        if orientations or "orientation" in part:
            orientation = np.array(part.numbers("orientation", 4, "the quaternion x, y, z, w"))
            length = float(np.linalg.norm(orientation))
            if abs(length - 1.0) > 1e-3:
                raise part.error("orientation", f"a quaternion of length {length:g}, expected x, y, z, w of length 1")
        found[robot] = SurveyedPose(robot, position, orientation)
    exposed_ns = section.integer("exposed_ns", 0, (1 << 63) - 1) if "exposed_ns" in section else None
    return SurveyedFrame(name, number, found, exposed_ns)


@dataclass(frozen=True, slots=True, eq=False)
class Matched:
    """A survey's frames by the names of a source's frames; ``remarks`` say what has no counterpart."""

    frames: dict[str, SurveyedFrame]
    remarks: tuple[str, ...]


def match_frames(survey: Survey, names: Sequence[str], source: str) -> Matched:
    """Which line of the survey belongs to which frame of a source: by name; where the survey shares no name with the
    source but is as long, by order, which is said.

    Raises InputError where nothing matches.
    """
    by_name = {frame.name: frame for frame in survey.frames}
    matched = {name: by_name[name] for name in names if name in by_name}
    if matched:
        remarks = [*survey.remarks]
        without = [frame.name for frame in survey.frames if frame.name not in matched]
        if without:
            remarks.append(f"{survey.name}: {_listed(without)} not among the frames of {source}; left out")
        unsurveyed = [name for name in names if name not in by_name]
        if unsurveyed:
            remarks.append(f"{source}: {_listed(unsurveyed)} not in {survey.name}; left out")
        return Matched(matched, tuple(remarks))
    if len(names) == len(survey.frames):
        return Matched(
            dict(zip(names, survey.frames, strict=True)),
            (
                *survey.remarks,
                f"{survey.name} names none of the frames of {source}; its lines are taken in the frames' order",
            ),
        )
    raise InputError(
        f"{survey.name}: names none of the frames of {source} (it has {survey.frames[0].name!r}, the source "
        f"{names[0] if names else 'no frame'!r}), expected the same names, or as many lines as frames "
        f"({len(survey.frames)} lines, {len(names)} frames)"
    )


def _listed(names: list[str]) -> str:
    shown = ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")
    return f"frame {shown} is" if len(names) == 1 else f"{len(names)} frames ({shown}) are"
