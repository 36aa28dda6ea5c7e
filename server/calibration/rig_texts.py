"""What a calibration writes of a rig: its text with other values, and a file of its robots where it names one.

A file of robots may be several rigs': it is never changed. What is new goes into a file of its own beside the new rig,
which names it; the others go on as they are until they name it too.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

from asterism.protocol.rig import Rig, parse_rig
from asterism.server.calibration.result_file import check_result_file, write_result_file
from asterism.server.calibration.rewrite import Value, annotate, relocate, relocate_robots, rewrite

ROBOTS = "robots"


def robots_path(out: Path) -> Path:
    """The file of robots that goes with a new rig, where the rig it is made from names one."""
    return out.with_name(f"{out.stem}-{ROBOTS}.yaml")


def check_rig_files(rig: Rig, out: Path, force: bool) -> None:
    """Refuse, before any work is done, to replace a new rig's files unasked. Raises InputError."""
    check_result_file(out, force)
    if rig.robots_name:
        check_result_file(robots_path(out), force)


@dataclass(frozen=True, slots=True)
class RigTexts:
    """The ``text`` of a ``rig`` that was read from ``path``, and that of its ``robots`` where it names a file of them,
    both on their way to something new.
    """

    rig: Rig
    path: Path
    text: str
    robots: str

    @staticmethod
    def of(rig: Rig, path: str | Path) -> "RigTexts":
        """As they are."""
        return RigTexts(rig, Path(path), rig.rig_text, rig.files.get(rig.robots_name, ""))

    def rewritten(self, changes: Mapping[tuple[str, ...], Value]) -> "RigTexts":
        """With other values at paths as `rewrite` takes them, `robots` first of a robot's. Raises InputError as it
        does.
        """
        there = {path[1:]: value for path, value in changes.items() if self._is_there(path)}
        here = {path: value for path, value in changes.items() if not self._is_there(path)}
        return replace(
            self,
            text=rewrite(self.text, here, str(self.path)),
            robots=rewrite(self.robots, there, self._robots_name) if there else self.robots,
        )

    def annotated(self, path: tuple[str, ...], tag: str, comments: Sequence[str]) -> "RigTexts":
        """With comments above the key at that path, as `annotate` sets them."""
        if self._is_there(path):
            return replace(self, robots=annotate(self.robots, path[1:], tag, comments))
        return replace(self, text=annotate(self.text, path, tag, comments))

    def check(self, camera_text: str, out: Path) -> None:
        """Raises InputError where that is no rig."""
        files = {**self.rig.files, **({self.rig.robots_name: self.robots} if self.rig.robots_name else {})}
        parse_rig(self.text, camera_text, str(out), self.rig.offset_texts, files)

    def write(self, out: Path, force: bool, camera: Path | None = None) -> list[tuple[Path, Path | None]]:
        """Write the new rig, which names a new ``camera`` beside it if one is given, and its robots where they are in a
        file and changed: what was written, and where what was there before is kept, if anything was.

        Raises InputError, WorldError as `write_result_file` does.
        """
        text = relocate(self.text, self.path, out)
        if camera is not None:
            text = rewrite(text, {("camera",): camera.name}, str(out))
        written = []
        if self.robots != self.rig.files.get(self.rig.robots_name, ""):
            beside = robots_path(out)
            before = self.path.parent / PurePosixPath(self.rig.robots_name)
            robots = relocate_robots(self.robots, before, beside)
            written.append((beside, write_result_file(beside, robots, force)))
            text = rewrite(text, {(ROBOTS,): beside.name}, str(out))
        return [(out, write_result_file(out, text, force)), *written]

    def _is_there(self, path: tuple[str, ...]) -> bool:
        """Whether what stands at a path is in the file of robots."""
        return bool(self.rig.robots_name) and path[0] == ROBOTS

    @property
    def _robots_name(self) -> str:
        return str(self.path.parent / self.rig.robots_name)


def told_of(written: Sequence[tuple[Path, Path | None]], rig: Rig) -> list[str]:
    """Sentences about what `RigTexts.write` wrote."""
    lines = [f"written: {path}" + (f"; the old one is kept as {kept}" if kept else "") for path, kept in written]
    if len(written) > 1:
        lines[1] += (
            f"; other rigs with the robots of {rig.robots_name} take them over with robots: {written[1][0].name}"
        )
    return lines
