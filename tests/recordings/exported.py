"""A recording to export: six frames with poses drawn at random, of two sessions and two rigs.

In frame 2 the first robot is lost, in frame 3 the second has two tilts, from frame 4 on another rig is in force and the
clock has been set back.
"""

from pathlib import Path

import numpy as np

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import encode_odometry, set_report_pose, set_vector, stamped, to_bytes
from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.messages import FRAME_REPORT, ODOMETRY, Message, RobotPose, Velocity
from asterism.protocol.rig import Rig
from asterism.recordings.reader import Recording
from asterism.recordings.recorder import FramesKept, Recorder
from tests.helpers import random_pose
from tests.recordings.reloaded import two_rigs

FRAMES = 6
RELOADED = 4
START_NS = 1_795_398_896_123_456_789
STEP_NS = 16_666_667
SET_BACK_NS = 3_000_000_000
LOST_IN, AMBIGUOUS_IN = 2, 3
REASON = 'hidden, "as it seems"; or gone'


def exposed_ns(sequence: int) -> int:
    """The time of a frame."""
    return START_NS + sequence * STEP_NS - (SET_BACK_NS if sequence >= RELOADED else 0)


def record(parent: Path, rng: np.random.Generator) -> tuple[Recording, dict[tuple[int, str], RobotPose]]:
    """Record it, with noise for images; returns it, and every pose by frame and robot."""
    first, second = two_rigs()
    recorder = Recorder(parent, first, "test", FramesKept(), wait=True)
    poses: dict[tuple[int, str], RobotPose] = {}
    for sequence in range(1, FRAMES + 1):
        if sequence == RELOADED:
            recorder.take_rig(second)
        rig = second if sequence >= RELOADED else first
        messages = _messages(rig, sequence, poses, rng)
        image = rng.integers(0, 50, (rig.camera.height, rig.camera.width), dtype=np.uint8)
        recorder.write(messages, image, exposed_ns(sequence), sequence)
    recorder.close({})
    return Recording(recorder.folder), poses


def _messages(
    rig: Rig, sequence: int, poses: dict[tuple[int, str], RobotPose], rng: np.random.Generator
) -> list[Message]:
    time_ns = exposed_ns(sequence)
    report = pb.FrameReport(sequence=sequence, exposed_ns=time_ns, session=7 + (sequence >= RELOADED), frame_id="world")
    messages = []
    for index, robot in enumerate(rig.robots):
        entry = report.robots.add(id=robot.id, state=pb.LOST, reason=REASON)
        if sequence == LOST_IN and index == 0:
            continue
        state = "TILT_AMBIGUOUS" if sequence == AMBIGUOUS_IN and index == 1 else "TRACKED"
        told = RobotPose(
            robot.id, "world", random_pose(rng), _covariance(rng), state, 6, float(f"{rng.uniform():.5g}"), sequence,
            time_ns, 0, session=report.session, smoothed_by="test",
            velocity=Velocity(rng.normal(size=3), rng.normal(size=3), _covariance(rng), (1.0, 2.0)),
        )  # fmt: skip
        poses[sequence, robot.id] = told
        _tell(report, entry, told, rng)
        for name, point in robot.points.items():
            set_vector(entry.points[name], told.pose.map(point))
        message = Message(keys.odometry("demo", robot.id), ODOMETRY, encode_odometry(told), time_ns, 0, sequence)
        messages.append(stamped(message, time_ns + 2_000_000))
    whole = Message(keys.frame("demo"), FRAME_REPORT, to_bytes(report), time_ns, 0, sequence)
    return [*messages, stamped(whole, time_ns + 2_000_000)]


def _tell(report: "pb.FrameReport", entry: "pb.RobotReport", told: RobotPose, rng: np.random.Generator) -> None:
    """Enter a pose into its frame's report, with two of its LEDs."""
    entry.state, entry.reason = pb.State.Value(told.state), ""
    set_report_pose(entry.pose, told.pose)
    entry.covariance.extend(told.covariance.ravel().tolist())
    entry.leds, entry.rms_px, entry.smoothed_by = told.leds, told.rms_px, told.smoothed_by
    if told.state == "TILT_AMBIGUOUS":
        set_report_pose(entry.alternative.pose, Pose(told.position, np.array([0.0, 0.6, 0.0, 0.8])))
        entry.alternative.odds = 12.5
    for led in (0, 4):
        spots = report.spots
        entry.led.append(led)
        entry.spot.append(len(spots.x))
        entry.residual_x.append(rng.normal())
        entry.residual_y.append(rng.normal())
        for column in (spots.x, spots.y, spots.covariance_xx, spots.covariance_xy, spots.covariance_yy):
            column.append(rng.uniform())
        spots.brightness.append(100.0)
        spots.radius.append(3.0)
        spots.fate.append(pb.LED)
        spots.robot.append(len(report.robots) - 1)
        spots.led.append(led)


def _covariance(rng: np.random.Generator) -> Floats:
    root = 1e-3 * rng.normal(size=(6, 6))
    return root @ root.T
