"""Moving robots with known poses, seen by a rolling shutter, followed from frame to frame."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from asterism.protocol.capture import Capture
from asterism.protocol.geometry import Floats, Pose, exp_rotation, log_rotation
from asterism.protocol.rig import Rig
from asterism.server import Frame, Lost, PoseEstimate, Tracks, localize
from asterism.server.simulation.simulate import Look, Scene, Truth
from tests.chain.frames import poses_apart

PERIOD_S = 1.0 / 60.0
Motion = Callable[[float], Pose]


def straight(start: Pose, velocity: Floats, turn: Floats, _: float) -> Motion:
    """Velocity and turn stay the same."""
    return lambda t: Pose.from_matrix(exp_rotation(turn * t) @ start.rotation, start.position + velocity * t)


def driving(start: Pose, velocity: Floats, turn: Floats, _: float) -> Motion:
    """The velocity turns with the robot; summed up in 200 small steps a second."""

    def at(t: float) -> Pose:
        steps = max(1, round(abs(t) * 200))
        h = t / steps
        gone = sum((h * exp_rotation(turn * (k + 0.5) * h) @ velocity for k in range(steps)), np.zeros(3))
        return Pose.from_matrix(exp_rotation(turn * t) @ start.rotation, start.position + gone)

    return at


def swinging(start: Pose, velocity: Floats, turn: Floats, pulse: float) -> Motion:
    """To and fro, fastest at first, ``pulse`` rad/s."""

    def at(t: float) -> Pose:
        gone = np.sin(pulse * t) / pulse
        return Pose.from_matrix(exp_rotation(turn * gone) @ start.rotation, start.position + velocity * gone)

    return at


KINDS = {"straight": straight, "driving": driving, "swinging": swinging}


def motions(rig: Rig, kind: str, rng: np.random.Generator, speed: float, spin: float) -> dict[str, Motion]:
    """How the robots move, at ``speed`` m/s and ``spin`` rad/s; they turn mostly about their normals."""
    found = {}
    for name, pose in poses_apart(rig, rng, tilt_deg=(5.0, 45.0)).items():
        velocity = rng.normal(size=3) * [1.0, 1.0, 0.3]
        velocity *= speed / np.linalg.norm(velocity)
        turn = pose.rotation @ (rng.normal(size=3) * [0.2, 0.2, 1.0])
        turn *= spin / np.linalg.norm(turn)
        found[name] = KINDS[kind](pose, velocity, turn, 2 * np.pi * rng.uniform(1.0, 3.0))
    return found


@dataclass(frozen=True, slots=True, eq=False)
class Told:
    """What was found of a robot in a frame of a sequence."""

    index: int
    answer: PoseEstimate | Lost
    true: Pose

    @property
    def error(self) -> Floats:
        """(6,) error of position (m) and rotation vector (rad)."""
        assert isinstance(self.answer, PoseEstimate)
        turned = log_rotation(self.answer.pose.rotation @ self.true.rotation.T)
        return np.concatenate([self.answer.position - self.true.position, turned])

    @property
    def nees(self) -> float:
        """Squared error weighted by the covariance."""
        assert isinstance(self.answer, PoseEstimate)
        return float(self.error @ np.linalg.solve(self.answer.covariance, self.error))


def followed(rig: Rig, moving: dict[str, Motion], frames: int, seed: int = 0, told: bool = True) -> list[Told]:
    """The robots in successive frames around mid-sequence, rendered as the rig's shutter sees them.

    ``told``: the chain knows of the shutter.
    """
    scene = Scene(rig, seed, Look(brightness=180.0))
    known = rig if told else replace(rig, capture=Capture())
    tracks, found = Tracks.none(), []
    for index in range(frames):
        time = (index - frames / 2) * PERIOD_S
        truth = [_truth(robot.id, moving[robot.id], time) for robot in rig.robots]
        image = scene.render(index, truth)
        result, tracks = localize(Frame(image, 1 + round(index * PERIOD_S * 1e9), index), known, tracks)
        found += [Told(index, result.answers[entry.robot], entry.T_camera_robot) for entry in truth]
    return found


def _truth(name: str, motion: Motion, time_s: float) -> Truth:
    return Truth(name, motion(time_s), (True,) * 6, lambda later: motion(time_s + later))
