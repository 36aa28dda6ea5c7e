"""Whether cameras fit together: what a rig must tell, and that a robot which two rigs name is one and the same."""

from collections.abc import Iterable

import numpy as np

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, angle_between
from asterism.protocol.keys import FUSED
from asterism.protocol.place_error import place_error_of
from asterism.protocol.rig import Rig, Robot
from asterism.server.fusing.fleet import View

SAME_M = 1e-6  # numbers in files may be rounded
SAME_RAD = 1e-6


def view_of(rig: Rig, where: str) -> View:
    """The camera of a rig, which came from ``where``. Raises InputError for a rig that places no camera."""
    if rig.camera.name == FUSED:
        raise InputError(f"{where}: its camera is called '{FUSED}', which names what is joined; give it another name")
    if rig.T_world_camera is None:
        raise InputError(
            f"{where}: the rig has no `world`, expected where its camera stands: cameras are joined in one world "
            "(asterism calibrate world finds it for one camera, asterism calibrate cameras for all together)"
        )
    told = place_error_of(rig.files, where)
    return View(rig) if told is None else View(rig, told.covariance)


def refuse_unlike_robots(view: View, others: Iterable[View]) -> None:
    """Raises InputError where a robot of that camera's rig is another one in the rig of one of the others."""
    for other in others:
        theirs = {robot.id: robot for robot in other.rig.robots}
        for robot in view.rig.robots:
            if robot.id in theirs and (told := unlike(robot, theirs[robot.id])):
                raise InputError(
                    f"robot '{robot.id}' is another one in the rig of camera '{view.camera}' than in that of "
                    f"'{other.camera}': {told}; expected the same in both, such as one file of robots that both rigs "
                    "name (robots: robots.yaml)"
                )


def unlike(one: Robot, other: Robot) -> str:
    """In what two robots differ and by how much, or nothing: what a pose means depends on it."""
    away = np.linalg.norm(one.leds - other.leds, axis=1)
    led = int(np.argmax(away))
    if away[led] > SAME_M:
        return f"LED {led} is {1e3 * away[led]:.3g} mm elsewhere"
    turned = float(np.arccos(np.clip(one.axis @ other.axis, -1.0, 1.0)))
    if float(np.linalg.norm(one.axis - other.axis)) > SAME_RAD:
        return f"led.axis is turned by {np.degrees(turned):.3g} degrees"
    if one.points.keys() != other.points.keys():
        return f"the point '{min(one.points.keys() ^ other.points.keys())}' is in one of them only"
    for name, point in one.points.items():
        if (off := _apart(point, other.points[name])) > SAME_M:
            return f"the point '{name}' is {1e3 * off:.3g} mm elsewhere"
    return _fixed_unlike(one, other)


def _fixed_unlike(one: Robot, other: Robot) -> str:
    a, b = one.T_world_fixed, other.T_world_fixed
    if a is None or b is None:
        return "" if a is b else "it is `fixed` in one of them only"
    off, turned = _apart(a.position, b.position), angle_between(a.rotation, b.rotation)
    if off > SAME_M or turned > SAME_RAD:
        return f"it is fixed {1e3 * off:.3g} mm and {np.degrees(turned):.3g} degrees elsewhere"
    return ""


def _apart(a: Floats, b: Floats) -> float:
    return float(np.linalg.norm(a - b))
