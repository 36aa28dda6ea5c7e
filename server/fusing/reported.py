"""Whether a frame report is one that a camera's chain makes: fusing computes with its numbers as they are."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import check_report_pose
from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats
from asterism.protocol.messages import Fate
from asterism.server.fusing.fleet import View

LATEST_NS = 1 << 62  # the year 2116
MOST_SPOTS = 20_000
BESIDE_PX = 8.0  # by which a spot's centre may be outside its image
LEAST_PX2, MOST_PX2 = 1e-12, 1e6  # variances of spots
LEAST_VARIANCE, MOST_VARIANCE = 1e-24, 1e6  # of poses, m^2 and rad^2
MOST_MISFIT_M = 1.0
LEDS, LEAST_SPOTS = 6, 3  # of a robot; of a pose
ROUNDED = 1e-6  # by which a covariance may be none, as a part of its size


def refuse_impossible(report: "pb.FrameReport", view: View) -> None:
    """Raises InputError for a report with numbers that no chain tells of that camera and its robots."""
    where = f"a frame report of camera {view.camera}"
    if not 0 <= report.exposed_ns < LATEST_NS:
        raise InputError(f"{where} is of {report.exposed_ns} ns, expected a time since 1970")
    spots_of = _spots_of_robots(report, view, where)
    if report.HasField("camera"):
        check_report_pose(report.camera.pose)
        covariance_of(report.camera.covariance, f"{where}: the camera's place", 0.0)
    misfits = np.array(report.learned.led_misfit, np.float64)
    if not np.all((misfits >= 0.0) & (misfits <= MOST_MISFIT_M)):
        raise InputError(f"{where} has LEDs that are off by none of 0 to {MOST_MISFIT_M:g} m")
    posed = [number for number, robot in enumerate(report.robots) if robot.HasField("pose")]
    names = [f"{where}, robot {view.rig.robots[number].id}" for number in posed]
    covariances_of([report.robots[number].covariance for number in posed], names, LEAST_VARIANCE)
    for number, name in zip(posed, names, strict=True):
        _refuse_pose(report.robots[number], name, int(spots_of[number]))


def covariance_of(numbers: Sequence[float], where: str, least: float) -> Floats:
    """The covariance (6, 6) in a report, with variances from ``least`` on. Raises InputError for one that is none."""
    covariance: Floats = covariances_of([numbers], [where], least)[0]
    return covariance


def covariances_of(numbers: Sequence[Sequence[float]], wheres: Sequence[str], least: float) -> Floats:
    """The same of several at once (n, 6, 6): numpy is slow at small arrays."""
    for one, where in zip(numbers, wheres, strict=True):
        if len(one) != 36:
            raise InputError(f"{where}: {len(one)} numbers of a covariance, expected 36")
    covariances = np.array([list(one) for one in numbers], np.float64).reshape(-1, 6, 6)
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    known = np.all(np.abs(covariances) <= MOST_VARIANCE, axis=(1, 2))
    known &= np.all((variances >= least) & ((variances == 0.0) | (variances >= LEAST_VARIANCE)), axis=1)
    sizes = np.sqrt(np.maximum(np.where(known[:, None], variances, 1.0), LEAST_VARIANCE))
    alike = np.where(known[:, None, None], covariances, np.eye(6)) / (sizes[:, :, None] * sizes[:, None])
    known &= np.all(np.abs(alike - np.swapaxes(alike, 1, 2)) <= ROUNDED, axis=(1, 2))
    known &= np.linalg.eigvalsh(np.where(known[:, None, None], alike, np.eye(6)))[:, 0] >= -ROUNDED
    for where in (where for where, good in zip(wheres, known.tolist(), strict=True) if not good):
        raise InputError(f"{where}: 36 numbers that are no covariance")
    return covariances


def _spots_of_robots(report: "pb.FrameReport", view: View, where: str) -> NDArray[np.int64]:
    """How many spots each robot has. Raises InputError for spots that cannot be."""
    spots, camera = report.spots, view.rig.camera
    columns = (spots.x, spots.y, spots.covariance_xx, spots.covariance_xy, spots.covariance_yy, spots.fate, spots.robot,
               spots.led)  # fmt: skip
    if len({len(column) for column in columns}) != 1:
        raise InputError(f"{where} has columns of spots of unlike lengths")
    if len(spots.x) > MOST_SPOTS:
        raise InputError(f"{where} has {len(spots.x)} spots, expected at most {MOST_SPOTS}")
    x, y, xx, xy, yy = (np.array(column, np.float64) for column in columns[:5])
    inside = (x >= -BESIDE_PX) & (x <= camera.width + BESIDE_PX) & (y >= -BESIDE_PX) & (y <= camera.height + BESIDE_PX)
    if not np.all(inside):
        raise InputError(f"{where} has spots outside its image of {camera.width}x{camera.height}")
    known = (np.minimum(xx, yy) >= LEAST_PX2) & (np.maximum(xx, yy) <= MOST_PX2) & (np.abs(xy) <= 1e-3 * MOST_PX2)
    fates = np.array(spots.fate, np.int64)
    used = (fates == Fate.LED) | (fates == Fate.UNEXPLAINED)
    if not np.all(known[used]) or not np.all((xx * yy - xy * xy)[used] > 0.0):
        raise InputError(f"{where} has spots whose covariance is none")
    robots, leds = np.array(spots.robot, np.int64), np.array(spots.led, np.int64)
    whose = (robots >= -1) & (robots < len(view.rig.robots)) & (leds >= -1) & (leds < LEDS)
    whose &= (robots >= 0) == (leds >= 0)
    claimed = ((robots >= 0) & (leds >= 0) & whose)[used]
    numbers = (robots * LEDS + leds)[used][claimed]
    if not np.all(whose) or np.bincount(numbers).max(initial=0) > 1:
        raise InputError(f"{where} has spots that are LEDs which its robots do not have, or one LED twice")
    return np.bincount(robots[used][claimed], minlength=len(view.rig.robots))


def _refuse_pose(robot: "pb.RobotReport", where: str, spots: int) -> None:
    check_report_pose(robot.pose)
    if not (0 <= robot.leds <= LEDS and 0.0 <= robot.rms_px < math.inf):
        raise InputError(f"{where}: {robot.leds} LEDs, off by {robot.rms_px:g} px, expected up to {LEDS}")
    if spots < LEAST_SPOTS:
        raise InputError(f"{where}: a pose of {spots} spots, expected at least {LEAST_SPOTS}")
    if robot.HasField("alternative"):
        check_report_pose(robot.alternative.pose)
        if not robot.alternative.odds >= 0.0:
            raise InputError(f"{where}: another tilt that is less likely by {robot.alternative.odds:g}, expected 0 on")
