"""An event as a person reads it, and whether it is bad news."""

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.messages import State

_LOCATED = (pb.TRACKED, pb.TILT_AMBIGUOUS)


def is_loss(event: "pb.Event") -> bool:
    """Whether no pose comes any more: a robot is not located, or no frame comes."""
    if event.happening == pb.STATE_CHANGED:
        return event.state not in _LOCATED
    return event.happening == pb.FRAMES_STOPPED


def sentence(event: "pb.Event") -> str:
    """Such as: bravo: LOST (TRACKED for 12.5 s before): its constellation is not among the spots."""
    if not event.robot:
        return event.reason
    text = f"{event.robot}: {_word(event.state)}"
    if event.before and event.left_out:
        changes = f"{event.left_out} change{'s' * (event.left_out > 1)}"
        text += f" ({_word(event.before)} {event.lasted_s:.3g} s before, {changes} between)"
    elif event.before:
        text += f" ({_word(event.before)} for {event.lasted_s:.3g} s before)"
    return f"{text}: {event.reason}" if event.reason else text


def _word(state: "pb.State") -> str:
    return State.Name(state).replace("_", " ") if state else "not in the rig"
