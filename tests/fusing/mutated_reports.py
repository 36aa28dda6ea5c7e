"""Frame reports of others, given to fusing among good ones: what comes of each is poses or a sentence."""

from functools import cache

import numpy as np

from asterism.protocol.codec import decode_frame_report, to_bytes
from asterism.server.chain.kernel_list import FUSE
from asterism.server.chain.warm_up import warm_up
from asterism.server.fusing.fleet import Fleet, View
from asterism.server.fusing.fuse import fuse
from asterism.server.fusing.fused import Fused, FusedPose
from asterism.server.fusing.memory import Joint
from asterism.server.fusing.sighting import sighting_of
from asterism.server.service.fusing.ways import Ways
from tests.fusing.drawn import sighting
from tests.service.fusing.speaking import report_of
from tests.several import Drive, facing_pair, rigs_at

START_NS, PERIOD_NS = 1_000_000_000, 16_666_667
BEFORE = 5  # good exposures
VIEWS = [View(rig) for rig in rigs_at(facing_pair(), 2)]
DRIVE = Drive(("r00", "r01"))


@cache
def frames(number: int) -> tuple[bytes, ...]:
    """What the two cameras truly report of an exposure."""
    at_ns, rng = START_NS + number * PERIOD_NS, np.random.default_rng(number)
    shown = [sighting(view, DRIVE(at_ns * 1e-9), at_ns, rng) for view in VIEWS]
    reports = [report_of(one, number, 1) for one in shown]
    for report in reports:
        report.robots[0].alternative.pose.CopyFrom(report.robots[0].pose)
        report.robots[0].alternative.odds = 50.0
    reports[0].camera.pose.CopyFrom(reports[0].robots[0].pose)
    place = VIEWS[0].T_world_camera
    p, q = reports[0].camera.pose.position, reports[0].camera.pose.orientation
    p.x, p.y, p.z = place.position
    q.x, q.y, q.z, q.w = place.orientation
    reports[0].camera.covariance.extend((1e-8 * np.eye(6)).ravel().tolist())
    return tuple(to_bytes(report) for report in reports)


def _joined(payloads: tuple[bytes, ...], before: Joint) -> tuple[Fused, Joint]:
    seen = [sighting_of(decode_frame_report(data), view) for data, view in zip(payloads, VIEWS, strict=True)]
    fused, after = fuse(seen[:1], Fleet.of(VIEWS), before)
    for one in seen[1:]:
        fused, after = fuse([one], Fleet.of(VIEWS), after)
    for answer in fused.answers.values():
        if isinstance(answer, FusedPose):
            assert np.isfinite(answer.pose.position).all()
            assert abs(np.linalg.norm(answer.pose.orientation) - 1.0) < 1e-6
            sizes = np.sqrt(np.diag(answer.covariance))
            assert np.linalg.eigvalsh(answer.covariance / np.outer(sizes, sizes))[0] > -1e-6
    return fused, after


@cache
def _remembered() -> Joint:
    warm_up(FUSE)
    joint = Joint.none()
    for number in range(BEFORE):
        _, joint = _joined(frames(number), joint)
    return joint


def fused(payload: bytes) -> None:
    """A camera's report between good ones. Raises InputError for what is none."""
    report = decode_frame_report(payload)
    ways = Ways()
    _, joint = _joined((payload, frames(BEFORE)[1]), _remembered())
    ways.add("left", report)
    _joined(frames(BEFORE + 1), joint)
