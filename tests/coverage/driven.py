"""Recordings of robots that drive on a surface, without a camera: reports as a server writes them, of poses that are
known.
"""

import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import numpy as np

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import encode_odometry, set_report_pose, set_vector, stamped, to_bytes
from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.messages import FRAME_REPORT, ODOMETRY, Message, RobotPose, Standing
from asterism.protocol.rig import Rig, parse_rig
from asterism.recordings.recorder import FramesKept, Recorder
from asterism.server.calibration.lens.camera_file import camera_text
from tests.rigs import make_camera, random_layouts
from tests.several import looking_at

START_NS = 1_795_398_896_123_456_789
RATE_HZ = 60
STEP_NS = 1_000_000_000 // RATE_HZ
SIGMA_M, SIGMA_RAD = 5e-5, 5e-4  # of poses, as they tell
EDGE = [[-0.3, -0.2], [0.3, -0.2], [0.3, 0.2], [-0.3, 0.2]]
BENT = {"quadric": {"terms": {"x": 0.03, "y": -0.02, "z": 1, "xx": 0.4, "yy": 0.25, "xy": 0.15}}, "edge": EDGE}
FLAT = {"plane": {"point": [0, 0, 0], "normal": [0, 0, 1]}, "edge": EDGE}
SPOTS = 6  # of each robot


def working_rig(
    robots: int = 2, surface: Mapping[str, object] | None = BENT, radius_m: float | None = 0.01, name: str = "test"
) -> Rig:
    """A rig, by its text, of robots r00, r01, ... whose tools stand on the surface; without one none of them does."""
    place = looking_at(1.3 * np.array([0.03, -0.02, 1.0]), np.zeros(3), 0.7)
    world = {"position": place.position.tolist(), "orientation": place.orientation.tolist()}
    text = f"camera: camera.yaml\nrange: [0.8, 2.0]\nworld: {json.dumps(world)}\n"
    text += "" if surface is None else f"surface: {json.dumps(surface)}\n"
    stands = {"point": "tool", "sigma": 5e-5, "tilt_sigma_deg": 0.1} | (
        {} if radius_m is None else {"radius": radius_m}
    )
    text += "robots:\n"
    for k, layout in enumerate(random_layouts(robots, 0)):
        leds = np.column_stack([layout, np.zeros(6)]).round(4).tolist()
        words: dict[str, object] = {"leds": leds, "led": {"radius": 0.0025}, "points": {"tool": [0.0, 0.0, -0.03]}}
        text += f"  r{k:02d}: {json.dumps(words | ({} if surface is None else {'stands': stands}))}\n"
    return parse_rig(text, camera_text(make_camera(name=name)), "test")


def report_of(
    rig: Rig, sequence: int, time_ns: int, poses: Mapping[str, Pose], rng: np.random.Generator
) -> "pb.FrameReport":
    """What a server says of a frame in which all of these robots stand on the surface; the others are lost."""
    report = pb.FrameReport(sequence=sequence, exposed_ns=time_ns, arrived_ns=time_ns + 4_000_000, session=7)
    report.solved_ns, report.frame_id, report.clock = time_ns + 9_000_000, rig.parent_frame, pb.DRIVER
    report.learned.led_misfit.extend(rng.uniform(size=len(rig.robots)).tolist())
    for index, robot in enumerate(rig.robots):
        if robot.id not in poses:
            report.robots.add(id=robot.id, state=pb.LOST, reason="hidden")
            continue
        entry = report.robots.add(id=robot.id, state=pb.TRACKED, leds=SPOTS, rms_px=0.03)
        set_report_pose(entry.pose, poses[robot.id])
        entry.covariance.extend(_covariance(rng).ravel().tolist())
        for name, point in robot.points.items():
            set_vector(entry.points[name], poses[robot.id].map(point))
        entry.surface.standing, entry.surface.off_m = Standing.ON_SURFACE, float(rng.normal(0.0, SIGMA_M))
        entry.surface.off_sigma_m, entry.surface.tilt_off_sigma_rad = SIGMA_M, SIGMA_RAD
        entry.surface.tilt_off_rad = float(abs(rng.normal(0.0, SIGMA_RAD)))
        set_report_pose(entry.surface.without, poses[robot.id])
        entry.surface.without_covariance.extend(_covariance(rng).ravel().tolist())
        _spots(report, entry, index, rng)
    return report


def _spots(report: "pb.FrameReport", entry: "pb.RobotReport", index: int, rng: np.random.Generator) -> None:
    spots, n = report.spots, SPOTS
    entry.led.extend(range(n))
    entry.spot.extend(range(len(spots.x), len(spots.x) + n))
    entry.residual_x.extend(rng.normal(0.0, 0.03, n).tolist())
    entry.residual_y.extend(rng.normal(0.0, 0.03, n).tolist())
    for column in (spots.x, spots.y, spots.covariance_xx, spots.covariance_xy, spots.covariance_yy):
        column.extend(rng.uniform(0.0, 1000.0, n).tolist())
    spots.brightness.extend(rng.uniform(100.0, 200.0, n).tolist())
    spots.radius.extend(rng.uniform(2.0, 3.0, n).tolist())
    spots.fate.extend([pb.LED] * n)
    spots.robot.extend([index] * n)
    spots.led.extend(range(n))


def _covariance(rng: np.random.Generator) -> Floats:
    """Near that of the sigmas, and never twice the same."""
    root = np.diag([SIGMA_M] * 3 + [SIGMA_RAD] * 3) @ (np.eye(6) + 0.1 * rng.normal(size=(6, 6)))
    covariance: Floats = root @ root.T
    return covariance


def odometry_of(rig: Rig, report: "pb.FrameReport") -> list[Message]:
    """The poses of a report as messages of their own."""
    told = []
    for entry in report.robots:
        if entry.HasField("pose"):
            p, q = entry.pose.position, entry.pose.orientation
            pose = Pose(np.array([p.x, p.y, p.z]), np.array([q.x, q.y, q.z, q.w]))
            covariance = np.reshape(entry.covariance, (6, 6))
            message = RobotPose(
                entry.id, report.frame_id, pose, covariance, "TRACKED", entry.leds, entry.rms_px, report.sequence,
                report.exposed_ns, 0, session=report.session, standing="ON_SURFACE",
            )  # fmt: skip
            key = keys.odometry(rig.camera.name, entry.id)
            told.append(Message(key, ODOMETRY, encode_odometry(message), report.exposed_ns, 0, report.sequence))
    return told


def message_of(rig: Rig, report: "pb.FrameReport") -> Message:
    """A report as a message."""
    return Message(keys.frame(rig.camera.name), FRAME_REPORT, to_bytes(report), report.exposed_ns, 0, report.sequence)


def record(parent: Path, rig: Rig, frames: Iterable[list[Message]]) -> Path:
    """A recording of frames' messages; returns its folder."""
    recorder = Recorder(parent, rig, "test", FramesKept(0), wait=True, timed=False)
    for messages in frames:
        at, number = messages[-1].log_ns, messages[-1].sequence
        recorder.write([stamped(message, at + 10_000_000) for message in messages], None, at, number)
    recorder.close({})
    return recorder.folder


def record_drive(
    parent: Path, rig: Rig, frames: int, where: Callable[[str, int], Pose | None], rng: np.random.Generator,
    first: int = 0,
) -> Path:  # fmt: skip
    """A recording of robots that are at T_world_robot in each frame; none: it is lost."""

    def told() -> Iterable[list[Message]]:
        for number in range(first, first + frames):
            poses = {robot.id: pose for robot in rig.robots if (pose := where(robot.id, number)) is not None}
            report = report_of(rig, number, START_NS + number * STEP_NS, poses, rng)
            yield [*odometry_of(rig, report), message_of(rig, report)]

    return record(parent, rig, told())
