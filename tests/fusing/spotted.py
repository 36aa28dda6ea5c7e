"""Sightings drawn with noise, as cameras would report them: spots of robots and glints, with or without claims."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import set_report_pose
from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.messages import Fate
from asterism.protocol.rig import Rig, Robot
from asterism.server.fusing.fleet import View
from asterism.server.fusing.sighting import Sighting, sighting_of
from asterism.server.pose.spot_shift import OPTICS, spots_at

NOISE_PX = 0.05
Lit = Mapping[str, Sequence[int]]  # the LEDs that a camera sees, by the robots' ids


def spots_px(rig: Rig, robot: Robot, pose: Pose) -> Floats:
    """Where a camera sees a robot's LEDs (6, 2), px."""
    assert rig.T_world_camera is not None
    plane = rig.T_world_camera.inverse() @ pose @ robot.T_robot_plane
    pixels, view = np.empty((1, 6, 2)), View(rig)
    optics = view.optics.get(robot.id, np.zeros(OPTICS))
    spots_at(view.lens, robot.leds_plane[None], optics[None], plane.rotation[None], plane.position[None], pixels)
    return pixels[0]


def drawn(
    rig: Rig, robots: Mapping[str, tuple[Robot, Pose]], lit: Lit, rng: np.random.Generator, glints: int = 0,
    claimed: Mapping[str, Pose] | None = None, exposed_ns: int = 0,
) -> Sighting:  # fmt: skip
    """What one camera reports of robots at their poses T_world_robot: ``lit`` LEDs as spots, shuffled with ``glints``.

    ``claimed`` are robots of which the camera says itself whose the spots are, with the poses it tells.
    """
    claimed = claimed or {}
    ids = [robot.id for robot in rig.robots]
    rows: list[tuple[Floats, int, int]] = []
    for name, (robot, pose) in robots.items():
        pixels = spots_px(rig, robot, pose) + rng.normal(0, NOISE_PX, (6, 2))
        number = ids.index(name) if name in claimed else -1
        for led in lit.get(name, ()):
            rows.append((pixels[led], number, led if number >= 0 else -1))
    size = np.array([rig.camera.width, rig.camera.height])
    rows = [row for row in rows if ((row[0] > 2) & (row[0] < size - 2)).all()]
    rows += [(rng.uniform(5, size - 5), -1, -1) for _ in range(glints)]
    order = rng.permutation(len(rows))
    report = pb.FrameReport(exposed_ns=exposed_ns, frame_id="world")
    for k in order:
        (x, y), number, led = rows[k]
        report.spots.x.append(x)
        report.spots.y.append(y)
        report.spots.covariance_xx.append(NOISE_PX**2)
        report.spots.covariance_xy.append(0.0)
        report.spots.covariance_yy.append(NOISE_PX**2)
        report.spots.fate.append(Fate.LED if number >= 0 else Fate.UNEXPLAINED)
        report.spots.robot.append(number)
        report.spots.led.append(led)
    for name in ids:
        entry = report.robots.add(id=name, state=pb.State.LOST)
        if name in claimed:
            entry.state = pb.State.TRACKED
            set_report_pose(entry.pose, claimed[name])
            entry.covariance.extend((1e-6 * np.eye(6)).ravel().tolist())
    report.learned.led_misfit.extend([0.0] * len(ids))
    return sighting_of(report, View(rig))


def truth_of(sighting: Sighting, rig: Rig, robot: Robot, pose: Pose, within_px: float = 0.5) -> Floats:
    """Which rows of a sighting are a robot's LEDs (6,), -1 where there is no spot."""
    pixels = spots_px(rig, robot, pose)
    away = np.linalg.norm(sighting.centres_px[None] - pixels[:, None], axis=-1)
    rows = away.argmin(axis=1)
    out: Floats = np.where(away[np.arange(6), rows] < within_px, rows, -1)
    return out


Draw = Callable[..., Sighting]
