"""What `localize` remembers, as a mark that two memories share only if all that follows is the same; kept on disk.

A robot that was not seen for `track.FORGET_NS` says nothing any more, wherever it was: its rows count as empty. That
holds as long as time does not run backwards.
"""

import hashlib
import io
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Pose
from asterism.server.chain.world import Following
from asterism.server.pose.courses import Courses
from asterism.server.pose.place import Place
from asterism.server.pose.track import FORGET_NS, Tracks

MARK_BYTES = 16
ALWAYS = ("misfits", "reasons")  # columns of `Tracks` that are no robot's last sight
_COURSE, _PLACE = "course ", "place "

Array = NDArray[Any]


def mark(tracks: Tracks, now_ns: int) -> bytes:
    """The mark of what was remembered after the frame taken at ``now_ns``."""
    digest = hashlib.blake2b(digest_size=MARK_BYTES)
    for name, column in _columns(tracks):
        seen_ns = tracks.courses.seen_ns if name.startswith(_COURSE) else tracks.seen_ns
        whole = name.startswith(_PLACE) or name in ALWAYS
        digest.update(np.ascontiguousarray(column if whole else _fresh(column, seen_ns, now_ns)).tobytes())
    return digest.digest()


def _fresh(column: Array, seen_ns: Array, now_ns: int) -> Array:
    fresh = (seen_ns > 0) & (now_ns - seen_ns <= FORGET_NS)
    if fresh.all():
        return column
    return np.where(fresh.reshape(-1, *[1] * (column.ndim - 1)), column, np.zeros_like(column))


def _columns(tracks: Tracks) -> Iterator[tuple[str, Array]]:
    own = tracks._asdict()
    courses: Courses = own.pop("courses")
    yield from own.items()
    yield from ((_COURSE + name, column) for name, column in courses._asdict().items())
    if isinstance(tracks, Following):
        place = tracks.place
        yield _PLACE + "position", place.T_world_camera.position
        yield _PLACE + "orientation", place.T_world_camera.orientation
        yield _PLACE + "covariance", place.covariance
        yield _PLACE + "noise", place.noise
        yield _PLACE + "times", np.array([place.at_ns, place.seen_ns])


def stored(tracks: Tracks) -> bytes:
    """All that is remembered, as a file of arrays."""
    file = io.BytesIO()
    np.savez(file, **dict(_columns(tracks)))  # type: ignore[arg-type]
    return file.getvalue()


def restored(data: bytes) -> Tracks:
    """What `stored` made of it."""
    with np.load(io.BytesIO(data), allow_pickle=False) as file:
        columns = {name: file[name] for name in file.files}
    courses = Courses(*(columns[_COURSE + name] for name in Courses._fields))
    own = {name: columns[name] for name in Tracks._fields if name != "courses"}
    tracks = Tracks(courses=courses, **own)
    if _PLACE + "times" not in columns:
        return tracks
    position, orientation, covariance, noise, times = (
        columns[_PLACE + name] for name in ("position", "orientation", "covariance", "noise", "times")
    )
    return Following.of(tracks, Place(Pose(position, orientation), covariance, noise, int(times[0]), int(times[1])))
