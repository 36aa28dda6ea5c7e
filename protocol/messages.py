"""Messages as every sink gets them: a key, a payload, three numbers; and the table of what they are.

One FrameResult becomes some of these once; they are published, recorded and replayed byte for byte.
"""

from dataclasses import dataclass, field

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.geometry import Floats, Pose

State = pb.State
Fate = pb.Fate
Clock = pb.Clock
Happening = pb.Happening
Standing = pb.Standing

PROTOCOL = 2  # of these messages, told by every rig reply and recording; a message that tells none is of 1


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of message: its protobuf schema, and whether it goes over the network or only into recordings."""

    schema: str
    on_wire: bool

    @property
    def encoding(self) -> str:
        """The zenoh encoding."""
        return f"application/protobuf;{self.schema}"


ODOMETRY = Kind("foxglove.Odometry", on_wire=True)
FRAME_REPORT = Kind("asterism.FrameReport", on_wire=True)
STATUS = Kind("asterism.Status", on_wire=True)
EVENT = Kind("asterism.Event", on_wire=True)
COVERAGE = Kind("asterism.Coverage", on_wire=True)
BEAT = Kind("asterism.Beat", on_wire=True)
RIG_REPORT = Kind("asterism.RigReport", on_wire=True)
TRANSFORMS = Kind("foxglove.FrameTransforms", on_wire=False)
ANNOTATIONS = Kind("foxglove.ImageAnnotations", on_wire=False)
CALIBRATION = Kind("foxglove.CameraCalibration", on_wire=False)
IMAGE = Kind("foxglove.RawImage", on_wire=False)
UNNUMBERED = frozenset({STATUS.schema, COVERAGE.schema})  # their numbers are not those of frames


@dataclass(frozen=True, slots=True)
class Message:
    """One message. Times are ns since the Unix epoch; ``log_ns`` is the mid-exposure of what it tells about.

    ``publish_ns`` is 0 until the message goes out: `codec.stamped` enters it, there and in the payload.
    """

    key: str
    kind: Kind
    payload: bytes
    log_ns: int
    publish_ns: int
    sequence: int


@dataclass(frozen=True, slots=True, eq=False)
class Velocity:
    """How a robot moves, in its own frame: what foxglove.Odometry calls its twist.

    ``linear`` (3,) m/s, of the robot's origin; ``angular`` (3,) rad/s; ``covariance`` (6, 6) of both.
    ``accelerations`` are what the filter takes for possible: power spectral densities of white acceleration, m^2/s^3,
    and of the turn's, rad^2/s^3.
    """

    linear: Floats
    angular: Floats
    covariance: Floats
    accelerations: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class RobotPose:
    """One robot in one frame, as its odometry message tells it.

    ``pose`` is T_<frame_id>_<robot>; ``covariance`` (6, 6) in m and rad: x, y, z, rotation about x, y, z of the
    parent frame; ``state`` is TRACKED or TILT_AMBIGUOUS; ``smoothed_by`` names the filter that joined the pose to those
    of frames before, empty where the pose rests on this frame alone: only that filter knows a ``velocity``;
    ``extrapolated``: the rig corrects Z, but no surveyed pose was near, so the correction is faded or cut off;
    ``session`` is the server's, 0 where frames were solved again; ``published_ns`` 0 where it did not go out;
    ``cameras`` names those it rests on, where several are joined; ``standing`` says of a robot that by the rig stands
    on the surface whether that is part of what the pose rests on (ON_SURFACE) or why not (`Standing`), else empty.
    """

    robot: str
    frame_id: str
    pose: Pose
    covariance: Floats
    state: str
    leds: int
    rms_px: float
    sequence: int
    exposed_ns: int
    published_ns: int
    session: int = field(default=0, kw_only=True)
    smoothed_by: str = field(default="", kw_only=True)
    extrapolated: bool = field(default=False, kw_only=True)
    velocity: Velocity | None = field(default=None, kw_only=True)
    cameras: tuple[str, ...] = field(default=(), kw_only=True)
    standing: str = field(default="", kw_only=True)

    @property
    def position(self) -> Floats:
        """(3,) m, of the robot's origin in frame_id."""
        return self.pose.position

    @property
    def orientation(self) -> Floats:
        """(4,) x y z w, of the robot in frame_id."""
        return self.pose.orientation
