"""When the images of a folder were taken: its `times.csv`, a line `frame,exposed_ns` for every one."""

from pathlib import Path

from asterism.protocol.errors import InputError
from asterism.protocol.text_file import read_text

NAME = "times.csv"
HEADER = "frame,exposed_ns"
_LARGEST_FILE = 1 << 28  # bytes
_LATEST_NS = (1 << 63) - 1


class FrameTimes:
    """The times of the images in some folders; those of folders without the file are unknown."""

    def __init__(self, folders: set[Path]) -> None:
        """Raises InputError for a file that is wrong: which, in which line, what is expected."""
        self._times = {folder: _read(folder / NAME) for folder in folders if (folder / NAME).exists()}
        self._before: tuple[str, int] | None = None

    @property
    def rate_hz(self) -> float | None:
        """Images a second, where there are times of two or more."""
        for times in self._times.values():
            if len(times) > 1:
                return (len(times) - 1) * 1e9 / (max(times.values()) - min(times.values()))
        return None

    def of(self, path: Path, name: str) -> int | None:
        """When the image ``name`` in file ``path`` was taken, ns since the Unix epoch; None where nothing tells.

        Raises InputError for one that is not in its folder's file, or is not later than the one asked for before.
        """
        file = path.parent / NAME
        times = self._times.get(path.parent)
        if times is None:
            return None
        if name not in times:
            raise InputError(f"{file}: has no time for {name}, expected a line for every image of the folder")
        time_ns = times[name]
        if self._before is not None and time_ns <= self._before[1]:
            raise InputError(
                f"{file}: {name} was taken at {time_ns}, expected later than {self._before[0]} before it, at "
                f"{self._before[1]}"
            )
        self._before = (name, time_ns)
        return time_ns


def _read(file: Path) -> dict[str, int]:
    lines = read_text(file, f"lines {HEADER}", _LARGEST_FILE).removeprefix("\ufeff").splitlines()
    if not lines or lines[0].strip() != HEADER:
        found = f"begins with {lines[0].strip()[:80]!r}" if lines else "is empty"
        raise InputError(f"{file}: {found}, expected the header {HEADER}")
    times: dict[str, int] = {}
    for number, line in enumerate(lines[1:], 2):
        if not line.strip():
            continue
        name, _, told = line.strip().rpartition(",")
        if not name or not told.isascii() or not told.isdecimal() or int(told[:20]) > _LATEST_NS:
            raise InputError(
                f"{file}, line {number}: {line.strip()[:80]!r}, expected an image's name and a whole number of ns"
            )
        if name in times:
            raise InputError(f"{file}, line {number}: a second time for {name}, expected one line for each image")
        times[name] = int(told)
    return times
