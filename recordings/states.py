"""What state a robot is in, as it is drawn, and in which colour."""

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.messages import Standing, State

Colour = tuple[int, int, int]
TRACKED = State.Name(State.TRACKED)
_OF_LIGHT: dict[str, Colour] = {
    TRACKED: (46, 158, 79),
    State.Name(State.TILT_AMBIGUOUS): (224, 176, 32),
    State.Name(State.IDENTITY_AMBIGUOUS): (176, 80, 192),
    State.Name(State.LOST): (208, 64, 64),
}
# Of robots that stand on a surface by the rig, but not in this frame.
_OF_STANDING: dict[str, Colour] = {
    Standing.Name(Standing.LIFTED): (235, 130, 40),
    Standing.Name(Standing.SUNK): (215, 80, 130),
    Standing.Name(Standing.TILTED): (160, 120, 230),
    Standing.Name(Standing.BEYOND): (130, 145, 165),
}
STATE_COLOURS = _OF_LIGHT | {
    f"{state}, {standing}": colour for state in _OF_LIGHT for standing, colour in _OF_STANDING.items()
}


def state_of(robot: "pb.RobotReport") -> str:
    """Its state, and how it contradicts the surface where it does: the keys of `STATE_COLOURS`."""
    state = State.Name(robot.state)
    standing = Standing.Name(robot.surface.standing)
    return f"{state}, {standing}" if standing in _OF_STANDING else state
