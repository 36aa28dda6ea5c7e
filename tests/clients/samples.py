"""Messages as they arrive, without a network, and time that passes when it is told to."""

import numpy as np
import zenoh

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import set_report_pose
from asterism.protocol.geometry import Pose, exp_rotation
from tests.protocol import make_golden


class Sample:
    """As much of a zenoh sample as the table looks at."""

    def __init__(self, key: str, payload: bytes, alive: bool = True) -> None:
        self.key_expr = key
        self.kind = zenoh.SampleKind.PUT if alive else zenoh.SampleKind.DELETE
        self.payload = self
        self._payload = payload

    def to_bytes(self) -> bytes:
        return self._payload


class Clock:
    """Time that passes when it is told to, ns."""

    now = 1_000_000_000_000

    def __call__(self) -> int:
        return self.now

    def passes(self, seconds: float) -> None:
        self.now += round(1e9 * seconds)


def moving_report() -> "pb.FrameReport":
    """A robot turned by 90 degrees about the vertical, then tilted by 30, that moves."""
    report = make_golden.smoothed_report()
    tilted = exp_rotation(np.radians(30.0) * np.array([1.0, 0.0, 0.0])) @ exp_rotation(np.array([0.0, 0.0, np.pi / 2]))
    set_report_pose(report.robots[0].pose, Pose.from_matrix(tilted, np.zeros(3)))
    return report
