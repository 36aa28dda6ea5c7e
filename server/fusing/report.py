"""Fused -> messages, as `chain.report` makes them of a camera's frame: what is published is what is recorded."""

import json
from collections.abc import Iterator
from typing import NamedTuple

from asterism import __version__
from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import encode_odometry, set_report_pose, set_vector, to_bytes
from asterism.protocol.messages import FRAME_REPORT, ODOMETRY, PROTOCOL, Message, RobotPose
from asterism.protocol.rig import Robot
from asterism.server.fusing.fleet import Fleet
from asterism.server.fusing.fused import Fused, FusedPose

WORLD = "world"  # the frame of all fused poses


class Told(NamedTuple):
    """What an exposure's messages say beside its poses: its number, the session of who fuses (0: nobody publishes it),
    when the newest report of it was there and when the poses were known, ns since the epoch, and whose clock it has.
    """

    sequence: int
    session: int = 0
    arrived_ns: int = 0
    solved_ns: int = 0
    clock: "pb.Clock" = pb.CLOCK_UNSPECIFIED


def report(fused: Fused, fleet: Fleet, told: Told) -> Iterator[Message]:
    """The messages of one exposure: odometry of every robot that was located, then the frame report; each is encoded
    when it is asked for, and stamped when it goes out (`codec.stamped`).
    """
    for robot, answer in fused.answers.items():
        if isinstance(answer, FusedPose):
            pose = RobotPose(
                robot=robot,
                frame_id=WORLD,
                pose=answer.pose,
                covariance=answer.covariance,
                state=answer.state,
                leds=answer.leds,
                rms_px=answer.rms_px,
                sequence=told.sequence,
                exposed_ns=fused.exposed_ns,
                published_ns=0,
                session=told.session,
                cameras=answer.cameras,
            )
            key, payload = keys.odometry(keys.FUSED, robot), encode_odometry(pose)
            yield Message(key, ODOMETRY, payload, fused.exposed_ns, 0, told.sequence)
    payload = to_bytes(frame_report(fused, fleet, told))
    yield Message(keys.frame(keys.FUSED), FRAME_REPORT, payload, fused.exposed_ns, 0, told.sequence)


def frame_report(fused: Fused, fleet: Fleet, told: Told) -> "pb.FrameReport":
    """Everything that was concluded of one exposure; it has no spots."""
    message = pb.FrameReport(
        sequence=told.sequence,
        exposed_ns=fused.exposed_ns,
        arrived_ns=told.arrived_ns or fused.exposed_ns,
        solved_ns=told.solved_ns or fused.exposed_ns,
        session=told.session,
        clock=told.clock,
        frame_id=WORLD,
        cameras=fused.cameras,
    )
    message.spots.SetInParent()
    for robot, answer in fused.answers.items():
        entry = message.robots.add(id=robot, state=pb.State.Value(answer.state))
        if isinstance(answer, FusedPose):
            _enter(entry, answer, fleet.robots[robot])
        else:
            entry.reason = answer.reason
    return message


def _enter(entry: "pb.RobotReport", answer: FusedPose, robot: Robot) -> None:
    set_report_pose(entry.pose, answer.pose)
    entry.covariance.extend(answer.covariance.ravel().tolist())
    entry.leds, entry.rms_px = answer.leds, answer.rms_px
    if answer.alternative is not None:
        set_report_pose(entry.alternative.pose, answer.alternative.pose)
        entry.alternative.odds = answer.alternative.odds
    for name, point in robot.points.items():
        set_vector(entry.points[name], answer.pose.map(point))
    entry.cameras.extend(answer.cameras)
    for camera, why in answer.left_out.items():
        entry.left_out[camera] = why


def rig_report(fleet: Fleet) -> "pb.RigReport":
    """What `fused` answers for: the fleet's robots, in the world. There is no image and no lens.

    The texts are those of a rig whose camera stands for none, so that what listens can record and read it as one.
    """
    message = pb.RigReport(
        camera=keys.FUSED,
        frame_id=WORLD,
        rig_yaml=rig_text(fleet),
        camera_yaml=CAMERA_TEXT,
        version=__version__,
        protocol=PROTOCOL,
    )
    for robot in fleet.robots.values():
        entry = message.robots.add(id=robot.id)
        for led in robot.leds:
            set_vector(entry.leds.add(), led)
        set_vector(entry.axis, robot.axis)
        for name, point in robot.points.items():
            set_vector(entry.points[name], point)
    return message


CAMERA_TEXT = f"""\
# No camera: the poses of several are joined, in the world. These numbers stand for none, and nothing is seen by them.
camera_name: {keys.FUSED}
image_width: 640
image_height: 480
camera_matrix: {{rows: 3, cols: 3, data: [640, 0, 319.5, 0, 640, 239.5, 0, 0, 1]}}
distortion_model: plumb_bob
distortion_coefficients: {{rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}}
"""


def rig_text(fleet: Fleet) -> str:
    """A rig.yaml of the fleet's robots, in the world."""
    robots = "\n".join(f"  {json.dumps(robot.id)}: {json.dumps(rig_words(robot))}" for robot in fleet.robots.values())
    names = ", ".join(fleet.views)
    return (
        f"# Cameras joined by asterism fuse: {names}. Their own rigs tell of their lenses and places.\n"
        "camera: camera.yaml\n"
        "world: {position: [0, 0, 0], orientation: [0, 0, 0, 1]}\n"
        f"robots:\n{robots}\n"
    )


def rig_words(robot: Robot) -> dict[str, object]:
    """A robot as a rig has it, but for what only cameras need to know of its LEDs."""
    words: dict[str, object] = {"leds": robot.leds.tolist(), "led": {"axis": robot.axis.tolist()}}
    if robot.points:
        words["points"] = {name: point.tolist() for name, point in robot.points.items()}
    if (fixed := robot.T_world_fixed) is not None:
        words["fixed"] = {"position": fixed.position.tolist(), "orientation": fixed.orientation.tolist()}
    return words
