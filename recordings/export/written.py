"""What an export has written, for those who ask what became of it."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from asterism.recordings.export.frames import ExportedFrame


@dataclass(slots=True)
class Written:
    """``located`` counts the poses by robot, 0 for one that was never located; ``backwards`` is the first frame whose
    time lies before that of the frame before it, as where a clock was set. ``renamed`` are the ids that the format has
    no place for, with what they are called there.
    """

    frames: int = 0
    located: dict[str, int] = field(default_factory=dict)
    files: list[str] = field(default_factory=list)
    backwards: str | None = None
    renamed: dict[str, str] = field(default_factory=dict)

    def counted(self, frames: Iterable[ExportedFrame]) -> Iterator[ExportedFrame]:
        """The frames, counted as they pass."""
        before = None
        for frame in frames:
            self.frames += 1
            for robot in frame.robots:
                self.located[robot.id] = self.located.get(robot.id, 0) + (robot.position is not None)
            if before is not None and frame.exposed_ns < before and self.backwards is None:
                self.backwards = frame.name
            before = frame.exposed_ns
            yield frame


def counts(poses: int, robots: int, frames: int) -> str:
    """What was written, in words: `2 poses of 1 robot, 2 frames`."""
    named = (("pose", poses), ("robot", robots), ("frame", frames))
    pose, robot, frame = (f"{count} {name}{'s' * (count != 1)}" for name, count in named)
    return f"{pose} of {robot}, {frame}"
