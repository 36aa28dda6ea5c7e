"""asterism export: what a recording tells of its robots, in files that other programs read."""

import argparse
import importlib
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.errors import InputError
from asterism.protocol.rig import Rig
from asterism.recordings.export.csv_files import write_csv
from asterism.recordings.export.frames import ExportedFrame, frames_of, points_of
from asterism.recordings.export.lines import SUFFIX, lines_of
from asterism.recordings.export.parquet_file import write_parquet
from asterism.recordings.export.ros_bag import write_bag
from asterism.recordings.export.tum_files import write_tum
from asterism.recordings.export.written import Written, counts
from asterism.recordings.reader import Recording
from asterism.server.command.exported_truth import write_truth
from asterism.server.command.progress import progress
from asterism.server.command.shared_arguments import BOTH_WAYS, add_out, named
from asterism.server.output import Output, check_file, check_folder, new_file, new_folder
from asterism.server.service.say import say

EXAMPLES = (
    "asterism export RECORDING --to csv -o tables\n"
    "asterism export RECORDING --to tum -o trajectories\n"
    "asterism export RECORDING --to parquet -o poses.parquet\n"
    "asterism export RECORDING --to rosbag2 -o bag\n"
    "asterism export RECORDING --to csv -o tables --smooth both\n"
    "asterism export --from survey.csv --to truth -o truth.jsonl\n"
)

FORMATS = ("csv", "tum", "parquet", "rosbag2")
TRUTH = "truth"
NEEDED = {"parquet": "pyarrow.parquet", "rosbag2": "rosbags.rosbag2"}  # what their extras bring
MOST_NAMED = 5  # files


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    part.add_argument(
        "recording",
        metavar="RECORDING",
        type=named,
        nargs="?",
        help=f"a recording's folder, or JSON lines ({SUFFIX}) of `asterism locate` or `simulate`",
    )
    part.add_argument(
        "--to",
        choices=(*FORMATS, TRUTH),
        required=True,
        help="csv, tum: a file a robot; parquet: one table; rosbag2: an MCAP bag; truth: with --from",
    )
    part.add_argument(
        "--from",
        dest="survey",
        metavar="SURVEY.csv",
        type=named,
        help="a spreadsheet of surveyed poses, into the JSON lines that --truth takes",
    )
    part.add_argument(
        "--smooth",
        choices=(BOTH_WAYS,),
        help="join poses to those before and after by a motion model, with velocities, and label them so",
    )
    part.add_argument("--images", action="store_true", help="into the bag as well, with CameraInfo")
    add_out(part, "OUT", "a new or empty folder (csv, tum, rosbag2) or a file (parquet, truth)")


def run(options: argparse.Namespace) -> int:
    """Write OUT, say what is in it."""
    _check(options)
    if options.survey is not None:
        return write_truth(options.survey, options.out, options.force)
    exported = _read(options.recording, options.images)
    if options.smooth:
        from asterism.server.command.exported_smooth import smoothed_frames

        exported = replace(exported, frames=smoothed_frames(exported.frames, exported.rigs, options.recording))
    with _output(options) as output:
        written = _write(options, exported, output.path)
        _refuse_none(options.recording, written)
    _remark(options.recording, written)
    print(_told(options.out, written) + output.note)
    return 0


@dataclass(frozen=True, slots=True)
class _Exported:
    """What is read: frames, the rigs that were in force, each with its first frame (none of lines), images if asked."""

    frames: Iterator[ExportedFrame]
    rigs: Sequence[tuple[int, Rig]] = ()
    images: Iterator[tuple[NDArray[np.uint8], int, int]] | None = None


def _check(options: argparse.Namespace) -> None:
    """What can be known before the work."""
    if (options.recording is None) == (options.survey is None):
        raise InputError("expected either a RECORDING or --from SURVEY.csv")
    if (options.to == TRUTH) != (options.survey is not None):
        raise InputError(f"--to {options.to}: expected --to {TRUTH} with --from, --to {'|'.join(FORMATS)} without")
    if options.images and options.to != "rosbag2":
        raise InputError(f"--images: {options.to} holds no images, expected --to rosbag2")
    if options.smooth and (options.recording is None or options.recording.suffix == SUFFIX):
        raise InputError("--smooth: only a recording tells what smoothing has to know, expected a recording's folder")
    if options.to == "rosbag2" and options.recording.suffix == SUFFIX:
        raise InputError(f"{options.recording}: lines tell no frames and no rig, expected a recording's folder")
    if options.to == "parquet" and options.out.suffix != ".parquet":
        raise InputError(f"{options.out}: expected a file name ending in .parquet")
    (check_file if options.to in ("parquet", TRUTH) else check_folder)(options.out, options.force)
    if options.to in NEEDED:
        importlib.import_module(NEEDED[options.to])


def _read(path: Path, images: bool) -> _Exported:
    if path.suffix == SUFFIX and path.is_file():
        return _Exported(lines_of(path))
    if path.is_file():
        raise InputError(f"{path}: expected a recording's folder, or JSON lines as a file that ends in {SUFFIX}")
    recording = Recording(path)
    if images and not recording.count_frames():
        raise InputError(f"{path}: holds no images, expected a recording with frames-0001.mcap, or no --images")
    messages = progress(recording.messages(), recording.count_messages(), "exporting")
    return _Exported(frames_of(messages, path), recording.rigs(), recording.frames() if images else None)


def _output(options: argparse.Namespace) -> AbstractContextManager[Output]:
    return (new_file if options.to == "parquet" else new_folder)(options.out, options.force)


def _write(options: argparse.Namespace, exported: _Exported, path: Path) -> Written:
    points = points_of(rig for _, rig in exported.rigs)
    match options.to:
        case "csv":
            return write_csv(exported.frames, path, points)
        case "tum":
            return write_tum(exported.frames, path)
        case "parquet":
            return write_parquet(exported.frames, path, points)
        case _:
            return write_bag(exported.frames, path, options.out.resolve().name, exported.rigs, exported.images)


def _refuse_none(path: Path, written: Written) -> None:
    if not any(written.located.values()):
        raise InputError(
            f"{path}: holds no pose of any robot ({written.frames} frames), nothing to export; expected a recording "
            "in which robots were located"
        )


def _remark(path: Path, written: Written) -> None:
    """What somebody who reads the files should know."""
    if written.backwards is not None:
        say(
            f"{path}: at frame {written.backwards} the time steps back (its clock was set, or a server began anew): "
            "times before and after it are not to be compared, `session` tells them apart"
        )
    for robot, called in written.renamed.items():
        say(
            f"{robot} is /{called} in the bag (ROS takes letters A-Z a-z, digits and underscores); "
            f"its frame is called {robot}"
        )


def _told(out: Path, written: Written) -> str:
    poses = sum(written.located.values())
    never = [robot for robot, count in written.located.items() if not count]
    found = len(written.located) - len(never)
    files = f" in {len(written.files)} files" if len(written.files) > 1 else ""
    told = f"{out}: {counts(poses, found, written.frames)}{files}"
    return told + (f"; never located: {', '.join(never[:MOST_NAMED])}" if never else "")
