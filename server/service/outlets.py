"""Where messages go beside the network and the recording: viewers, ROS, other programs' protocols."""

from typing import Protocol

from asterism.protocol.messages import Message
from asterism.protocol.rig import Rig
from asterism.server.chain.frame import Frame


class Outlet(Protocol):
    """One more way out. It is called from the chain's own thread but for `between`, and must not hold it up: what takes
    longer than some 0.1 ms belongs in a thread of its own (`threads.Newest`).
    """

    def write(self, messages: list[Message], frame: Frame) -> None:
        """What was published of this frame, as it went out: odometry of every robot that was located, the frame
        report, then events.
        """

    def between(self, messages: list[Message]) -> None:
        """What was published between frames, from any thread: the server's health once a second, events."""

    def take_rig(self, rig: Rig) -> None:
        """Another rig is in force for the frames from now on."""

    def close(self) -> None:
        """Nothing more comes."""
