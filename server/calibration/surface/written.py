"""What a rig says of a surface that was calibrated, as text, and of the robots that stand on it."""

import textwrap

import numpy as np

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig
from asterism.protocol.surface import TERMS, Heights, Quadric, Surface
from asterism.protocol.surface_file import LARGEST_TILT_DEG, Stands
from asterism.server.calibration.rewrite import Value, number, without
from asterism.server.calibration.surface.surface_fit import SurfaceFit

WIDTH = 110
TERM_DIGITS = 10  # of numbers that stand beside coordinates below 1 m


def with_surface(text: str, surface: Surface, table: str, comments: list[str]) -> str:
    """The rig's text with that `surface` in place of any; heights are in the file ``table``. Comments stand above."""
    lines = [*(f"# asterism calibrate surface: {comment}" for comment in comments), "surface:"]
    if isinstance(surface.shape, Heights):
        lines.append(f"  heights: {table}")
    else:
        lines += _quadric(surface.shape)
    if surface.T_world_surface.position.any() or abs(surface.T_world_surface.orientation[3]) < 1.0 - 1e-12:
        lines.append(f"  frame: {_pose(surface.T_world_surface)}")
    if surface.sigma_m > 0.0:
        lines.append(f"  sigma: {number(float(f'{surface.sigma_m:.3g}'))}")
    lines.append(f"  tilt_sigma_deg: {number(float(f'{np.degrees(surface.tilt_sigma_rad):.3g}'))}")
    if len(surface.edge):
        corners = ", ".join(_row(corner, 4) for corner in surface.edge)
        lines += textwrap.wrap(f"edge: [{corners}]", WIDTH, initial_indent="  ", subsequent_indent="    ")
    kept = [
        line for line in without(text, "surface").rstrip("\n").splitlines()
        if not line.startswith("# asterism calibrate surface: ")
    ]  # fmt: skip
    return "\n".join([*kept, *lines]) + "\n"


def stands_changes(fit: SurfaceFit, rig: Rig) -> dict[tuple[str, ...], Value]:
    """`stands` of every robot that drove and has none yet."""
    return {
        ("robots", each.id, "stands"): _stands(each.stands, rig.robot(each.id).axis)
        for each in fit.robots
        if rig.robot(each.id).stands is None and each.used
    }


def _stands(stands: Stands, axis: Floats) -> Value:
    told: dict[str, Value] = {
        "point": stands.point,
        "sigma": float(f"{stands.sigma_m:.2g}"),
    }
    tilt = float(f"{np.degrees(stands.tilt_sigma_rad):.2g}")
    if tilt < LARGEST_TILT_DEG:  # else its tilt says nothing
        told["tilt_sigma_deg"] = tilt
    if not np.allclose(stands.axis, axis, atol=1e-9):
        told["axis"] = (stands.axis.round(6) + 0.0).tolist()
    return told


def _quadric(shape: Quadric) -> list[str]:
    about = _row(shape.about, 7)
    if shape.is_plane:
        normal = shape.terms[1:4] / np.linalg.norm(shape.terms[1:4])
        point = shape.about - np.array([0.0, 0.0, shape.terms[0] / shape.terms[3]])
        return [f"  plane: {{point: {_row(point, 7)}, normal: {_row(normal, 9)}}}"]
    terms = {name: round(float(value), TERM_DIGITS) for name, value in zip(TERMS, shape.terms, strict=True)}
    told = ", ".join(f"{name}: {number(value)}" for name, value in terms.items() if value)
    return ["  quadric:", f"    about: {about}", f"    terms: {{{told}}}"]


def _pose(pose: Pose) -> str:
    return f"{{position: {_row(pose.position, 7)}, orientation: {_row(pose.orientation, 9)}}}"


def _row(values: Floats, digits: int) -> str:
    return "[" + ", ".join(number(value) for value in (values.round(digits) + 0.0).tolist()) + "]"
