"""The cameras that are joined, each as its rig has it, and the robots that they share."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig, Robot
from asterism.server.pose.lens import lens_of
from asterism.server.pose.spot_shift import optics_of


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """One camera: its rig, its lens (13,) as `pose.lens` takes it, and by each robot's id what shifts its spots, as
    `pose.spot_shift.optics_of`.

    ``place_covariance`` (6, 6), m and rad about the world's axes: how well T_world_camera is known; zero where nothing
    says so.
    """

    rig: Rig
    place_covariance: Floats = field(default_factory=lambda: np.zeros((6, 6)))
    lens: Floats = field(init=False)
    optics: dict[str, Floats] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "lens", lens_of(self.rig.camera))
        object.__setattr__(self, "optics", {robot.id: optics_of(robot) for robot in self.rig.robots})

    @property
    def camera(self) -> str:
        """Its name."""
        return self.rig.camera.name

    @property
    def T_world_camera(self) -> Pose:
        """Where the rig has it."""
        assert self.rig.T_world_camera is not None
        return self.rig.T_world_camera


@dataclass(frozen=True, slots=True, eq=False)
class Fleet:
    """Cameras by their names, and all their robots by their ids: what is one in two rigs is the same in both."""

    views: dict[str, View]
    robots: dict[str, Robot]

    @staticmethod
    def of(views: Sequence[View]) -> "Fleet":
        """Of cameras that fit together."""
        robots = {robot.id: robot for view in reversed(views) for robot in view.rig.robots}
        return Fleet({view.camera: view for view in views}, robots)
