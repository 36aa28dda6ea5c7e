"""The columns of exported tables, each with its unit in its name: of CSV and of Parquet the same."""

import math
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from asterism.recordings.export.frames import ExportedFrame, ExportedRobot

Type = Literal["text", "integer", "natural", "real", "flag"]
Value = str | int | float | bool | None
LEDS = 6
AXES = ("x", "y", "z", "rx", "ry", "rz")  # rotations are about the axes of the parent frame
SECOND_NS = 1_000_000_000
_UNITS = ("m", "m", "m", "rad", "rad", "rad")
_UNDERSCORED = {"m²": "m2", "m rad": "m_rad", "rad²": "rad2"}
_PAIRS = [(row, column) for row in range(6) for column in range(row + 1, 6)]


@dataclass(frozen=True, slots=True)
class Column:
    """``unit`` is empty for what has none."""

    name: str
    unit: str
    type: Type


@dataclass(frozen=True, slots=True)
class Group:
    """Columns that stand together, and their values of one robot in one frame."""

    columns: tuple[Column, ...]
    values: Callable[[ExportedFrame, ExportedRobot], Sequence[Value]]


def groups(points: Iterable[str]) -> tuple[Group, ...]:
    """All columns, for a robot with those named points."""
    rest = (_VELOCITY, _RESIDUALS, _OTHER, _HOW, _SURFACE)
    taken = {column.name for column in columns((*_FIRST, *rest))}
    named = []
    for name in points:
        named.append(_point(name, taken))
        taken |= {column.name for column in named[-1].columns}
    return (*_FIRST, *named, *rest)


def columns(of: Iterable[Group]) -> list[Column]:
    """Side by side."""
    return [column for group in of for column in group.columns]


def row(of: Iterable[Group], frame: ExportedFrame, robot: ExportedRobot) -> list[Value]:
    """One robot in one frame; None where it tells nothing."""
    return [value for group in of for value in group.values(frame, robot)]


def seconds(time_ns: int) -> str:
    """ns since the Unix epoch as s: a text, since a float64 holds no ns of our days."""
    whole, rest = divmod(abs(time_ns), SECOND_NS)
    return f"{'-' if time_ns < 0 else ''}{whole}.{rest:09d}"


def _both(a: int, b: int) -> str:
    """The unit of a covariance."""
    return f"{_UNITS[a]}²" if _UNITS[a] == _UNITS[b] else f"{_UNITS[a]} {_UNITS[b]}"


def _named(names: Iterable[str], unit: str = "", kind: Type = "real") -> tuple[Column, ...]:
    return tuple(Column(f"{name}_{unit.replace('/', '_per_')}" if unit else name, unit, kind) for name in names)


def _place(name: str = "") -> tuple[Column, ...]:
    return (*_named((f"{name}x", f"{name}y", f"{name}z"), "m"), *_named(f"{name}q{axis}" for axis in "xyzw"))


def _pose(_: ExportedFrame, robot: ExportedRobot) -> Sequence[Value]:
    if robot.position is None or robot.orientation is None:
        return _NONE[:7]
    return (*robot.position, *robot.orientation)


def _spread(_: ExportedFrame, robot: ExportedRobot) -> Sequence[Value]:
    told = robot.covariance
    if told is None:
        return _NONE[: 6 + len(_PAIRS)]
    sigmas = (math.sqrt(told[7 * k]) if told[7 * k] >= 0 else None for k in range(6))
    return (*sigmas, *(told[6 * a + b] for a, b in _PAIRS))


def _velocity(_: ExportedFrame, robot: ExportedRobot) -> Sequence[Value]:
    told = robot.velocity
    if told is None:
        return _NONE[:12]
    sigmas = (math.sqrt(value) if value >= 0 else None for value in told.covariance.diagonal().tolist())
    return (*told.linear.tolist(), *told.angular.tolist(), *sigmas)


def _residuals(_: ExportedFrame, robot: ExportedRobot) -> Sequence[Value]:
    found = robot.residuals_px
    return [value for led in range(LEDS) for value in found.get(led, (None, None))]


def _other(_: ExportedFrame, robot: ExportedRobot) -> Sequence[Value]:
    other = robot.alternative
    return _NONE[:8] if other is None else (*other.position, *other.orientation, other.odds)


def _surface(_: ExportedFrame, robot: ExportedRobot) -> Sequence[Value]:
    told = robot.surface
    if told is None:
        return _NONE[:19]
    off = (told.off_m, told.off_sigma_m, told.tilt_off_rad, told.tilt_off_sigma_rad)
    if told.without is None:
        return (told.standing, told.reason or None, *off, *_NONE[:13])
    position, orientation, covariance = told.without
    sigmas = (math.sqrt(value) if value >= 0 else None for value in covariance[::7])
    return (told.standing, told.reason or None, *off, *position, *orientation, *sigmas)


def _point(name: str, taken: Collection[str]) -> Group:
    """``tool_x_m``; a point called `sigma` would take the name of another column, and becomes ``point_sigma_x_m``."""
    called = name
    while f"{called}_x_m" in taken:
        called = f"point_{called}"

    def values(_: ExportedFrame, robot: ExportedRobot) -> Sequence[Value]:
        return robot.points.get(name, _NONE[:3])

    return Group(_named((f"{called}_x", f"{called}_y", f"{called}_z"), "m"), values)


_NONE: tuple[None, ...] = (None,) * 36
_RATES = (*((f"v{axis}", "m/s") for axis in "xyz"), *((f"w{axis}", "rad/s") for axis in "xyz"))

_WHEN = Group(
    (
        Column("robot", "", "text"),
        Column("frame", "", "text"),
        Column("time_s", "s", "text"),
        Column("exposed_ns", "ns", "integer"),
        Column("session", "", "natural"),
    ),
    lambda frame, robot: (robot.id, frame.name, seconds(frame.exposed_ns), frame.exposed_ns, frame.session or None),
)
_STATE = Group(
    _named(("frame_id", "state", "reason"), kind="text"),
    lambda frame, robot: (frame.frame_id or None, robot.state or None, robot.reason or None),
)
_POSE = Group(_place(), _pose)
_SPREAD = Group(
    (
        *(column for axis, unit in zip(AXES, _UNITS, strict=True) for column in _named((f"sigma_{axis}",), unit)),
        *(Column(f"cov_{AXES[a]}_{AXES[b]}_{_UNDERSCORED[_both(a, b)]}", _both(a, b), "real") for a, b in _PAIRS),
    ),
    _spread,
)
_FIT = Group(
    (Column("leds", "", "integer"), Column("rms_px", "px", "real")), lambda _, robot: (robot.leds, robot.rms_px)
)
_FIRST = (_WHEN, _STATE, _POSE, _SPREAD, _FIT)
_VELOCITY = Group(
    (
        *(column for name, unit in _RATES for column in _named((name,), unit)),
        *(column for name, unit in _RATES for column in _named((f"sigma_{name}",), unit)),
    ),
    _velocity,
)
_RESIDUALS = Group(_named((f"led{led}_residual_{axis}" for led in range(LEDS) for axis in "xy"), "px"), _residuals)
_OTHER = Group((*_place("other_"), Column("other_odds", "", "real")), _other)
_HOW = Group(
    (Column("filter", "", "text"), Column("extrapolated", "", "flag"), Column("cameras", "", "text")),
    lambda _, robot: (robot.smoothed_by or None, robot.extrapolated, "/".join(robot.cameras) or None),
)
_SURFACE = Group(
    (
        Column("surface", "", "text"),
        Column("surface_reason", "", "text"),
        *_named(("surface_off", "surface_off_sigma"), "m"),
        *_named(("surface_tilt_off", "surface_tilt_off_sigma"), "rad"),
        *_place("without_"),
        *(
            column
            for axis, unit in zip(AXES, _UNITS, strict=True)
            for column in _named((f"without_sigma_{axis}",), unit)
        ),
    ),
    _surface,
)
