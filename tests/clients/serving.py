"""A publisher of poses for a client to listen to, in the same process."""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from asterism.protocol import keys
from asterism.protocol.codec import encode_odometry, encode_rig
from asterism.protocol.messages import ODOMETRY, Message, RobotPose
from asterism.protocol.network import open_server
from asterism.server.service.on_air import OnAir
from asterism.server.service.publish import Clock, Publisher
from asterism.server.sources.session_clock import SessionClock
from tests.protocol.make_golden import RIG, ROBOT_POSE

COVARIANCE = np.diag([1e-10, 1e-10, 1e-8, 1e-6, 1e-6, 1e-8])


class Server:
    """A publisher at an endpoint; what it tells was exposed ``age_s`` ago by its own clock."""

    def __init__(self, endpoint: str, prefix: str = "", clock: Clock | None = None) -> None:
        self.endpoint = endpoint
        self.session = open_server(endpoint)
        self.clock = clock or SessionClock()
        self.publisher = Publisher(self.session, "cam", encode_rig(RIG), self.clock, prefix)

    def pose(self, age_s: float = 0.0, **changes: Any) -> RobotPose:
        """A pose as it is now, with some of its values changed."""
        now = replace(
            ROBOT_POSE,
            covariance=COVARIANCE,
            exposed_ns=self.clock.now_ns() - round(age_s * 1e9),
            published_ns=0,
            session=self.clock.session,
        )
        return replace(now, **changes)

    def tell(self, age_s: float = 0.0, **changes: Any) -> None:
        """Publish a pose."""
        told = self.pose(age_s, **changes)
        key = keys.odometry("cam", told.robot)
        self.publisher.publish([Message(key, ODOMETRY, encode_odometry(told), told.exposed_ns, 0, told.sequence)])

    def put(self, payload: bytes, robot: str = "alpha") -> None:
        """Put bytes where a pose belongs."""
        self.publisher.put(Message(keys.odometry("cam", robot), ODOMETRY, payload, 0, 0, 0))

    def close(self) -> None:
        self.publisher.close()


def until(condition: Callable[[], object], timeout_s: float = 20.0) -> None:
    """Wait for a condition that another process' or thread's message brings about."""
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, "it did not come about"
        time.sleep(0.002)


def tell(air: OnAir, robot: str = "alpha", camera: str = "cam") -> None:
    """A pose of that robot, as it is now."""
    clock = air.publisher.clock
    now = replace(
        ROBOT_POSE,
        robot=robot,
        covariance=COVARIANCE,
        exposed_ns=clock.now_ns(),
        published_ns=0,
        session=clock.session,
    )
    air.publisher.publish([Message(keys.odometry(camera, robot), ODOMETRY, encode_odometry(now), 0, 0, 42)])
