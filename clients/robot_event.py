"""What happened, as it arrived: a robot was lost or found, frames stopped or came again, another rig is in force."""

from dataclasses import dataclass, field

from asterism.clients.age import SessionAge
from asterism.clients.received_pose import clock_ns
from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.event_text import is_loss, sentence
from asterism.protocol.messages import Happening, State


@dataclass(frozen=True, slots=True, eq=False)
class RobotEvent:
    """One event of a camera. ``robot`` is empty where it is of all its robots: frames, the rig.

    ``happening`` is STATE_CHANGED, FRAMES_STOPPED, FRAMES_CAME, RIG_READ or RIG_REFUSED; ``before`` and ``state`` are
    the robot's states, STATE_UNSPECIFIED where there is none; ``reason`` why there is no pose, or what happened, empty
    where a pose was found; ``since_ns`` mid-exposure of the first frame of which it is true, which is number
    ``sequence``; ``lasted_s`` how long it was as before; ``left_out`` changes between the event before and this one
    that were not told; ``lost``: no pose comes from now on; ``sentence`` says it all.
    """

    camera: str
    robot: str
    happening: str
    before: str
    state: str
    reason: str
    since_ns: int
    lasted_s: float
    sequence: int
    session: int
    number: int
    left_out: int
    lost: bool
    sentence: str
    clock: SessionAge = field(repr=False)

    @property
    def age_s(self) -> float:
        """Time since ``since_ns``, s, by the server's clock as this machine knows it; infinite while it knows none."""
        return self.clock.age_s(clock_ns(), self.since_ns)


def arrived(event: "pb.Event", camera: str, clock: SessionAge) -> RobotEvent:
    """The event of a message, which was looked at (`codec.decode_event`)."""
    return RobotEvent(
        camera=camera,
        robot=event.robot,
        happening=Happening.Name(event.happening),
        before=State.Name(event.before),
        state=State.Name(event.state),
        reason=event.reason,
        since_ns=event.since_ns,
        lasted_s=event.lasted_s,
        sequence=event.sequence,
        session=event.session,
        number=event.number,
        left_out=event.left_out,
        lost=is_loss(event),
        sentence=sentence(event),
        clock=clock,
    )
