"""Values whose encoding is fixed for ever, and the golden files made of them: `python -m tests.protocol.make_golden`.

Run it only when the wire format changes on purpose; what changed shows in the JSON beside the bytes. The files of
earlier versions (golden/1) are never made again: today's code must read them.
"""

from dataclasses import replace

import numpy as np
from google.protobuf.json_format import MessageToJson
from google.protobuf.message import Message

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.camera import Camera
from asterism.protocol.codec import (
    decode_rig,
    encode_calibration,
    encode_odometry,
    encode_rig,
    encode_transforms,
    to_bytes,
)
from asterism.protocol.geometry import Pose
from asterism.protocol.messages import PROTOCOL, RobotPose, Velocity
from asterism.protocol.rig import Rig, Robot
from tests.helpers import REPOSITORY

GOLDEN = REPOSITORY / "protocol" / "golden" / str(PROTOCOL)
SESSION = 1_234_567_890_123_456_789
EXPOSED_NS = 1_795_398_896_123_456_789

_COUNTED = np.arange(36.0).reshape(6, 6)

ROBOT_POSE = RobotPose(
    robot="alpha",
    frame_id="world",
    pose=Pose(np.array([0.125, -0.25, 1.5]), np.array([0.5, -0.5, 0.5, 0.5])),
    covariance=(_COUNTED + _COUNTED.T) / 4096 + np.diag([0.125, 0.25, 0.25, 0.5, 0.5, 0.5]),
    state="TILT_AMBIGUOUS",
    leds=5,
    rms_px=0.0125,
    sequence=42,
    exposed_ns=EXPOSED_NS,
    published_ns=EXPOSED_NS + 3_000_000,
    session=SESSION,
)

SMOOTHED_POSE = replace(
    ROBOT_POSE,
    state="TRACKED",
    leds=6,
    smoothed_by="interacting multiple model, constant velocity",
    velocity=Velocity(
        np.array([0.125, -0.0625, 0.0]), np.array([0.0, 0.25, -0.5]), ROBOT_POSE.covariance / 16, (0.001, 0.25)
    ),
)

CAMERA = Camera(
    "cam",
    1280,
    1024,
    np.array([[1400.0, 0.0, 640.0], [0.0, 1402.0, 512.0], [0.0, 0.0, 1.0]]),
    "plumb_bob",
    np.array([-0.125, 0.0625, 0.0, 0.0, 0.0]),
)

RIG = Rig(
    CAMERA,
    (
        Robot(
            "alpha",
            np.array(
                [
                    [0.05, 0, 0],
                    [0.02, 0.04, 0],
                    [-0.03, 0.035, 0],
                    [-0.045, -0.01, 0],
                    [-0.01, -0.047, 0],
                    [0.03, -0.02, 0],
                ]
            ),
            points={"tool": np.array([0.0, 0.0, -0.03])},
        ),
    ),
    T_world_camera=Pose(np.array([0.0, 0.0, 1.25]), np.array([1.0, 0.0, 0.0, 0.0])),
    rig_text="camera: camera.yaml\n",
    camera_text="camera_name: cam\n",
)


def frame_report() -> "pb.FrameReport":
    """One robot located, one lost, three spots."""
    message = pb.FrameReport(
        sequence=42,
        exposed_ns=EXPOSED_NS,
        arrived_ns=EXPOSED_NS + 1_000_000,
        solved_ns=EXPOSED_NS + 2_000_000,
        published_ns=EXPOSED_NS + 3_000_000,
        frame_id="world",
        session=SESSION,
        clock=pb.ARRIVAL,
        spots=pb.Spots(
            x=[640.25, 100.5, 3.0],
            y=[512.75, 200.5, 4.0],
            covariance_xx=[0.0001, 0.0002, 0.0],
            covariance_xy=[0.0, 0.00005, 0.0],
            covariance_yy=[0.0001, 0.0002, 0.0],
            brightness=[180.0, 90.0, 250.0],
            radius=[2.5, 2.0, 0.5],
            fate=[pb.LED, pb.UNEXPLAINED, pb.TOO_SMALL],
            robot=[0, -1, -1],
            led=[3, -1, -1],
        ),
    )
    robot = message.robots.add(
        id="alpha", state=pb.TILT_AMBIGUOUS, covariance=[0.5] * 36, leds=5, rms_px=0.0125, led=[3], spot=[0],
        residual_x=[0.01], residual_y=[-0.02],
    )  # fmt: skip
    robot.pose.position.z = 1.5
    robot.pose.orientation.w = 1.0
    robot.alternative.pose.orientation.x = 1.0
    robot.alternative.odds = 3.5
    robot.points["tool"].z = 1.47
    robot.points["lamp"].x = 0.5
    message.robots.add(id="bravo", state=pb.LOST, reason="its constellation is not among the spots")
    message.learned.led_misfit.extend([0.00025, 0.0])
    return message


def followed_report() -> "pb.FrameReport":
    """A frame of a rig whose camera is followed."""
    message = frame_report()
    message.frame_id = "world"
    message.camera.pose.position.z = 1.3
    message.camera.pose.orientation.x = 1.0
    message.camera.covariance.extend([0.25] * 36)
    message.camera.noise.extend([0.125] * 36)
    message.camera.seen_ns = EXPOSED_NS
    return message


def smoothed_report() -> "pb.FrameReport":
    """A frame of a server that smooths."""
    message = frame_report()
    robot = message.robots[0]
    robot.smoothed_by = SMOOTHED_POSE.smoothed_by
    robot.velocity.linear.x, robot.velocity.angular.z = 0.125, -0.5
    robot.velocity.linear.SetInParent()
    robot.velocity.covariance.extend([0.0625] * 36)
    return message


def status() -> "pb.Status":
    """A second of a server's life."""
    return pb.Status(
        time_ns=EXPOSED_NS, source="sim", frames=600, frames_dropped=1, rate_hz=60.0, solve_p50_s=0.002,
        solve_p99_s=0.004, latency_p50_s=0.003, latency_p99_s=0.006, rejected={"TOO_SMALL": 4, "ELONGATED": 2},
        robots={"TRACKED": 4, "LOST": 1}, messages_not_recorded=3, session=SESSION,
    )  # fmt: skip


def beat() -> "pb.Beat":
    """A server's sign of life."""
    return pb.Beat(session=SESSION, sequence=7, time_ns=EXPOSED_NS, monotonic_ns=98_765_432_109, rate=1.0)


def event() -> "pb.Event":
    """A robot was lost, after it had come and gone once more than was told."""
    return pb.Event(
        robot="bravo", happening=pb.STATE_CHANGED, before=pb.TRACKED, state=pb.LOST, since_ns=EXPOSED_NS,
        reason="its constellation is not among the spots", lasted_s=12.5, sequence=42, session=SESSION, number=7,
        left_out=2, published_ns=EXPOSED_NS + 4_000_000,
    )  # fmt: skip


def coverage() -> "pb.Coverage":
    """What changed of two patches in a second, of one robot."""
    message = pb.Coverage(
        session=SESSION, since_ns=EXPOSED_NS - 60_000_000_000, exposed_ns=EXPOSED_NS, x0=-0.125, y0=-0.25,
        pitch=0.0025, columns=100, rows=200,
    )  # fmt: skip
    message.frame.position.z, message.frame.orientation.w = 0.5, 1.0
    message.robots.add(
        robot="alpha", patch=[512, 513], dwell_s=[0.5, 0.25], passes=[2, 1], speed=[0.0625, 0.125],
        direction=[0.5, -1.5], last_ns=[EXPOSED_NS, EXPOSED_NS - 16_666_667], left_out={"lifted": 3, "gap": 1},
        radius=0.01, counted=3600, counted_s=59.5,
    )  # fmt: skip
    return message


def rig_report() -> "pb.RigReport":
    """A reply: the rig, and who answers."""
    message = decode_rig(encode_rig(RIG))
    message.version = "0.2.0"
    message.MergeFrom(
        pb.RigReport(host="bench", pid=4711, session=SESSION, started_ns=EXPOSED_NS, time_ns=EXPOSED_NS, rate=1.0)
    )
    return message


def golden() -> dict[str, tuple[bytes, type[Message]]]:
    """Name -> bytes and message type of every golden file."""
    from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
    from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
    from foxglove_schemas_protobuf.Odometry_pb2 import Odometry

    transforms = [("world", "alpha", ROBOT_POSE.pose), ("alpha", "alpha/tool", Pose.identity())]
    return {
        "odometry": (encode_odometry(ROBOT_POSE), Odometry),
        "odometry_smoothed": (encode_odometry(SMOOTHED_POSE), Odometry),
        "frame_report": (to_bytes(frame_report()), pb.FrameReport),
        "frame_report_followed": (to_bytes(followed_report()), pb.FrameReport),
        "frame_report_smoothed": (to_bytes(smoothed_report()), pb.FrameReport),
        "status": (to_bytes(status()), pb.Status),
        "event": (to_bytes(event()), pb.Event),
        "coverage": (to_bytes(coverage()), pb.Coverage),
        "beat": (to_bytes(beat()), pb.Beat),
        "rig_report": (to_bytes(rig_report()), pb.RigReport),
        "transforms": (encode_transforms(EXPOSED_NS, transforms), FrameTransforms),
        "calibration": (encode_calibration(EXPOSED_NS, CAMERA), CameraCalibration),
    }


def as_json(payload: bytes, kind: type[Message]) -> str:
    """What the bytes mean, for people and for programs in other languages."""
    message = kind()
    message.ParseFromString(payload)
    return MessageToJson(message, preserving_proto_field_name=True, sort_keys=True) + "\n"


if __name__ == "__main__":
    GOLDEN.mkdir(parents=True, exist_ok=True)
    for name, (payload, kind) in golden().items():
        (GOLDEN / f"{name}.bin").write_bytes(payload)
        (GOLDEN / f"{name}.json").write_text(as_json(payload, kind))
