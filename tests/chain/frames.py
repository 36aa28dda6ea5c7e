"""Whole frames of robots with known poses, drawn by tests/centres/rendering.py, not by the product's simulator.

And what may be done to camera, rig and image together without changing what is true.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.camera import Camera
from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.protocol.rig import Rig
from asterism.server import Frame, FrameResult, PoseEstimate, Tracks, localize
from tests.centres.rendering import Canvas
from tests.helpers import facing_pose

LEVEL = 180.0  # grey levels of an LED seen head-on
RIM = 96  # points on the rim of an LED
MARGIN_PX = 90  # between the robots and the edge of the image, so that the image may be shifted


def disc_image(camera: Camera, centre: Floats, normal: Floats, radius: float) -> tuple[Floats, float, float, float]:
    """Centre (2,) px, semi-axes px and angle of the image of a disc: ``centre``, ``normal`` in the camera's frame, m.

    From its projected rim: the area's centroid (not the centre's image), and the rim's second moments.
    """
    u = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    u /= np.linalg.norm(u)
    angles = 2 * np.pi * np.arange(RIM) / RIM
    rim = camera.project(
        centre + radius * (np.outer(np.cos(angles), u) + np.outer(np.sin(angles), np.cross(normal, u)))
    )
    middle = rim.mean(axis=0)
    p = rim - middle
    q = np.roll(p, -1, axis=0)
    cross = p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]
    centroid = middle + (cross[:, None] * (p + q)).sum(axis=0) / (3 * cross.sum())
    variances, axes = np.linalg.eigh(np.cov(rim.T, bias=True))
    b, a = np.sqrt(2 * variances)
    return centroid, float(a), float(b), float(np.arctan2(axes[1, 1], axes[0, 1]))


def draw(
    rig: Rig, poses: Mapping[str, Pose], level: float = LEVEL,
    apparent: Callable[[Floats, Floats], Floats] | None = None,
) -> Canvas:  # fmt: skip
    """The light of robots at T_camera_robot on a dark background; LEDs dim with the cosine of the viewing angle.

    ``apparent`` says where an LED at (3,) with axis (3,), camera's frame, m, is seen; without it, where it is.
    """
    canvas = Canvas.of(rig.camera.height, rig.camera.width)
    for name, pose in poses.items():
        robot = rig.robot(name)
        normal = pose.rotation @ robot.T_robot_plane.rotation[:, 2]
        for led in pose.map(robot.leds):
            facing = -float(normal @ led) / float(np.linalg.norm(led))
            assert facing > 0, f"{name} shows its back"
            place = led if apparent is None else apparent(led, pose.rotation @ robot.axis)
            (x, y), a, b, angle = disc_image(rig.camera, place, normal, robot.led_radius or 0.0025)
            canvas.ellipse(float(x), float(y), a, b, angle, level=level * facing)
    return canvas


def poses_apart(
    rig: Rig, rng: np.random.Generator, names: list[str] | None = None,
    depth_m: tuple[float, float] = (1.0, 1.5), tilt_deg: tuple[float, float] = (15.0, 45.0),
) -> dict[str, Pose]:  # fmt: skip
    """Poses of the robots (of all, if none are named) that lie well inside the image and do not overlap there.

    Tilts are against the line of sight.
    """
    camera, focal = rig.camera, float(rig.camera.matrix[0, 0])
    poses: dict[str, Pose] = {}
    taken: list[tuple[Floats, float]] = []
    for name in names if names is not None else [robot.id for robot in rig.robots]:
        robot = rig.robot(name)
        while name not in poses:
            somewhere = facing_pose(rng, depth_m, tilt_deg)
            depth = somewhere.position[2]
            room = 0.62 * robot.extent / depth
            limit = (np.array([camera.width, camera.height]) / 2 - MARGIN_PX) / focal - room
            place = rng.uniform(-limit, limit)
            if all(np.abs(place - other).max() > room + wide for other, wide in taken):
                taken.append((place, room))
                position = depth * np.append(place, 1.0)
                pose = Pose.from_matrix(_between(somewhere.position, position) @ somewhere.rotation, position)
                poses[name] = pose @ robot.T_robot_plane.inverse()
    return poses


def _between(a: Floats, b: Floats) -> Floats:
    """The rotation (3, 3) about their common normal that turns one direction into the other."""
    axis = np.cross(a, b)
    length = np.linalg.norm(axis)
    return exp_rotation(axis / length * np.arctan2(length, a @ b))


def alone(image: NDArray[np.uint8], rig: Rig) -> FrameResult:
    """The frame located without memory."""
    return localize(Frame(image, exposed_ns=1, index=0), rig, Tracks.none())[0]


def estimates(result: FrameResult) -> dict[str, PoseEstimate]:
    """The robots that were located."""
    return {name: answer for name, answer in result.answers.items() if isinstance(answer, PoseEstimate)}


def turned_camera(camera: Camera, turn: NDArray[np.int64]) -> Camera:
    """The camera whose image is the old one moved by a signed permutation ``turn`` (2, 2) of its axes.

    Rays (x / z, y / z) move by the same matrix, since the radial distortion is the same in every direction and the
    tangential one, q r^2 + 2 v (q v) with q = (p2, p1), turns with q.
    """
    assert camera.model == "plumb_bob"
    swaps = bool(turn[0, 1])
    size = (camera.height, camera.width) if swaps else (camera.width, camera.height)
    focal = np.abs(turn) @ np.array([camera.matrix[0, 0], camera.matrix[1, 1]])
    origin = turn @ camera.matrix[:2, 2]
    origin += np.where(turn.sum(axis=1) < 0, np.array(size) - 1, 0)
    k1, k2, p1, p2, k3 = camera.distortion
    q = turn @ np.array([p2, p1])
    matrix = np.array([[focal[0], 0.0, origin[0]], [0.0, focal[1], origin[1]], [0.0, 0.0, 1.0]])
    return replace(camera, width=size[0], height=size[1], matrix=matrix, distortion=np.array([k1, k2, q[1], q[0], k3]))


def turned_image(image: NDArray[np.uint8], turn: NDArray[np.int64]) -> NDArray[np.uint8]:
    """The image moved by a signed permutation (2, 2) of its axes x, y."""
    out = image.T if turn[0, 1] else image
    signs = turn.sum(axis=1)
    return np.ascontiguousarray(out[:: int(signs[1]), :: int(signs[0])])
