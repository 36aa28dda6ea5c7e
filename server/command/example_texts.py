"""How `asterism example` writes rigs, as a person would."""

import math

import numpy as np

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig, Robot


def range_line(rig: Rig) -> str:
    """The working distances."""
    near, far = rig.range_m or (0.0, 0.0)
    return f"range: [{near:g}, {far:g}]                   # working distances, m"


def world_lines(place: Pose, digits: int) -> list[str]:
    """A camera's place, to so many digits of a metre."""
    return [
        "world:                              # T_world_camera",
        f"  position: {row(place.position, digits)}",
        f"  orientation: {row(place.orientation, digits + 3)}",
    ]


def robot_lines(robot: Robot, digits: int, remark: str) -> list[str]:
    """One robot, below `robots:`; ``remark`` says how its LEDs were measured."""
    lines = [f"  {robot.id}:", f"    leds:                           # {remark}"]
    lines += [f"      - {row(led, digits)}" for led in robot.leds]
    lines.append(f"    led: {{radius: {robot.led_radius:g}}}           # of the light that is seen, m")
    if robot.points:
        points = ", ".join(f"{name}: {row(place, digits)}" for name, place in robot.points.items())
        lines.append(f"    points: {{{points}}}")
    if robot.T_world_fixed is not None:
        place = robot.T_world_fixed
        lines.append(
            f"    fixed: {{position: {row(place.position, digits)}, orientation: {row(place.orientation, 1)}}}"
        )
    if (stands := robot.stands) is not None:
        told = (
            f"point: {stands.point}, sigma: {stands.sigma_m:g}, tilt_sigma_deg: {math.degrees(stands.tilt_sigma_rad):g}"
        )
        lines.append(f"    stands: {{{told}, radius: {stands.radius_m:g}}}")
    return lines


def row(values: Floats, digits: int) -> str:
    """Numbers as YAML."""
    return "[" + ", ".join(f"{value:.{digits}f}" for value in np.asarray(values) + 0.0) + "]"
