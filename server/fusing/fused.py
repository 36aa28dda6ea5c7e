"""What fusing says of an exposure: a pose of every robot that the cameras see, or why there is none."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from asterism.protocol.geometry import Floats, Pose
from asterism.server.pose.solve import Alternative, Lost


@dataclass(frozen=True, slots=True, eq=False)
class FusedPose:
    """A robot's pose at an exposure: ``pose`` T_world_robot, its ``covariance`` (6, 6), m and rad: x, y, z, rotation
    about x, y, z of the world.

    ``cameras`` names those it rests on; ``left_out`` those that see the robot, but contradict the others, and says by
    how much. ``leds`` is how many of its LEDs any of the cameras saw, ``rms_px`` the root mean square of all residuals.
    """

    pose: Pose
    covariance: Floats
    cameras: tuple[str, ...]
    leds: int
    rms_px: float
    alternative: Alternative | None = None
    left_out: Mapping[str, str] = field(default_factory=dict)

    @property
    def state(self) -> str:
        """TRACKED or TILT_AMBIGUOUS."""
        return "TRACKED" if self.alternative is None else "TILT_AMBIGUOUS"


@dataclass(frozen=True, slots=True, eq=False)
class Fused:
    """All robots at one exposure of ``cameras``, those that exposed at exactly ``exposed_ns``; ``answers`` by the
    robots' ids, in the fleet's order.
    """

    exposed_ns: int
    cameras: tuple[str, ...]
    answers: Mapping[str, FusedPose | Lost]
