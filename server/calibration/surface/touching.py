"""From where robots were located to where they touch: their standing points, and what moves these in all frames."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.constellation import LEDS
from asterism.protocol.geometry import Floats
from asterism.protocol.rig import Rig, Robot
from asterism.server.calibration.surface.contacts import Contacts
from asterism.server.calibration.surface.located import Located

NUMBERS = 2 * LEDS
STEP = 1e-5  # m, of numeric derivatives
MOST_TILT = 0.1  # rad: what a plate's tilt may be off at most, where a plate seen from the front says little of it
SPOT_PX = 0.05  # what a spot is off, against which that counts


class Standing(NamedTuple):
    """By which of its points a robot stands, and how its LEDs may be off (18, k), m for one sigma of each of k causes
    (`budget.common_causes.led_shapes`).
    """

    name: str
    led_shapes: Floats


def contacts_of(rig: Rig, located: Located, standing: Mapping[str, Standing]) -> Contacts:
    """The touches of robots that stand so; frames in which a robot does not move count as one. ``rig`` has a world."""
    parts = []
    for k, robot_id in enumerate(located.ids):
        robot = rig.robot(robot_id)
        rows = np.flatnonzero(located.robots == k)
        starts = _starts(rig, robot, located.rotations[rows, 0], located.ts[rows, 0])
        parts.append(_of_robot(rig, robot, standing[robot_id], located, (k, rows, starts)))
    joined = [np.concatenate(columns) for columns in zip(*parts, strict=True)]
    return Contacts(located.ids, tuple(standing[each].name for each in located.ids), *joined)


def _starts(rig: Rig, robot: Robot, rotations: Floats, ts: Floats) -> NDArray[np.int64]:
    """Which poses begin a new touch: from the one before, an LED has moved by a pixel.

    Nearer than that what spots are off stays (how their light lies in the pixels), and more frames tell no more.
    """
    assert rig.T_world_camera is not None
    leds = np.einsum("nij,lj->nli", rotations, robot.leds) + ts[:, None]
    away = np.linalg.norm(leds - rig.T_world_camera.position, axis=-1).mean(axis=1)
    starts, last = [], -1
    for k in range(len(leds)):
        moved = last < 0 or np.linalg.norm(leds[k] - leds[last], axis=-1).max() > away[k] / rig.camera.focal_px
        if moved:
            starts.append(k)
            last = k
    return np.array(starts, np.int64)


def _of_robot(
    rig: Rig,
    robot: Robot,
    stand: Standing,
    located: Located,
    which: tuple[int, NDArray[np.int64], NDArray[np.int64]],
) -> tuple[NDArray[np.int64] | Floats, ...]:
    """The columns of `Contacts` for one robot, of the touches that begin at some of its rows."""
    k, rows, starts = which
    counts = np.diff([*starts, len(rows)]) if len(starts) else np.zeros(0, np.int64)
    axis = robot.axis if robot.stands is None else robot.stands.axis
    arms = located.rotations[rows] @ robot.points[stand.name]
    points, axes = arms + located.ts[rows], located.rotations[rows] @ axis
    first = rows[starts]
    arms, middle = arms[starts, 0], _mean(points[:, 0], starts, counts)
    by = np.concatenate([np.broadcast_to(np.eye(3), (len(first), 3, 3)), -_cross(arms)], axis=-1)
    covariances = located.covariances[first]
    leaning = _cross(axes[starts, 0])
    return (
        np.full(len(first), k, np.int64),
        located.times_s[first],
        counts.astype(np.int64),
        middle,
        by @ covariances @ np.swapaxes(by, 1, 2),
        axes[starts, 0],
        leaning @ covariances[:, 3:, 3:] @ np.swapaxes(leaning, 1, 2),
        located.rotations[first, 0],
        points[starts, 1],
        axes[starts, 1],
        by @ _pose_by_leds(rig, robot, located.rotations[first, 0], located.ts[first, 0], stand.led_shapes),
    )


def _mean(values: Floats, starts: NDArray[np.int64], counts: NDArray[np.int64]) -> Floats:
    if not len(starts):
        return values[:0]
    mean: Floats = np.add.reduceat(values, starts, axis=0) / counts[:, None]
    return mean


def _cross(v: Floats) -> Floats:
    """The matrices (n, 3, 3) of v x."""
    x, y, z = v.T
    zero = np.zeros_like(x)
    matrices: Floats = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(-1, 3, 3)
    return matrices


def _pose_by_leds(rig: Rig, robot: Robot, rotations: Floats, ts: Floats, led_shapes: Floats) -> Floats:
    """How poses T_world_robot change (n, 6, k), m and rad about the world's axes, for one sigma of what LEDs may be
    off.
    """
    assert rig.T_world_camera is not None
    by_spots, by_point = pose_by_spots(rig, robot, rotations, ts)
    turn = rig.T_world_camera.rotation.T  # world to camera
    shapes = led_shapes.reshape(LEDS, 3, -1)
    moved = np.einsum("nlpi,ia,nab,lbk->nlpk", by_point, turn, rotations, shapes, optimize=True)
    change: Floats = by_spots @ moved.reshape(len(ts), NUMBERS, -1)
    return change


def pose_by_spots(rig: Rig, robot: Robot, rotations: Floats, ts: Floats) -> tuple[Floats, Floats]:
    """How poses T_world_robot change (n, 6, 12), m and rad about the world's axes, with the spots, px: by least
    squares; and how spots move (n, 6, 2, 3), px/m, with LEDs along the camera's axes.
    """
    assert rig.T_world_camera is not None
    turn = rig.T_world_camera.rotation.T
    arms = np.einsum("ij,njk,lk->nli", turn, rotations, robot.leds)
    points = arms + ((ts - rig.T_world_camera.position) @ turn.T)[:, None]
    steps = STEP * np.eye(3)[:, None, None]
    by_point = (rig.camera.project(points + steps) - rig.camera.project(points - steps)) / (2.0 * STEP)
    by_point = np.moveaxis(by_point, 0, -1)
    by_turn = by_point @ -_cross(arms.reshape(-1, 3)).reshape(*arms.shape, 3)
    by_pose = np.concatenate([by_point, by_turn], axis=-1).reshape(len(ts), NUMBERS, 6)
    information = np.swapaxes(by_pose, 1, 2) @ by_pose / SPOT_PX**2
    information[:, [3, 4, 5], [3, 4, 5]] += 1.0 / MOST_TILT**2
    change = np.linalg.solve(information, np.swapaxes(by_pose, 1, 2) / SPOT_PX**2)
    return np.asarray(np.kron(np.eye(2), turn.T) @ change, np.float64), by_point
