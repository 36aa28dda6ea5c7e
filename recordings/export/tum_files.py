"""TUM: a trajectory as text, one file a robot: what evo and others of its kind compare.

The format is that of J. Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems" (IROS 2012): a line
a pose, `timestamp tx ty tz qx qy qz qw`, s and m, comments behind #.
"""

from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path
from typing import TextIO

from asterism.recordings.export.columns import seconds
from asterism.recordings.export.frames import ExportedFrame
from asterism.recordings.export.written import Written


def write_tum(frames: Iterable[ExportedFrame], folder: Path) -> Written:
    """Write <folder>/<robot>.tum of every robot that was located, of the frames in which it was.

    A file holds poses in one frame: where the parent frame changes, since another rig was in force, what follows goes
    into <robot>.<frame>.tum. Raises OSError where the disk does not take it.
    """
    written, files = Written(), _Files(folder)
    with files.open:
        for frame in written.counted(frames):
            for robot in frame.robots:
                if robot.position is not None and robot.orientation is not None:
                    numbers = " ".join(map(repr, (*robot.position, *robot.orientation)))
                    files.of(robot.id, frame.frame_id).write(f"{seconds(frame.exposed_ns)} {numbers}\n")
    written.files = sorted(files.names)
    return written


class _Files:
    """The files, by robot and parent frame; each is begun with its comments when it is asked for."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.open = ExitStack()
        self._files: dict[tuple[str, str], TextIO] = {}
        self.names: set[str] = set()

    def of(self, robot: str, frame_id: str) -> TextIO:
        """The file of a robot's poses in a frame."""
        key = (robot, frame_id)
        if key not in self._files:
            name = robot
            while f"{name}.tum" in self.names:
                name = f"{name}.{frame_id}"
            name = f"{name}.tum"
            self.names.add(name)
            file = self.open.enter_context((self._folder / name).open("w", encoding="utf-8", newline="\n"))
            file.write(_comments(robot, frame_id))
            self._files[key] = file
        return self._files[key]


def _comments(robot: str, frame_id: str) -> str:
    parent = frame_id or "the frame of the lines it was made of"
    return (
        f"# pose of {robot} in {parent}: m, quaternion; timestamp: mid-exposure, s since the Unix epoch\n"
        "# timestamp tx ty tz qx qy qz qw\n"
    )
