"""A frame report as fusing takes it."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import decode_frame_report, to_bytes
from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Pose
from asterism.server.fusing.fleet import View
from asterism.server.fusing.sighting import sighting_of
from tests.fusing.drawn import sighting
from tests.service.fusing.speaking import report_of
from tests.several import Drive, facing_pair, frames_of, reports_of, rigs_at


def test_rays_lead_to_the_leds_that_the_camera_names() -> None:
    rig = rigs_at(facing_pair(), robots=2)[0]
    drive = Drive(tuple(robot.id for robot in rig.robots))
    report = next(reports_of(frames_of(rig, drive, [0]), rig))
    seen = sighting_of(decode_frame_report(to_bytes(report)), View(rig))
    assert np.count_nonzero(seen.leds >= 0) == 12
    for ray, robot, led in zip(seen.rays, seen.robots, seen.leds, strict=True):
        point = rig.T_world_camera.inverse().map(drive(0.0)[rig.robots[robot].id].map(rig.robots[robot].leds[led]))
        assert np.abs(ray - point[:2] / point[2]).max() < 0.2 / 1400


def test_a_report_of_other_robots_is_refused() -> None:
    rig, other = (rigs_at(facing_pair(), robots=n)[0] for n in (1, 2))
    report = next(reports_of(frames_of(rig, Drive(("r00",)), [0]), rig))
    with pytest.raises(InputError, match="tells of robots r00, expected those of its rig: r00, r01"):
        sighting_of(report, View(other))


def _with_time(report: "pb.FrameReport") -> None:
    report.exposed_ns = (1 << 64) - 1


def _with_place(report: "pb.FrameReport") -> None:
    report.camera.pose.orientation.w = 1.0
    report.camera.covariance.extend([0.0] * 35)


def _with_robot(report: "pb.FrameReport") -> None:
    report.spots.robot[0] = 7


def _with_twice(report: "pb.FrameReport") -> None:
    report.spots.led[0] = report.spots.led[1]


def _with_nan(report: "pb.FrameReport") -> None:
    report.spots.x[0] = math.nan


def _with_negative(report: "pb.FrameReport") -> None:
    report.spots.covariance_yy[0] = -1.0


def _with_many(report: "pb.FrameReport") -> None:
    for column in report.spots.ListFields():
        column[1].extend([column[1][0]] * 30_000)


def _with_covariance(report: "pb.FrameReport") -> None:
    report.robots[0].covariance[0] = -1e-6


def _with_pose(report: "pb.FrameReport") -> None:
    report.robots[0].pose.position.z = 1e308


def _with_misfit(report: "pb.FrameReport") -> None:
    report.learned.led_misfit[:] = [math.inf]


def _without_spots(report: "pb.FrameReport") -> None:
    report.spots.Clear()


IMPOSSIBLE = {
    _with_time: "of 18446744073709551615 ns",
    _with_place: "35 numbers of a covariance, expected 36",
    _with_robot: "LEDs which its robots do not have",
    _with_twice: "or one LED twice",
    _with_nan: "spots outside its image",
    _with_negative: "spots whose covariance is none",
    _with_many: "spots, expected at most 20000",
    _with_covariance: "r00: 36 numbers that are no covariance",
    _with_pose: "is none",
    _with_misfit: "LEDs that are off by",
    _without_spots: "a pose of 0 spots, expected at least 3",
}


@pytest.mark.parametrize(("spoil", "why"), IMPOSSIBLE.items(), ids=[one.__name__[1:] for one in IMPOSSIBLE])
def test_numbers_that_no_chain_tells_are_refused(spoil: Callable[["pb.FrameReport"], None], why: str) -> None:
    view = View(rigs_at(facing_pair(), robots=1)[0])
    report = report_of(sighting(view, {"r00": Pose.identity()}, 5, np.random.default_rng(0)))
    sighting_of(report, view)
    spoil(report)
    with pytest.raises(InputError, match=why):
        sighting_of(report, view)
