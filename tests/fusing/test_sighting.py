"""A frame report as fusing takes it."""

import numpy as np
import pytest

from asterism.protocol.codec import decode_frame_report, to_bytes
from asterism.protocol.errors import InputError
from asterism.server.fusing.fleet import View
from asterism.server.fusing.sighting import sighting_of
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
