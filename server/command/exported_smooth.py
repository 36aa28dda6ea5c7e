"""A recording's frames for export, with their poses smoothed forwards and backwards."""

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats
from asterism.protocol.rig import Rig
from asterism.recordings.export.frames import ExportedFrame, ExportedRobot
from asterism.server.chain.belief import Sight
from asterism.server.chain.smooth import Seen
from asterism.server.chain.smooth_both import BOTH, Look, joined
from asterism.server.chain.stays import Told, what_stays


def smoothed_frames(
    frames: Iterable[ExportedFrame], rigs: Sequence[tuple[int, Rig]], where: Path
) -> Iterator[ExportedFrame]:
    """The same frames with smoothed poses; ``rigs`` were in force, each from its first frame on.

    Raises InputError for poses that a filter smoothed before, and for what is no covariance; ``where`` names the
    recording.
    """
    waiting: deque[ExportedFrame] = deque()

    def looks() -> Iterator[Look]:
        coming = deque(rigs)
        rig = coming[0][1]
        for frame in frames:
            while coming and frame.sequence >= coming[0][0]:
                rig = coming.popleft()[1]
            waiting.append(frame)
            yield _look(frame, rig, where)

    for told in joined(looks()):
        frame = waiting.popleft()
        robots = (robot.moved(*told[robot.id], BOTH) if robot.id in told else robot for robot in frame.robots)
        yield replace(frame, robots=tuple(robots))


def _look(frame: ExportedFrame, rig: Rig, where: Path) -> Look:
    located = [robot for robot in frame.robots if robot.position is not None]
    if not located:
        return Look(frame.exposed_ns, (), None)
    known = {robot.id: robot for robot in rig.robots}
    for robot in located:
        if robot.smoothed_by:
            raise InputError(
                f"{where}: frame {frame.name}: {robot.id} is smoothed already ({robot.smoothed_by}), expected a "
                "recording of a server that does not smooth"
            )
        if robot.id not in known:
            raise InputError(f"{where}: frame {frame.name}: {robot.id} is not in the rig ({', '.join(known)})")
    covariances = np.array([_covariance(robot, f"{where}: frame {frame.name}") for robot in located])
    positions = np.array([robot.position for robot in located])
    knows = np.array([robot.spots_px2 is not None for robot in located])
    own_px2 = np.array([robot.spots_px2 or 1.0 for robot in located])
    misfits = np.where(knows, [robot.misfit_m for robot in located], 0.0)
    camera = None
    if frame.T_world_camera is not None and len(frame.camera_covariance) == 36:
        camera = frame.T_world_camera, np.array(frame.camera_covariance).reshape(6, 6)
    by_spots = np.array([_by_spots(robot, whole) for robot, whole in zip(located, covariances, strict=True)])
    stays = what_stays(Told(positions, covariances, own_px2, misfits, by_spots), rig, camera)
    axes = np.array([known[robot.id].T_robot_plane.rotation[:, 2] for robot in located])
    rotations = np.array([robot.pose.rotation for robot in located if robot.pose is not None])
    # With the surface what stays is another than without: as if other LEDs were seen.
    rests = [robot.surface is not None and robot.surface.without is not None for robot in located]
    leds = [(*sorted(robot.residuals_px), *[-1] * on) for robot, on in zip(located, rests, strict=True)]
    sight = Sight(positions, rotations, covariances - stays, axes)
    return Look(frame.exposed_ns, [robot.id for robot in located], Seen(sight, stays, leds))


def _covariance(robot: ExportedRobot, where: str) -> Floats:
    told = np.array(robot.covariance if robot.covariance is not None else ())
    if told.shape == (36,) and np.isfinite(told).all():
        spread: Floats = told.reshape(6, 6)
        if np.linalg.eigvalsh(spread)[0] > 0.0:
            return spread
    raise InputError(f"{where}: {robot.id}: a covariance that is none, expected 36 numbers with variances above 0")


def _by_spots(robot: ExportedRobot, covariance: Floats) -> Floats:
    """Which part (6, 6) of a pose's covariance is the spots', nan where it rests on light alone: what the surface has
    wrong is the same in the next frame. It is light's information, by the covariance of both.
    """
    if robot.surface is None or robot.surface.without is None:
        return np.full((6, 6), np.nan)
    light = np.linalg.inv(np.array(robot.surface.without[2]).reshape(6, 6))
    return np.asarray(covariance @ light @ covariance, np.float64)
