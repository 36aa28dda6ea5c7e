from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Iterable as _Iterable, Mapping as _Mapping, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class State(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    STATE_UNSPECIFIED: _ClassVar[State]
    TRACKED: _ClassVar[State]
    TILT_AMBIGUOUS: _ClassVar[State]
    IDENTITY_AMBIGUOUS: _ClassVar[State]
    LOST: _ClassVar[State]

class Fate(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    FATE_UNSPECIFIED: _ClassVar[Fate]
    LED: _ClassVar[Fate]
    UNEXPLAINED: _ClassVar[Fate]
    TOO_SMALL: _ClassVar[Fate]
    TOO_LARGE: _ClassVar[Fate]
    ELONGATED: _ClassVar[Fate]
    AT_EDGE: _ClassVar[Fate]
    MASKED: _ClassVar[Fate]
    TOO_FAINT: _ClassVar[Fate]
    MISSHAPEN: _ClassVar[Fate]

class Clock(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    CLOCK_UNSPECIFIED: _ClassVar[Clock]
    CAMERA: _ClassVar[Clock]
    DRIVER: _ClassVar[Clock]
    ARRIVAL: _ClassVar[Clock]
    FILE: _ClassVar[Clock]
    PLAYED: _ClassVar[Clock]

class Standing(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    STANDING_UNSPECIFIED: _ClassVar[Standing]
    ON_SURFACE: _ClassVar[Standing]
    LIFTED: _ClassVar[Standing]
    SUNK: _ClassVar[Standing]
    TILTED: _ClassVar[Standing]
    BEYOND: _ClassVar[Standing]

class Happening(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    HAPPENING_UNSPECIFIED: _ClassVar[Happening]
    STATE_CHANGED: _ClassVar[Happening]
    FRAMES_STOPPED: _ClassVar[Happening]
    FRAMES_CAME: _ClassVar[Happening]
    RIG_READ: _ClassVar[Happening]
    RIG_REFUSED: _ClassVar[Happening]
STATE_UNSPECIFIED: State
TRACKED: State
TILT_AMBIGUOUS: State
IDENTITY_AMBIGUOUS: State
LOST: State
FATE_UNSPECIFIED: Fate
LED: Fate
UNEXPLAINED: Fate
TOO_SMALL: Fate
TOO_LARGE: Fate
ELONGATED: Fate
AT_EDGE: Fate
MASKED: Fate
TOO_FAINT: Fate
MISSHAPEN: Fate
CLOCK_UNSPECIFIED: Clock
CAMERA: Clock
DRIVER: Clock
ARRIVAL: Clock
FILE: Clock
PLAYED: Clock
STANDING_UNSPECIFIED: Standing
ON_SURFACE: Standing
LIFTED: Standing
SUNK: Standing
TILTED: Standing
BEYOND: Standing
HAPPENING_UNSPECIFIED: Happening
STATE_CHANGED: Happening
FRAMES_STOPPED: Happening
FRAMES_CAME: Happening
RIG_READ: Happening
RIG_REFUSED: Happening

class Vector3(_message.Message):
    __slots__ = ("x", "y", "z")
    X_FIELD_NUMBER: _ClassVar[int]
    Y_FIELD_NUMBER: _ClassVar[int]
    Z_FIELD_NUMBER: _ClassVar[int]
    x: float
    y: float
    z: float
    def __init__(self, x: _Optional[float] = ..., y: _Optional[float] = ..., z: _Optional[float] = ...) -> None: ...

class Quaternion(_message.Message):
    __slots__ = ("x", "y", "z", "w")
    X_FIELD_NUMBER: _ClassVar[int]
    Y_FIELD_NUMBER: _ClassVar[int]
    Z_FIELD_NUMBER: _ClassVar[int]
    W_FIELD_NUMBER: _ClassVar[int]
    x: float
    y: float
    z: float
    w: float
    def __init__(self, x: _Optional[float] = ..., y: _Optional[float] = ..., z: _Optional[float] = ..., w: _Optional[float] = ...) -> None: ...

class Pose(_message.Message):
    __slots__ = ("position", "orientation")
    POSITION_FIELD_NUMBER: _ClassVar[int]
    ORIENTATION_FIELD_NUMBER: _ClassVar[int]
    position: Vector3
    orientation: Quaternion
    def __init__(self, position: _Optional[_Union[Vector3, _Mapping]] = ..., orientation: _Optional[_Union[Quaternion, _Mapping]] = ...) -> None: ...

class Spots(_message.Message):
    __slots__ = ("x", "y", "covariance_xx", "covariance_xy", "covariance_yy", "brightness", "radius", "fate", "robot", "led")
    X_FIELD_NUMBER: _ClassVar[int]
    Y_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_XX_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_XY_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_YY_FIELD_NUMBER: _ClassVar[int]
    BRIGHTNESS_FIELD_NUMBER: _ClassVar[int]
    RADIUS_FIELD_NUMBER: _ClassVar[int]
    FATE_FIELD_NUMBER: _ClassVar[int]
    ROBOT_FIELD_NUMBER: _ClassVar[int]
    LED_FIELD_NUMBER: _ClassVar[int]
    x: _containers.RepeatedScalarFieldContainer[float]
    y: _containers.RepeatedScalarFieldContainer[float]
    covariance_xx: _containers.RepeatedScalarFieldContainer[float]
    covariance_xy: _containers.RepeatedScalarFieldContainer[float]
    covariance_yy: _containers.RepeatedScalarFieldContainer[float]
    brightness: _containers.RepeatedScalarFieldContainer[float]
    radius: _containers.RepeatedScalarFieldContainer[float]
    fate: _containers.RepeatedScalarFieldContainer[Fate]
    robot: _containers.RepeatedScalarFieldContainer[int]
    led: _containers.RepeatedScalarFieldContainer[int]
    def __init__(self, x: _Optional[_Iterable[float]] = ..., y: _Optional[_Iterable[float]] = ..., covariance_xx: _Optional[_Iterable[float]] = ..., covariance_xy: _Optional[_Iterable[float]] = ..., covariance_yy: _Optional[_Iterable[float]] = ..., brightness: _Optional[_Iterable[float]] = ..., radius: _Optional[_Iterable[float]] = ..., fate: _Optional[_Iterable[_Union[Fate, str]]] = ..., robot: _Optional[_Iterable[int]] = ..., led: _Optional[_Iterable[int]] = ...) -> None: ...

class Alternative(_message.Message):
    __slots__ = ("pose", "odds")
    POSE_FIELD_NUMBER: _ClassVar[int]
    ODDS_FIELD_NUMBER: _ClassVar[int]
    pose: Pose
    odds: float
    def __init__(self, pose: _Optional[_Union[Pose, _Mapping]] = ..., odds: _Optional[float] = ...) -> None: ...

class RobotReport(_message.Message):
    __slots__ = ("id", "state", "reason", "pose", "covariance", "leds", "rms_px", "led", "spot", "residual_x", "residual_y", "alternative", "points", "smoothed_by", "extrapolated", "velocity", "cameras", "left_out", "surface")
    class PointsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: Vector3
        def __init__(self, key: _Optional[str] = ..., value: _Optional[_Union[Vector3, _Mapping]] = ...) -> None: ...
    class LeftOutEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: str
        def __init__(self, key: _Optional[str] = ..., value: _Optional[str] = ...) -> None: ...
    ID_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    POSE_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    LEDS_FIELD_NUMBER: _ClassVar[int]
    RMS_PX_FIELD_NUMBER: _ClassVar[int]
    LED_FIELD_NUMBER: _ClassVar[int]
    SPOT_FIELD_NUMBER: _ClassVar[int]
    RESIDUAL_X_FIELD_NUMBER: _ClassVar[int]
    RESIDUAL_Y_FIELD_NUMBER: _ClassVar[int]
    ALTERNATIVE_FIELD_NUMBER: _ClassVar[int]
    POINTS_FIELD_NUMBER: _ClassVar[int]
    SMOOTHED_BY_FIELD_NUMBER: _ClassVar[int]
    EXTRAPOLATED_FIELD_NUMBER: _ClassVar[int]
    VELOCITY_FIELD_NUMBER: _ClassVar[int]
    CAMERAS_FIELD_NUMBER: _ClassVar[int]
    LEFT_OUT_FIELD_NUMBER: _ClassVar[int]
    SURFACE_FIELD_NUMBER: _ClassVar[int]
    id: str
    state: State
    reason: str
    pose: Pose
    covariance: _containers.RepeatedScalarFieldContainer[float]
    leds: int
    rms_px: float
    led: _containers.RepeatedScalarFieldContainer[int]
    spot: _containers.RepeatedScalarFieldContainer[int]
    residual_x: _containers.RepeatedScalarFieldContainer[float]
    residual_y: _containers.RepeatedScalarFieldContainer[float]
    alternative: Alternative
    points: _containers.MessageMap[str, Vector3]
    smoothed_by: str
    extrapolated: bool
    velocity: Velocity
    cameras: _containers.RepeatedScalarFieldContainer[str]
    left_out: _containers.ScalarMap[str, str]
    surface: OnSurface
    def __init__(self, id: _Optional[str] = ..., state: _Optional[_Union[State, str]] = ..., reason: _Optional[str] = ..., pose: _Optional[_Union[Pose, _Mapping]] = ..., covariance: _Optional[_Iterable[float]] = ..., leds: _Optional[int] = ..., rms_px: _Optional[float] = ..., led: _Optional[_Iterable[int]] = ..., spot: _Optional[_Iterable[int]] = ..., residual_x: _Optional[_Iterable[float]] = ..., residual_y: _Optional[_Iterable[float]] = ..., alternative: _Optional[_Union[Alternative, _Mapping]] = ..., points: _Optional[_Mapping[str, Vector3]] = ..., smoothed_by: _Optional[str] = ..., extrapolated: bool = ..., velocity: _Optional[_Union[Velocity, _Mapping]] = ..., cameras: _Optional[_Iterable[str]] = ..., left_out: _Optional[_Mapping[str, str]] = ..., surface: _Optional[_Union[OnSurface, _Mapping]] = ...) -> None: ...

class OnSurface(_message.Message):
    __slots__ = ("standing", "reason", "off_m", "off_sigma_m", "tilt_off_rad", "tilt_off_sigma_rad", "without", "without_covariance", "without_alternative")
    STANDING_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    OFF_M_FIELD_NUMBER: _ClassVar[int]
    OFF_SIGMA_M_FIELD_NUMBER: _ClassVar[int]
    TILT_OFF_RAD_FIELD_NUMBER: _ClassVar[int]
    TILT_OFF_SIGMA_RAD_FIELD_NUMBER: _ClassVar[int]
    WITHOUT_FIELD_NUMBER: _ClassVar[int]
    WITHOUT_COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    WITHOUT_ALTERNATIVE_FIELD_NUMBER: _ClassVar[int]
    standing: Standing
    reason: str
    off_m: float
    off_sigma_m: float
    tilt_off_rad: float
    tilt_off_sigma_rad: float
    without: Pose
    without_covariance: _containers.RepeatedScalarFieldContainer[float]
    without_alternative: Alternative
    def __init__(self, standing: _Optional[_Union[Standing, str]] = ..., reason: _Optional[str] = ..., off_m: _Optional[float] = ..., off_sigma_m: _Optional[float] = ..., tilt_off_rad: _Optional[float] = ..., tilt_off_sigma_rad: _Optional[float] = ..., without: _Optional[_Union[Pose, _Mapping]] = ..., without_covariance: _Optional[_Iterable[float]] = ..., without_alternative: _Optional[_Union[Alternative, _Mapping]] = ...) -> None: ...

class Velocity(_message.Message):
    __slots__ = ("linear", "angular", "covariance")
    LINEAR_FIELD_NUMBER: _ClassVar[int]
    ANGULAR_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    linear: Vector3
    angular: Vector3
    covariance: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, linear: _Optional[_Union[Vector3, _Mapping]] = ..., angular: _Optional[_Union[Vector3, _Mapping]] = ..., covariance: _Optional[_Iterable[float]] = ...) -> None: ...

class Learned(_message.Message):
    __slots__ = ("led_misfit",)
    LED_MISFIT_FIELD_NUMBER: _ClassVar[int]
    led_misfit: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, led_misfit: _Optional[_Iterable[float]] = ...) -> None: ...

class CameraPlace(_message.Message):
    __slots__ = ("pose", "covariance", "noise", "seen_ns")
    POSE_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    NOISE_FIELD_NUMBER: _ClassVar[int]
    SEEN_NS_FIELD_NUMBER: _ClassVar[int]
    pose: Pose
    covariance: _containers.RepeatedScalarFieldContainer[float]
    noise: _containers.RepeatedScalarFieldContainer[float]
    seen_ns: int
    def __init__(self, pose: _Optional[_Union[Pose, _Mapping]] = ..., covariance: _Optional[_Iterable[float]] = ..., noise: _Optional[_Iterable[float]] = ..., seen_ns: _Optional[int] = ...) -> None: ...

class FrameReport(_message.Message):
    __slots__ = ("sequence", "exposed_ns", "arrived_ns", "solved_ns", "published_ns", "frame_id", "spots", "robots", "learned", "session", "clock", "camera", "cameras")
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    EXPOSED_NS_FIELD_NUMBER: _ClassVar[int]
    ARRIVED_NS_FIELD_NUMBER: _ClassVar[int]
    SOLVED_NS_FIELD_NUMBER: _ClassVar[int]
    PUBLISHED_NS_FIELD_NUMBER: _ClassVar[int]
    FRAME_ID_FIELD_NUMBER: _ClassVar[int]
    SPOTS_FIELD_NUMBER: _ClassVar[int]
    ROBOTS_FIELD_NUMBER: _ClassVar[int]
    LEARNED_FIELD_NUMBER: _ClassVar[int]
    SESSION_FIELD_NUMBER: _ClassVar[int]
    CLOCK_FIELD_NUMBER: _ClassVar[int]
    CAMERA_FIELD_NUMBER: _ClassVar[int]
    CAMERAS_FIELD_NUMBER: _ClassVar[int]
    sequence: int
    exposed_ns: int
    arrived_ns: int
    solved_ns: int
    published_ns: int
    frame_id: str
    spots: Spots
    robots: _containers.RepeatedCompositeFieldContainer[RobotReport]
    learned: Learned
    session: int
    clock: Clock
    camera: CameraPlace
    cameras: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, sequence: _Optional[int] = ..., exposed_ns: _Optional[int] = ..., arrived_ns: _Optional[int] = ..., solved_ns: _Optional[int] = ..., published_ns: _Optional[int] = ..., frame_id: _Optional[str] = ..., spots: _Optional[_Union[Spots, _Mapping]] = ..., robots: _Optional[_Iterable[_Union[RobotReport, _Mapping]]] = ..., learned: _Optional[_Union[Learned, _Mapping]] = ..., session: _Optional[int] = ..., clock: _Optional[_Union[Clock, str]] = ..., camera: _Optional[_Union[CameraPlace, _Mapping]] = ..., cameras: _Optional[_Iterable[str]] = ...) -> None: ...

class Beat(_message.Message):
    __slots__ = ("session", "sequence", "time_ns", "monotonic_ns", "rate", "started_ns")
    SESSION_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    TIME_NS_FIELD_NUMBER: _ClassVar[int]
    MONOTONIC_NS_FIELD_NUMBER: _ClassVar[int]
    RATE_FIELD_NUMBER: _ClassVar[int]
    STARTED_NS_FIELD_NUMBER: _ClassVar[int]
    session: int
    sequence: int
    time_ns: int
    monotonic_ns: int
    rate: float
    started_ns: int
    def __init__(self, session: _Optional[int] = ..., sequence: _Optional[int] = ..., time_ns: _Optional[int] = ..., monotonic_ns: _Optional[int] = ..., rate: _Optional[float] = ..., started_ns: _Optional[int] = ...) -> None: ...

class Status(_message.Message):
    __slots__ = ("time_ns", "source", "frames", "frames_dropped", "frames_unreadable", "frames_not_recorded", "rate_hz", "solve_p50_s", "solve_p99_s", "latency_p50_s", "latency_p99_s", "rejected", "robots", "problem", "messages_not_recorded", "session")
    class RejectedEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: int
        def __init__(self, key: _Optional[str] = ..., value: _Optional[int] = ...) -> None: ...
    class RobotsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: int
        def __init__(self, key: _Optional[str] = ..., value: _Optional[int] = ...) -> None: ...
    TIME_NS_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    FRAMES_FIELD_NUMBER: _ClassVar[int]
    FRAMES_DROPPED_FIELD_NUMBER: _ClassVar[int]
    FRAMES_UNREADABLE_FIELD_NUMBER: _ClassVar[int]
    FRAMES_NOT_RECORDED_FIELD_NUMBER: _ClassVar[int]
    RATE_HZ_FIELD_NUMBER: _ClassVar[int]
    SOLVE_P50_S_FIELD_NUMBER: _ClassVar[int]
    SOLVE_P99_S_FIELD_NUMBER: _ClassVar[int]
    LATENCY_P50_S_FIELD_NUMBER: _ClassVar[int]
    LATENCY_P99_S_FIELD_NUMBER: _ClassVar[int]
    REJECTED_FIELD_NUMBER: _ClassVar[int]
    ROBOTS_FIELD_NUMBER: _ClassVar[int]
    PROBLEM_FIELD_NUMBER: _ClassVar[int]
    MESSAGES_NOT_RECORDED_FIELD_NUMBER: _ClassVar[int]
    SESSION_FIELD_NUMBER: _ClassVar[int]
    time_ns: int
    source: str
    frames: int
    frames_dropped: int
    frames_unreadable: int
    frames_not_recorded: int
    rate_hz: float
    solve_p50_s: float
    solve_p99_s: float
    latency_p50_s: float
    latency_p99_s: float
    rejected: _containers.ScalarMap[str, int]
    robots: _containers.ScalarMap[str, int]
    problem: str
    messages_not_recorded: int
    session: int
    def __init__(self, time_ns: _Optional[int] = ..., source: _Optional[str] = ..., frames: _Optional[int] = ..., frames_dropped: _Optional[int] = ..., frames_unreadable: _Optional[int] = ..., frames_not_recorded: _Optional[int] = ..., rate_hz: _Optional[float] = ..., solve_p50_s: _Optional[float] = ..., solve_p99_s: _Optional[float] = ..., latency_p50_s: _Optional[float] = ..., latency_p99_s: _Optional[float] = ..., rejected: _Optional[_Mapping[str, int]] = ..., robots: _Optional[_Mapping[str, int]] = ..., problem: _Optional[str] = ..., messages_not_recorded: _Optional[int] = ..., session: _Optional[int] = ...) -> None: ...

class Event(_message.Message):
    __slots__ = ("robot", "happening", "before", "state", "reason", "since_ns", "lasted_s", "sequence", "session", "number", "left_out", "published_ns")
    ROBOT_FIELD_NUMBER: _ClassVar[int]
    HAPPENING_FIELD_NUMBER: _ClassVar[int]
    BEFORE_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    SINCE_NS_FIELD_NUMBER: _ClassVar[int]
    LASTED_S_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    SESSION_FIELD_NUMBER: _ClassVar[int]
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    LEFT_OUT_FIELD_NUMBER: _ClassVar[int]
    PUBLISHED_NS_FIELD_NUMBER: _ClassVar[int]
    robot: str
    happening: Happening
    before: State
    state: State
    reason: str
    since_ns: int
    lasted_s: float
    sequence: int
    session: int
    number: int
    left_out: int
    published_ns: int
    def __init__(self, robot: _Optional[str] = ..., happening: _Optional[_Union[Happening, str]] = ..., before: _Optional[_Union[State, str]] = ..., state: _Optional[_Union[State, str]] = ..., reason: _Optional[str] = ..., since_ns: _Optional[int] = ..., lasted_s: _Optional[float] = ..., sequence: _Optional[int] = ..., session: _Optional[int] = ..., number: _Optional[int] = ..., left_out: _Optional[int] = ..., published_ns: _Optional[int] = ...) -> None: ...

class RigRobot(_message.Message):
    __slots__ = ("id", "leds", "axis", "points")
    class PointsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: Vector3
        def __init__(self, key: _Optional[str] = ..., value: _Optional[_Union[Vector3, _Mapping]] = ...) -> None: ...
    ID_FIELD_NUMBER: _ClassVar[int]
    LEDS_FIELD_NUMBER: _ClassVar[int]
    AXIS_FIELD_NUMBER: _ClassVar[int]
    POINTS_FIELD_NUMBER: _ClassVar[int]
    id: str
    leds: _containers.RepeatedCompositeFieldContainer[Vector3]
    axis: Vector3
    points: _containers.MessageMap[str, Vector3]
    def __init__(self, id: _Optional[str] = ..., leds: _Optional[_Iterable[_Union[Vector3, _Mapping]]] = ..., axis: _Optional[_Union[Vector3, _Mapping]] = ..., points: _Optional[_Mapping[str, Vector3]] = ...) -> None: ...

class Reloads(_message.Message):
    __slots__ = ("count", "problem")
    COUNT_FIELD_NUMBER: _ClassVar[int]
    PROBLEM_FIELD_NUMBER: _ClassVar[int]
    count: int
    problem: str
    def __init__(self, count: _Optional[int] = ..., problem: _Optional[str] = ...) -> None: ...

class RigReport(_message.Message):
    __slots__ = ("camera", "frame_id", "width", "height", "camera_matrix", "distortion_model", "distortion", "world_camera", "robots", "rig_yaml", "camera_yaml", "offset_yaml", "files", "host", "pid", "session", "started_ns", "time_ns", "rate", "version", "reloads", "protocol")
    class OffsetYamlEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: str
        def __init__(self, key: _Optional[str] = ..., value: _Optional[str] = ...) -> None: ...
    class FilesEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: str
        def __init__(self, key: _Optional[str] = ..., value: _Optional[str] = ...) -> None: ...
    CAMERA_FIELD_NUMBER: _ClassVar[int]
    FRAME_ID_FIELD_NUMBER: _ClassVar[int]
    WIDTH_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    CAMERA_MATRIX_FIELD_NUMBER: _ClassVar[int]
    DISTORTION_MODEL_FIELD_NUMBER: _ClassVar[int]
    DISTORTION_FIELD_NUMBER: _ClassVar[int]
    WORLD_CAMERA_FIELD_NUMBER: _ClassVar[int]
    ROBOTS_FIELD_NUMBER: _ClassVar[int]
    RIG_YAML_FIELD_NUMBER: _ClassVar[int]
    CAMERA_YAML_FIELD_NUMBER: _ClassVar[int]
    OFFSET_YAML_FIELD_NUMBER: _ClassVar[int]
    FILES_FIELD_NUMBER: _ClassVar[int]
    HOST_FIELD_NUMBER: _ClassVar[int]
    PID_FIELD_NUMBER: _ClassVar[int]
    SESSION_FIELD_NUMBER: _ClassVar[int]
    STARTED_NS_FIELD_NUMBER: _ClassVar[int]
    TIME_NS_FIELD_NUMBER: _ClassVar[int]
    RATE_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    RELOADS_FIELD_NUMBER: _ClassVar[int]
    PROTOCOL_FIELD_NUMBER: _ClassVar[int]
    camera: str
    frame_id: str
    width: int
    height: int
    camera_matrix: _containers.RepeatedScalarFieldContainer[float]
    distortion_model: str
    distortion: _containers.RepeatedScalarFieldContainer[float]
    world_camera: Pose
    robots: _containers.RepeatedCompositeFieldContainer[RigRobot]
    rig_yaml: str
    camera_yaml: str
    offset_yaml: _containers.ScalarMap[str, str]
    files: _containers.ScalarMap[str, str]
    host: str
    pid: int
    session: int
    started_ns: int
    time_ns: int
    rate: float
    version: str
    reloads: Reloads
    protocol: int
    def __init__(self, camera: _Optional[str] = ..., frame_id: _Optional[str] = ..., width: _Optional[int] = ..., height: _Optional[int] = ..., camera_matrix: _Optional[_Iterable[float]] = ..., distortion_model: _Optional[str] = ..., distortion: _Optional[_Iterable[float]] = ..., world_camera: _Optional[_Union[Pose, _Mapping]] = ..., robots: _Optional[_Iterable[_Union[RigRobot, _Mapping]]] = ..., rig_yaml: _Optional[str] = ..., camera_yaml: _Optional[str] = ..., offset_yaml: _Optional[_Mapping[str, str]] = ..., files: _Optional[_Mapping[str, str]] = ..., host: _Optional[str] = ..., pid: _Optional[int] = ..., session: _Optional[int] = ..., started_ns: _Optional[int] = ..., time_ns: _Optional[int] = ..., rate: _Optional[float] = ..., version: _Optional[str] = ..., reloads: _Optional[_Union[Reloads, _Mapping]] = ..., protocol: _Optional[int] = ...) -> None: ...

class Coverage(_message.Message):
    __slots__ = ("session", "since_ns", "exposed_ns", "frame", "x0", "y0", "pitch", "columns", "rows", "whole", "robots")
    SESSION_FIELD_NUMBER: _ClassVar[int]
    SINCE_NS_FIELD_NUMBER: _ClassVar[int]
    EXPOSED_NS_FIELD_NUMBER: _ClassVar[int]
    FRAME_FIELD_NUMBER: _ClassVar[int]
    X0_FIELD_NUMBER: _ClassVar[int]
    Y0_FIELD_NUMBER: _ClassVar[int]
    PITCH_FIELD_NUMBER: _ClassVar[int]
    COLUMNS_FIELD_NUMBER: _ClassVar[int]
    ROWS_FIELD_NUMBER: _ClassVar[int]
    WHOLE_FIELD_NUMBER: _ClassVar[int]
    ROBOTS_FIELD_NUMBER: _ClassVar[int]
    session: int
    since_ns: int
    exposed_ns: int
    frame: Pose
    x0: float
    y0: float
    pitch: float
    columns: int
    rows: int
    whole: bool
    robots: _containers.RepeatedCompositeFieldContainer[CoverageOf]
    def __init__(self, session: _Optional[int] = ..., since_ns: _Optional[int] = ..., exposed_ns: _Optional[int] = ..., frame: _Optional[_Union[Pose, _Mapping]] = ..., x0: _Optional[float] = ..., y0: _Optional[float] = ..., pitch: _Optional[float] = ..., columns: _Optional[int] = ..., rows: _Optional[int] = ..., whole: bool = ..., robots: _Optional[_Iterable[_Union[CoverageOf, _Mapping]]] = ...) -> None: ...

class CoverageOf(_message.Message):
    __slots__ = ("robot", "patch", "dwell_s", "passes", "speed", "direction", "last_ns", "left_out", "radius", "counted", "counted_s")
    class LeftOutEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: int
        def __init__(self, key: _Optional[str] = ..., value: _Optional[int] = ...) -> None: ...
    ROBOT_FIELD_NUMBER: _ClassVar[int]
    PATCH_FIELD_NUMBER: _ClassVar[int]
    DWELL_S_FIELD_NUMBER: _ClassVar[int]
    PASSES_FIELD_NUMBER: _ClassVar[int]
    SPEED_FIELD_NUMBER: _ClassVar[int]
    DIRECTION_FIELD_NUMBER: _ClassVar[int]
    LAST_NS_FIELD_NUMBER: _ClassVar[int]
    LEFT_OUT_FIELD_NUMBER: _ClassVar[int]
    RADIUS_FIELD_NUMBER: _ClassVar[int]
    COUNTED_FIELD_NUMBER: _ClassVar[int]
    COUNTED_S_FIELD_NUMBER: _ClassVar[int]
    robot: str
    patch: _containers.RepeatedScalarFieldContainer[int]
    dwell_s: _containers.RepeatedScalarFieldContainer[float]
    passes: _containers.RepeatedScalarFieldContainer[int]
    speed: _containers.RepeatedScalarFieldContainer[float]
    direction: _containers.RepeatedScalarFieldContainer[float]
    last_ns: _containers.RepeatedScalarFieldContainer[int]
    left_out: _containers.ScalarMap[str, int]
    radius: float
    counted: int
    counted_s: float
    def __init__(self, robot: _Optional[str] = ..., patch: _Optional[_Iterable[int]] = ..., dwell_s: _Optional[_Iterable[float]] = ..., passes: _Optional[_Iterable[int]] = ..., speed: _Optional[_Iterable[float]] = ..., direction: _Optional[_Iterable[float]] = ..., last_ns: _Optional[_Iterable[int]] = ..., left_out: _Optional[_Mapping[str, int]] = ..., radius: _Optional[float] = ..., counted: _Optional[int] = ..., counted_s: _Optional[float] = ...) -> None: ...
