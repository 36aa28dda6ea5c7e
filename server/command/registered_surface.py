"""`asterism calibrate surface --stl`: the drawing read, registered, and what a person is told of it, in 80 columns."""

import math
import textwrap
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose, log_rotation
from asterism.protocol.rig import Rig
from asterism.protocol.stl_file import load_triangles
from asterism.protocol.stl_heights import stl_heights
from asterism.protocol.surface import HEIGHTS, STL, Heights, Surface
from asterism.protocol.yaml_file import parse_yaml
from asterism.server.calibration.surface.register import Placed, Registration, register
from asterism.server.calibration.surface.register_told import open_text, others_text
from asterism.server.calibration.surface.residual_map import (
    ResidualMap,
    as_drawn,
    as_it_is,
    places_of,
    residual_map,
)
from asterism.server.calibration.surface.surface_fit import SurfaceFit

OFFSET_M = 5e-5  # one sigma of what a robot's point is off, unless robots differ by more
LARGEST_M, SMALLEST_M = 5.0, 0.005  # of a drawing in the right unit
MOST_PLACES = 6
WIDTH = 80
# From which side of an STL's frame it is looked at, and the rotation (3, 3) that makes that side +z.
SIDES = {
    "+z": np.eye(3),
    "-z": np.diag([1.0, -1.0, -1.0]),
    "+y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "-y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    "+x": np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
    "-x": np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]),
}


class Registered(NamedTuple):
    """The fit with the drawing for its surface; where the drawing lies, and seen from which ``side``; how the mould
    ``differs``; ``drawn``: whether the rig takes the drawing as it is.
    """

    fit: SurfaceFit
    found: Registration
    side: str
    differs: ResidualMap
    drawn: bool
    name: str


def read_drawing(path: Path, scale: float) -> Floats:
    """The triangles (n, 3, 3) m of an STL. Raises InputError as `load_triangles` does, and for a unit that is not m."""
    triangles = load_triangles(path) * scale
    size = float(np.ptp(triangles.reshape(-1, 3), axis=0).max())
    if size > LARGEST_M:
        raise InputError(f"{path}: is {size:.4g} m large; is it in mm? Then --scale {scale / 1000:g}")
    if size < SMALLEST_M:
        raise InputError(f"{path}: is {1e3 * size:.3g} mm large; is it in m already? Then without --scale {scale:g}")
    return triangles


def registered(fit: SurfaceFit, triangles: Floats, path: Path, rig: Rig, drawn: bool) -> Registered:
    """The drawing where it fits best: as it is drawn with +z up, else turned over or on a side.

    Raises InputError where it fits in no way.
    """
    offsets = [robot.offset_m for robot in fit.robots if np.isfinite(robot.offset_m)]
    offset_m = max(OFFSET_M, float(np.sqrt(np.mean(np.square(offsets)))) if offsets else 0.0)
    first: InputError | None = None
    for side, placed in _placed(triangles, path, rig):
        try:
            if isinstance(placed, InputError):
                raise placed
            found = register([placed], fit.contacts, fit.used, offset_m, str(path))
        except InputError as error:
            first = first or error
            continue
        differs = residual_map(found)
        return Registered(_fit(fit, found, differs, drawn), found, side, differs, drawn, path.name)
    assert first is not None
    raise first


def _placed(triangles: Floats, path: Path, rig: Rig) -> Iterator[tuple[str, Placed | InputError]]:
    for side, turn in SIDES.items():
        try:
            heights = stl_heights(triangles @ turn.T, str(path))
        except InputError as error:
            yield side, error
        else:
            yield side, Placed(heights, _frame(rig) if side == "+z" else None)


def _frame(rig: Rig) -> Pose | None:
    """Where the rig has a drawing, if it has one."""
    text = parse_yaml(rig.rig_text, "rig")
    if rig.surface is None or "surface" not in text:
        return None
    section = text.section("surface")
    return rig.surface.T_world_surface if STL in section and "frame" in section else None


def _fit(fit: SurfaceFit, found: Registration, differs: ResidualMap, drawn: bool) -> SurfaceFit:
    """The fit with the drawing for its surface."""
    heights: Heights = (as_drawn if drawn else as_it_is)(found, differs)
    tilt = math.hypot(differs.tilt_sigma, _slope_rms(differs) if drawn else 0.0)
    surface = Surface(heights, found.T_world_drawing, tilt_sigma_rad=tilt)
    touch = surface.touch(fit.contacts.points)
    used = found.laid.used & touch.inside
    distances = np.where(touch.inside, touch.distances, fit.distances)
    own = distances.copy()
    for k, robot in enumerate(fit.robots):
        own[fit.contacts.robots == k] -= robot.offset_m
    rms = float(np.sqrt((own[used] ** 2).mean()))
    return replace(fit, surface=surface, kind=HEIGHTS, map=heights, used=used, distances=distances, rms_m=rms)


def _slope_rms(differs: ResidualMap) -> float:
    """Of what the mould leans from its drawing where it was visited, rad."""
    slopes = np.hypot(*(part / step for part, step in zip(np.gradient(differs.values), differs.step, strict=True)))
    return float(np.sqrt(np.nanmean(slopes[differs.visited] ** 2) / 2.0))


def comments(told: Registered) -> list[str]:
    """What the rig says above the surface."""
    what = "as drawn" if told.drawn else "with what the mould differs where robots were"
    side = "" if told.side == "+z" else f", its {told.side} up"
    return [
        f"{told.name}{side}, registered to {int(told.fit.used.sum())} places of {len(told.fit.robots)} robots, {what}; "
        f"the mould differs by {1e3 * told.differs.rms_m:.3f} mm (RMS)"
    ]


def tell(told: Registered) -> None:
    """Where it lies, what is not told, how the mould differs, what the rig has now."""
    found = told.found
    out = len(told.fit.used) - int(told.fit.used.sum())
    side = "" if told.side == "+z" else f", its {told.side} up,"
    left = f"; {out} more are left out: lifted, by a wrong tilt, or beyond it" if out else ""
    _say(
        f"{told.name}{side} lies under {told.fit.used.sum()} places where robots stood, which are "
        f"{1e3 * found.rms_m:.3f} mm off it (RMS, with the poses' noise){left}"
    )
    console = Console() if Console().is_terminal else Console(width=160)
    console.print(_pose(found))
    for line in (open_text(found, told.name), *others_text(found)):
        if line:
            _say(line)
    _say(_differs_text(told.differs))
    if places := places_of(told.differs):
        console.print(_places(told.differs))
    _say(
        "the rig has the drawing as it is, its sigma with what the mould differs"
        if told.drawn
        else "the rig has the drawing with what the mould differs where robots were; --as-drawn: the drawing alone"
    )
    if len(places) > MOST_PLACES:
        _say(f"{len(places) - MOST_PLACES} places more are in the table and the picture")


def _say(text: str) -> None:
    print(textwrap.fill(text, WIDTH, subsequent_indent="  "))


def _pose(found: Registration) -> Table:
    table = Table(box=None, header_style="bold", padding=(0, 1, 0, 0))
    for name in ("", "x", "y", "z"):
        table.add_column(name, justify="right" if name else "left", no_wrap=True)
    sigmas = np.sqrt(np.diag(found.about_centre))
    turn = np.degrees(log_rotation(found.T_world_drawing.rotation))
    table.add_row("its origin in the world, mm", *(f"{1e3 * v:.3f}" for v in found.T_world_drawing.position))
    table.add_row("its middle, mm", *(f"{1e3 * v:.3f}" for v in found.centre))
    table.add_row("  +-", *(f"{1e3 * v:.3f}" for v in sigmas[:3]))
    table.add_row("turned about, degrees", *(f"{v:.4f}" for v in turn))
    table.add_row("  +-", *(f"{np.degrees(v):.4f}" for v in sigmas[3:]))
    return table


def _differs_text(differs: ResidualMap) -> str:
    visited = float(differs.visited.sum())
    there = float(np.isfinite(differs.values).sum())
    sigma = float(np.sqrt((differs.sigmas[differs.visited] ** 2).mean()))
    return (
        f"the mould differs from it by {1e3 * differs.rms_m:.3f} mm (RMS) where robots were, {visited / there:.0%} of "
        f"it, known within {1e3 * sigma:.3f} mm; by more than chance ({differs.chance:.1f} sigmas) on "
        f"{differs.real.sum() / max(visited, 1.0):.1%} of that" + (":" if differs.real.any() else "")
    )


def _places(differs: ResidualMap) -> Table:
    table = Table(box=None, header_style="bold", padding=(0, 1, 0, 0))
    for name in ("at x m", "y m", "differs mm", "+-", "cm2"):
        table.add_column(name, justify="right", no_wrap=True)
    for place in places_of(differs)[:MOST_PLACES]:
        table.add_row(
            f"{place.xy[0]:.3f}", f"{place.xy[1]:.3f}", f"{1e3 * place.off_m:+.3f}", f"{1e3 * place.sigma_m:.3f}",
            f"{1e4 * place.area_m2:.1f}",
        )  # fmt: skip
    return table
