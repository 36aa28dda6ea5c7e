"""Room on a recording's disk: some is kept for the index, some for poses, so that frames stop first."""

import contextlib
import os
from pathlib import Path

from asterism.protocol.errors import WorldError

RESERVE_BYTES = 4 << 20  # given up when the disk is full, so that the index finds room
RESERVE = ".reserve"
POSES_BYTES, POSES_SHARE = 1 << 30, 0.05  # kept free of frames, whichever is less: an hour of poses
ENOUGH = 2  # times what frames stop at: there they go on


class Room:
    """Of one recording's folder. Raises WorldError when nothing can be written there."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._reserve = folder / RESERVE
        self._kept = 0
        try:
            self._keep(RESERVE_BYTES)
            disk = os.statvfs(folder)
        except OSError as error:
            with contextlib.suppress(OSError):  # nothing is begun, and nothing of it left
                self._reserve.unlink(missing_ok=True)
                folder.rmdir()
            raise WorldError(f"{folder}: cannot be recorded to ({error.strerror})") from None
        self._for_poses = min(POSES_BYTES, int(POSES_SHARE * disk.f_blocks * disk.f_frsize))

    @property
    def free(self) -> int:
        """How much room the disk has left, 0 where it cannot be asked."""
        try:
            disk = os.statvfs(self._folder)
        except OSError:
            return 0
        return disk.f_bavail * disk.f_frsize

    def has_for_frames(self, stopped: bool) -> bool:
        """Whether there is room for more than poses; once ``stopped``, for a good deal more."""
        if self._kept < RESERVE_BYTES and not self.take_again():
            return False
        return self.free > self._for_poses * (ENOUGH if stopped else 1)

    def give_half(self) -> None:
        """Free half of what is kept: for the index of the frames, while that of the poses may still need its own."""
        self._keep(min(self._kept, RESERVE_BYTES // 2))

    def give_up(self) -> None:
        """Free all that is kept."""
        self._keep(0)

    def take_again(self) -> bool:
        """Keep room for the index again; whether there is any, and as much beside it."""
        if self.free < 2 * RESERVE_BYTES - self._kept:
            return False
        try:
            self._keep(RESERVE_BYTES)
        except OSError:
            return False
        return True

    def _keep(self, size: int) -> None:
        """So much, from now on. Raises OSError where it cannot be had."""
        if size < self._kept:
            with contextlib.suppress(FileNotFoundError):  # somebody removed the folder
                os.truncate(self._reserve, size)
        elif size > self._kept:
            with self._reserve.open("ab") as reserve:
                os.posix_fallocate(reserve.fileno(), 0, size)
        self._kept = size
        if not size:
            self._reserve.unlink(missing_ok=True)
