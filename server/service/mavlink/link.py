"""One flight controller: what is sent to it of its robot, and what it asks."""

import logging
import socket
import threading

import numpy as np

from asterism.protocol.messages import RobotPose
from asterism.protocol.rig import Rig
from asterism.server.service.mavlink import wire
from asterism.server.service.mavlink.aircraft_frames import (
    covariance_down,
    orientation_down,
    position_down,
    velocity_covariance_down,
    velocity_down,
)

_LOG = logging.getLogger(__name__)

LONG_LOST_NS = 1_000_000_000  # who was not seen for so long was identified anew
QUALITY = {"TRACKED": 100, "TILT_AMBIGUOUS": 10}  # percent; 1 is the worst, 0 says nothing
LONGEST = 280  # bytes of a MAVLink 2 message at most
_UNKNOWN = np.full(6, np.nan)


class Link:
    """Sends to one socket. ``system`` is the robot's in MAVLink. `answer` may be called from another thread."""

    def __init__(self, robot: str, system: int, to: socket.socket) -> None:
        self.robot = robot
        self.to = to
        self.unsent = 0
        self._system = system
        self._sequence = 0
        self._sending = threading.Lock()
        self._resets = 0
        self._last: tuple[int, Rig, int] | None = None  # session, rig, exposed_ns

    def pose(self, told: RobotPose, rig: Rig) -> None:
        """Send where the robot is; ``rig`` is the one in force."""
        if self._last is not None:
            session, before, last_ns = self._last
            lost = told.exposed_ns - last_ns > LONG_LOST_NS
            self._resets += session != told.session or before is not rig or lost
        self._last = (told.session, rig, told.exposed_ns)
        self._send(wire.ODOMETRY, message_of(told, self._resets).payload())

    def alive(self) -> None:
        """Send a heartbeat: routers learn from it who is here."""
        self._send(wire.HEARTBEAT, wire.HEARTBEAT.fields.pack(*wire.ALIVE))

    def answer(self, now_ns: int) -> None:
        """Take in what has come, and answer a question for the time (TIMESYNC) with ``now_ns`` since the epoch.

        Raises OSError where nothing has come.
        """
        try:
            asked = wire.unframed(wire.TIMESYNC, self.to.recv(LONGEST))
        except ConnectionRefusedError:  # of what was sent before
            return
        if asked is not None and asked[0] == 0:
            self._send(wire.TIMESYNC, wire.TIMESYNC.fields.pack(now_ns, asked[1]))

    def _send(self, kind: wire.Kind, payload: bytes) -> None:
        with self._sending:
            datagram = wire.framed(kind, payload, self._sequence, self._system)
            self._sequence = (self._sequence + 1) & 0xFF
        try:
            try:
                self.to.send(datagram)
            except ConnectionRefusedError:  # nobody listened when the one before came; this one did not go out yet
                self.to.send(datagram)
        except ConnectionRefusedError:
            pass
        except OSError as error:
            if not self.unsent:
                _LOG.warning("MAVLink for %s could not be sent (%s); it is tried again", self.robot, error.strerror)
            self.unsent += 1


def message_of(told: RobotPose, resets: int) -> wire.Odometry:
    """A pose in a world with z up as a flight controller takes it."""
    velocity, velocity_covariance = _UNKNOWN, np.full((6, 6), np.nan)
    if told.velocity is not None:
        velocity = velocity_down(told.velocity.linear, told.velocity.angular)
        velocity_covariance = velocity_covariance_down(told.velocity.covariance)
    return wire.Odometry(
        time_us=told.exposed_ns // 1000,
        position=position_down(told.pose),
        orientation=orientation_down(told.pose),
        covariance=covariance_down(told.pose, told.covariance),
        velocity=velocity,
        velocity_covariance=velocity_covariance,
        resets=resets,
        quality=QUALITY[told.state],
    )
