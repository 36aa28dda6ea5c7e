"""What is remembered of robots goes on with another rig, where that is right."""

from collections.abc import Iterator
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.led_offset import LedOffset
from asterism.protocol.rig import NormalPrior, Rig, Robot
from asterism.server.chain.smooth import Motions
from asterism.server.chain.world import Following
from asterism.server.pose.courses import Courses
from asterism.server.pose.track import Tracks


def carried(tracks: Tracks, before: Rig, after: Rig) -> Tracks:
    """Tracks for the rig ``after`` of those for ``before``: robots that are the same, before the same camera, keep
    theirs; all others are looked for anew.
    """
    out = Tracks.none(len(after.robots))
    if len(tracks.seen_ns) != len(before.robots) or not same_camera(before, after):
        return out
    courses = tracks.courses
    rolling = len(courses.seen_ns) and before.capture.line_time_us == after.capture.line_time_us
    out = out._replace(courses=Courses.none(len(after.robots)) if rolling else Courses.none())
    for old, new in same_robots(before, after):
        for source, target in zip(_arrays(tracks), _arrays(out), strict=True):
            target[new] = source[old]
        if rolling:
            for source, target in zip(courses, out.courses, strict=True):
                target[new] = source[old]
    if isinstance(tracks, Following) and after.follows_world and same_references(before, after):
        return Following.of(out, tracks.place)
    return out


def carried_motions(motions: Motions, before: Rig, after: Rig) -> Motions:
    """The same for what smoothing remembers, which is in the parent frame."""
    if not (same_camera(before, after) and same_world(before, after)):
        return Motions.none()
    kept = [after.robots[new].id for _, new in same_robots(before, after)]
    return Motions({robot: motions.robots[robot] for robot in kept if robot in motions.robots})


def same_camera(before: Rig, after: Rig) -> bool:
    """Whether both see alike: what is remembered is told by the camera's calibration."""
    a, b = before.camera, after.camera
    return a.model == b.model and np.array_equal(a.matrix, b.matrix) and np.array_equal(a.distortion, b.distortion)


def same_world(before: Rig, after: Rig) -> bool:
    """Whether the camera stands at the same place of the world, or of none."""
    a, b = before.T_world_camera, after.T_world_camera
    if a is None or b is None:
        return a is b
    return np.array_equal(a.position, b.position) and np.array_equal(a.orientation, b.orientation)


def same_references(before: Rig, after: Rig) -> bool:
    """Whether the camera and all constellations that stand still are where they were, before the same camera."""
    return same_camera(before, after) and same_world(before, after) and _standing(before) == _standing(after)


def _standing(rig: Rig) -> dict[str, tuple[bytes, ...]]:
    """The rig's constellations that stand still, as values to be compared."""
    return {
        robot.id: (robot.leds.tobytes(), place.position.tobytes(), place.orientation.tobytes())
        for robot in rig.robots
        if (place := robot.T_world_fixed) is not None
    }


def same_robots(before: Rig, after: Rig) -> list[tuple[int, int]]:
    """Places in both rigs of the robots that have not changed."""
    places = {robot.id: place for place, robot in enumerate(before.robots)}
    return [
        (places[robot.id], place)
        for place, robot in enumerate(after.robots)
        if robot.id in places and _same(before.robots[places[robot.id]], robot)
    ]


def _same(a: Robot, b: Robot) -> bool:
    """All but the named points, of which tracks know nothing."""
    return (
        np.array_equal(a.leds, b.leds)
        and np.array_equal(a.axis, b.axis)
        and a.led_radius == b.led_radius
        and _alike(a.led_offset, b.led_offset)
        and _alike(a.normal, b.normal)
    )


def _alike(a: NormalPrior | LedOffset | None, b: NormalPrior | LedOffset | None) -> bool:
    """Whether two values of numbers and arrays, or two None, hold the same."""
    if a is None or b is None or type(a) is not type(b):
        return a is b
    return all(np.array_equal(getattr(a, field.name), getattr(b, field.name), equal_nan=True) for field in fields(a))


def _arrays(tracks: Tracks) -> Iterator[NDArray[Any]]:
    return (column for column in tracks if isinstance(column, np.ndarray))
