"""Several cameras about one floor: their rigs, robots that drive there, and what each camera sees of them."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig
from asterism.server.chain.frame import Frame
from asterism.server.chain.pipeline import localize
from asterism.server.chain.report import frame_report
from asterism.server.pose.track import Tracks
from asterism.server.simulation.simulate import Look, Scene, Truth
from tests.rigs import make_camera, make_rig

Poses = Mapping[str, Pose]  # T_world_robot by the robots' ids


def looking_at(eye: Floats, target: Floats, turn_rad: float = 0.0) -> Pose:
    """T_world_camera at ``eye`` (3,), its z towards ``target`` (3,), turned about it; not along the y axis."""
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    turn = np.array([[np.cos(turn_rad), -np.sin(turn_rad), 0], [np.sin(turn_rad), np.cos(turn_rad), 0], [0, 0, 1.0]])
    return Pose.from_matrix(np.column_stack([x, y, z]) @ turn, eye)


def rigs_at(places: Sequence[Pose], robots: int = 2, seed: int = 0) -> list[Rig]:
    """A rig for every camera, `left`, `right`, `third`, ..., with the same robots."""
    base = make_rig(robots, seed)
    names = ("left", "right", "third", "fourth", "fifth", "sixth")
    return [
        replace(base, camera=make_camera(name=name), T_world_camera=place)
        for name, place in zip(names, places, strict=False)
    ]


def facing_pair(degrees: float = 60.0, distance_m: float = 1.3) -> list[Pose]:
    """T_world_camera of two cameras whose axes meet in the world's origin under that angle."""
    half = np.radians(degrees) / 2
    return [
        looking_at(distance_m * np.array([side * np.sin(half), 0.0, np.cos(half)]), np.zeros(3), 0.3 * side)
        for side in (-1.0, 1.0)
    ]


@dataclass(frozen=True, slots=True)
class Drive:
    """Robots that drive in rounds on the floor, each with its own pace, and sway: where they are at a time, s."""

    robots: tuple[str, ...]
    seed: int = 0
    radius_m: float = 0.15
    speed: float = 0.12  # m/s
    tilt_rad: float = 0.15
    apart_m: float = 0.2

    def __call__(self, time_s: float) -> dict[str, Pose]:
        """T_world_robot of all."""
        rng = np.random.default_rng(self.seed)
        poses = {}
        for k, robot in enumerate(self.robots):
            phase = rng.uniform(0, 2 * np.pi, 5)
            rate = self.speed / self.radius_m * rng.uniform(0.6, 1.0)
            middle = self.apart_m * np.array([np.cos(2.4 * k), np.sin(2.4 * k)]) * (len(self.robots) > 1)
            a = phase[0] + rate * time_s
            x, y = middle + 0.5 * self.radius_m * np.array([np.cos(a), np.sin(0.8 * a + phase[1])])
            z = 0.05 * np.sin(phase[2] + 0.5 * a)
            yaw, roll, pitch = phase[3] + 0.7 * a, *(self.tilt_rad * np.sin(phase[3:] + np.array([0.6 * a, 0.9 * a])))
            turn = _about(2, yaw) @ _about(0, roll) @ _about(1, pitch)
            poses[robot] = Pose.from_matrix(turn, np.array([x, y, z]))
        return poses


def _about(axis: int, angle: float) -> Floats:
    turn = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    turn[i, i] = turn[j, j] = np.cos(angle)
    turn[j, i] = np.sin(angle)
    turn[i, j] = -turn[j, i]
    return turn


Lit = Callable[[str, str, int], tuple[bool, ...]]  # camera, robot, frame: which of its six LEDs it sees


def all_lit(camera: str, robot: str, frame: int) -> tuple[bool, ...]:
    """Every LED is seen by every camera."""
    return (True,) * 6


def frames_of(
    rig: Rig, drive: Callable[[float], Poses], times_ns: Iterable[int], lit: Lit = all_lit, look: Look | None = None,
    seed: int = 0,
) -> Iterator[Frame]:  # fmt: skip
    """What one camera shows at those times, of time 0 on; rendered from where it truly stands, ``rig``'s place."""
    assert rig.T_world_camera is not None
    scene, T_camera_world = Scene(rig, seed, look), rig.T_world_camera.inverse()
    for index, time_ns in enumerate(times_ns):
        poses = drive(time_ns * 1e-9)
        truth = [
            Truth(robot.id, T_camera_world @ poses[robot.id], lit(rig.camera.name, robot.id, index))
            for robot in rig.robots
        ]
        yield Frame(scene.render(index, truth), exposed_ns=time_ns, index=index)


def reports_of(frames: Iterable[Frame], rig: Rig) -> "Iterator[pb.FrameReport]":
    """The frame reports of the chain, by the rig that is believed."""
    tracks = Tracks.none()
    for frame in frames:
        result, tracks = localize(frame, rig, tracks)
        yield frame_report(frame, result, rig, frame.exposed_ns)
