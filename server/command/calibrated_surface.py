"""What a person is told of a surface that was calibrated, in 80 columns."""

import math
import textwrap

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from asterism.protocol.surface import HEIGHTS, PLANE, QUADRIC
from asterism.server.calibration.surface.shapes import PARABOLOID
from asterism.server.calibration.surface.surface_fit import Stood, SurfaceFit

NAMES = {PLANE: "a plane", PARABOLOID: "a paraboloid", QUADRIC: "a quadric", HEIGHTS: "a spline"}
CLEARLY = 4.0  # sigmas of a robot's offset, from which on it is said,
CLEARLY_M = 2e-5  # and m
LEANS_RAD = math.radians(0.1)
WIDTH = 80


def comments(fit: SurfaceFit) -> list[str]:
    """What the rig says above the surface."""
    low, mean, high = _sigmas(fit)
    return [
        f"{NAMES[fit.kind]} from {int(fit.used.sum())} places of {len(fit.robots)} robots, {fit.area_m2:.3f} m2; "
        f"+- {mean:.3f} mm ({low:.3f} to {high:.3f}, one sigma)"
    ]


def tell(fit: SurfaceFit, shared_m: float, told_by: str) -> None:
    """Kind and why, residuals, sigmas, robots, what to do next."""
    for line in (_kind(fit), _places(fit), _sure(fit)):
        print(textwrap.fill(line, WIDTH, subsequent_indent="  "))
    print(shared_text(shared_m, told_by))
    console = Console()
    if not console.is_terminal:
        console = Console(width=160)
    console.print(_robots(fit))
    for line in _advice(fit):
        print(textwrap.fill(line, WIDTH, subsequent_indent="  "))


def _kind(fit: SurfaceFit) -> str:
    rms = ", ".join(f"{NAMES[score.kind]} {1e3 * score.held_out_m:.3f}" for score in fit.scores)
    rank = [score.kind for score in fit.scores].index(fit.kind)
    why = "nothing simpler tells them as well" if rank else "nothing richer tells them better"
    if rank and rank + 1 < len(fit.scores):
        why += ", and nothing richer better by more than chance"
    return (
        f"the surface is {NAMES[fit.kind]}: places that it was not fitted to are so many mm off {rms} (RMS, with the "
        f"poses' noise); {why}"
    )


def _places(fit: SurfaceFit) -> str:
    out = len(fit.used) - int(fit.used.sum())
    left = f"; {out} more are left out: lifted, or by a wrong tilt" if out else ""
    return (
        f"from {fit.used.sum()} places where robots stood, {1e3 * fit.rms_m:.3f} mm off it (RMS){left}; they visited "
        f"{fit.area_m2:.4f} m2, and beyond that there is no surface"
    )


def _sure(fit: SurfaceFit) -> str:
    low, mean, high = _sigmas(fit)
    return (
        f"it is known within {mean:.3f} mm ({low:.3f} to {high:.3f}, one sigma) and "
        f"{np.degrees(fit.surface.tilt_sigma_rad):.3f} degrees: noise, what robots are off by themselves, and what it "
        "is too stiff to follow"
    )


def shared_text(shared_m: float, told_by: str) -> str:
    """What the lens may be off, which no file says."""
    by = "ASSUMED" if told_by == "assumed" else f"by {told_by}"
    text = (
        f"beside that, what the lens may be off moves it with all poses by {1e3 * shared_m:.3f} mm ({by}); that is in "
        "no file, since all poses through the lens share it"
    )
    return textwrap.fill(text, WIDTH, subsequent_indent="  ")


def _sigmas(fit: SurfaceFit) -> tuple[float, float, float]:
    sigmas = 1e3 * fit.map.sigmas[np.isfinite(fit.map.sigmas)]
    return float(sigmas.min()), float(np.sqrt((sigmas**2).mean())), float(sigmas.max())


def _robots(fit: SurfaceFit) -> Table:
    table = Table(box=None, header_style="bold", padding=(0, 1, 0, 0))
    for name in ("robot", "frames", "used", "off mm", "+-", "play mm", "leans deg", "sways deg"):
        table.add_column(name, justify="left" if name == "robot" else "right", no_wrap=True)
    for each in fit.robots:
        table.add_row(
            escape(each.id),
            str(each.touches),
            str(each.used),
            f"{1e3 * each.offset_m:+.3f}",
            f"{1e3 * each.offset_sigma_m:.3f}",
            f"{1e3 * each.play_m:.3f}",
            f"{math.degrees(each.lean_rad):.3f}",
            f"{math.degrees(each.sway_rad):.3f}",
        )
    return table


def _advice(fit: SurfaceFit) -> list[str]:
    lines = [line for each in fit.robots for line in _of_robot(each, len(fit.robots))]
    if len(fit.robots) == 1:
        lines.append(
            f"one robot drove: how far the {fit.robots[0].stands.point} of {fit.robots[0].id} is off cannot be told "
            "from the surface; 0.05 mm are assumed"
        )
    return [*lines, "next: asterism locate or serve with the new rig use it; asterism check tells of robots"]


def _of_robot(each: Stood, robots: int) -> list[str]:
    lines = []
    if robots > 1 and abs(each.offset_m) > max(CLEARLY * each.offset_sigma_m, CLEARLY_M):
        way = "higher" if each.offset_m > 0 else "lower"
        lines.append(
            f"the {each.stands.point} of {each.id} is {1e3 * abs(each.offset_m):.3f} mm {way} than the robots' mean: "
            "its LEDs or its point are off (asterism calibrate leds, asterism calibrate point)"
        )
    if each.lean_rad > LEANS_RAD and not np.isnan(each.lean_rad):
        lines.append(
            f"{each.id} leans by {math.degrees(each.lean_rad):.2f} degrees from the normal on average, which the axis "
            "of its `stands` allows for"
        )
    return lines
