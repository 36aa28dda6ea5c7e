"""The error budget as one HTML page that needs nothing but itself."""

import base64
from collections.abc import Iterable
from html import escape

import numpy as np

from asterism import __version__
from asterism.protocol.geometry import Floats
from asterism.protocol.rig import Rig
from asterism.protocol.rig_files import UNCERTAINTY
from asterism.server.budget.budget import COMPONENTS, LEAST_TILT, SOURCES, Light, sources_of
from asterism.server.budget.plots import SCALES, SURFACE, UNITS, Plot
from asterism.server.budget.standing import surface_sigmas
from asterism.server.budget.truth import Bin, Compared
from asterism.server.budget.uncertainty import Uncertainty
from asterism.server.budget.workspace import Budget

_PHONE = "(max-width: 640px)"
_STYLE = f"""
body {{ font: 100%/1.5 system-ui, sans-serif; color: #1b1b1b; max-width: 76rem; margin: 1.5rem auto;
  padding: 0 max(1rem, env(safe-area-inset-left)); -webkit-text-size-adjust: 100%; }}
h1 {{ font-size: 1.6rem; line-height: 1.25; overflow-wrap: anywhere; margin-bottom: .2rem; }}
h2 {{ font-size: 1.25rem; margin-top: 2.2rem; }}
p, figcaption {{ max-width: 60rem; overflow-wrap: anywhere; }}
.wide {{ overflow-x: auto; margin: 1rem 0; }}
table {{ border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: .93rem; }}
th, td {{ padding: .25rem .7rem; text-align: right; border-bottom: 1px solid #ddd; vertical-align: top; }}
th {{ border-bottom: 2px solid #888; white-space: nowrap; }}
th:first-child, td:first-child, td.text, th.text {{ text-align: left; }}
.numbers th:first-child, .numbers td:first-child {{ position: sticky; left: 0; background: #fff; white-space: nowrap; }}
.numbers td {{ white-space: nowrap; }}
tr.all td {{ font-weight: 700; border-top: 2px solid #888; }}
figure {{ margin: 1.4rem 0 2rem; }} figcaption {{ color: #444; }} img {{ max-width: 100%; height: auto; }}
.given {{ color: #00603f; font-weight: 600; }} .assumed {{ color: #9a4a00; }}
@media {_PHONE} {{
  th, td {{ padding: .25rem .3rem; font-size: .9em; }}
  .sources tr {{ display: block; border-bottom: 1px solid #ddd; padding: .4rem 0; }}
  .sources th {{ display: none; }} .sources td {{ display: block; border: 0; padding: 0; }}
  .sources td:first-child {{ font-weight: 600; }}
  picture img {{ width: 100%; }}
}}
"""


def page(
    rig_name: str, rig: Rig, uncertainty: Uncertainty, light: Light, budget: Budget, plots: list[Plot],
    measured: tuple[Compared, list[Bin], str] | None,
) -> str:  # fmt: skip
    """The page as text. ``measured`` holds the comparison with a survey, its bins, and what was compared."""
    camera = rig.camera
    pictures = {plot.name: _figure(plot) for plot in plots}
    shown = ", ".join(budget.robots)
    parts = [
        "<!DOCTYPE html>",
        '<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>Error budget of {escape(rig_name)}</title><style>{_STYLE}</style></head><body>",
        f"<h1>Error budget of {escape(rig_name)}</h1>",
        f"<p>Camera {escape(camera.name)}, {camera.width} x {camera.height} px, f = {camera.focal_px:.0f} px, "
        f"{escape(camera.model)}; {_robots(len(rig.robots), len(budget.robots), shown)}; "
        f"{budget.distances[0]:.2f} to {budget.distances[-1]:.2f} m"
        f"{'' if rig.range_m is not None else ' (the rig names no range: where its robots can be seen at all)'}. "
        f"Asterism {escape(__version__)}.</p>",
        "<p>What every source of error alone, and all together, do to a pose: one standard deviation of the position "
        "of the robot&#8217;s origin along the camera&#8217;s axes (x right, y down, z forward) and of its rotation "
        "about them. First order, carried through the weighted least squares that the solver does; valid for tilts "
        f"from {LEAST_TILT:g} degrees on, and for the right one of a plate&#8217;s two tilts. Where the camera stands "
        "in the world is not part of it.</p>",
        "<h2>What is not known exactly</h2>",
        _sources(uncertainty, light, rig),
        f"<p>Assumed numbers are replaced by those in a file <code>{UNCERTAINTY}</code> beside the rig.</p>",
        "<h2>Near, in the middle, far</h2>",
        *(_table(budget, row) for row in (0, len(budget.distances) // 2, len(budget.distances) - 1)),
        pictures["shares.png"],
        "<h2>Against distance</h2>",
        pictures["distance.png"],
        "<h2>Against the place in the image</h2>",
        pictures["place.png"],
        "<h2>Against tilt</h2>",
        pictures["tilt.png"],
    ]
    if SURFACE in pictures:
        parts += ["<h2>The surface</h2>", pictures[SURFACE]]
    if measured is not None:
        parts += ["<h2>Measured beside predicted</h2>", *_measured(*measured), pictures["measured.png"]]
    return "\n".join([*parts, "</body></html>\n"])


def assumptions(uncertainty: Uncertainty, light: Light, rig: Rig) -> list[tuple[str, str, str]]:
    """For every source its name, what is taken for one standard deviation, and whether that is given or assumed."""
    look, u = light.look, uncertainty

    light_text = (
        f"Cramer-Rao bound at the LED's size in the image times {np.sqrt(light.factor):.2f} "
        f"({look.brightness:g} grey levels, blur {look.psf_px:g} px, read noise {look.read_noise:g}, "
        f"shot noise {look.gain:g} per grey level"
        f"{'' if all(r.led_radius for r in rig.robots) else '; LED radius 2.5 mm where the rig does not say'})"
    )
    centre = f"{u.centre_px:g} px per axis" if u.centre_px is not None else light_text
    noise_origin = "from the frames" if light.measured and u.centre_px is None else u.origin("centre_px")
    bent = "" if np.any(rig.camera.distortion) else "; this lens has none"
    eccentric = all(robot.led_radius for robot in rig.robots)
    return [
        ("centre noise", centre, noise_origin),
        (
            "quantisation",
            "within centre_px" if u.centre_px is not None else "rounding to whole grey levels, variance 1/12, on top",
            noise_origin,
        ),
        (
            "centre bias",
            f"{u.bias_px:g} px per axis"
            + ("" if eccentric else "; perspective eccentricity, not compensated without led.radius"),
            u.origin("bias_px"),
        ),
        ("LED positions", *_leds(u, rig)),
        ("LED angular offset", *_offset(u, rig)),
        ("focal length", f"{u.focal_relative:.3%}", u.origin("focal_relative")),
        ("principal point", f"{u.principal_point_px:.3g} px per axis", u.origin("principal_point_px")),
        ("distortion", f"{u.distortion_relative:.2%} of its displacements{bent}", u.origin("distortion_relative")),
        *(_surface(rig) if sources_of(rig) != SOURCES else ()),
    ]


def _surface(rig: Rig) -> list[tuple[str, str, str]]:
    """What the rig says of its surface, and of how robots stand on it."""
    height, tilt, _ = surface_sigmas(rig).tolist()
    stands: dict[str, list[str]] = {}
    for robot in rig.robots:
        if robot.stands is not None:
            told = f"{robot.stands.sigma_m * 1e3:.3g} mm"
            if np.isfinite(robot.stands.tilt_sigma_rad):
                told += f" and {np.degrees(robot.stands.tilt_sigma_rad):.3g} degrees"
            stands.setdefault(told, []).append(robot.id)
    which = len(stands) > 1 or any(robot.stands is None for robot in rig.robots)
    how = "; ".join(told + (f" ({', '.join(names)})" if which else "") for told, names in stands.items())
    known = f"{height * 1e3:.3g} mm along its normal, {np.degrees(tilt):.3g} degrees"
    return [("surface", known, "given: the rig"), ("stand on it", how, "given: the rig")]


def _robots(all_of_them: int, looked_at: int, names: str) -> str:
    if all_of_them == looked_at:
        return f"{all_of_them} robot{'s' if all_of_them > 1 else ''} ({escape(names)})"
    return f"{all_of_them} robots, {looked_at} of them looked at ({escape(names)})"


def _offset(uncertainty: Uncertainty, rig: Rig) -> tuple[str, str]:
    """What is taken for the shift of the LEDs' light, and where that is from."""
    measured = [robot.id for robot in rig.robots if robot.led_offset is not None and len(robot.led_offset.doubts)]
    if not measured or "offset_m" in uncertainty.given:
        return f"{uncertainty.offset_m * 1e3:g} mm at 45 degrees, all LEDs alike", uncertainty.origin("offset_m")
    told = f"what the led.yaml leaves open ({', '.join(measured)})"
    if len(measured) == len(rig.robots):
        return told, "measured: calibrate offset"
    others = f"{uncertainty.offset_m * 1e3:g} mm at 45 degrees (the others)"
    return f"{told}; {others}", "measured: calibrate offset; assumed"


def _leds(uncertainty: Uncertainty, rig: Rig) -> tuple[str, str]:
    """What is taken for the LEDs' positions, and where that is from; robot by robot where they differ."""
    known = {robot.id: uncertainty.leds_of(robot.id) for robot in rig.robots}
    what, by = [], []
    for each in dict.fromkeys(known.values()):
        names = ", ".join(name for name, error in known.items() if error == each)
        size = f", {each.size_relative:.2%} of their size" if each.size_relative else ""
        which = f" ({names})" if len(set(known.values())) > 1 else ""
        what.append(f"{each.position_m * 1e3:.3g} mm per axis{size}{which}")
        by.append(f"{each.by}{which}")
    return "; ".join(what), "; ".join(by)


def _sources(uncertainty: Uncertainty, light: Light, rig: Rig) -> str:
    rows = [
        f'<tr><td>{escape(name)}</td><td class="text">{escape(what)}</td>'
        f'<td class="text {"assumed" if "assumed" in origin else "given"}">{escape(origin)}</td></tr>'
        for name, what, origin in assumptions(uncertainty, light, rig)
    ]
    head = '<tr><th>source</th><th class="text">one standard deviation</th><th class="text">origin</th></tr>'
    return _scrolled("sources", f"{head}{''.join(rows)}")


def _table(budget: Budget, row: int) -> str:
    variances = budget.by_distance[row]
    lines = [_row(name, np.sqrt(variance), "") for name, variance in zip(budget.sources, variances, strict=True)]
    lines.append(_row("all together", np.sqrt(variances.sum(axis=0)), "all"))
    if budget.alone is not None:
        lines.append(_row("without the surface", np.sqrt(budget.alone[row]), ""))
    head = "".join(f"<th>{name}, {unit}</th>" for name, unit in zip(COMPONENTS, UNITS, strict=True))
    return _scrolled("numbers", f"<tr><th>at {budget.distances[row]:.2f} m</th>{head}</tr>{''.join(lines)}")


def _scrolled(kind: str, rows: str) -> str:
    """A table that is moved sideways on its own where the page is narrower than it."""
    return f'<div class="wide"><table class="{kind}">{rows}</table></div>'


def _row(name: str, sigmas: Floats, kind: str) -> str:
    return f'<tr class="{kind}"><td>{escape(name)}</td>{_cells(f"{value:.4f}" for value in sigmas * SCALES)}</tr>'


def _cells(texts: Iterable[str]) -> str:
    return "".join(f"<td>{escape(text)}</td>" for text in texts)


def _measured(compared: Compared, bins: list[Bin], what: str) -> list[str]:
    head = "".join(f"<th>{name}, {unit}</th>" for name, unit in zip(COMPONENTS, UNITS, strict=True))
    rows = []
    for part in bins:
        texts = (f"{a:.4f} / {b:.4f}" for a, b in zip(part.measured * SCALES, part.predicted * SCALES, strict=True))
        rows.append(f"<tr><td>{part.distance:.2f} m</td><td>{part.count}</td>{_cells(texts)}</tr>")
    whole, own = compared.nees
    return [
        f"<p>{escape(what)}: {len(compared.errors)} sightings, {compared.lost} lost, {compared.flips} with the wrong "
        "one of two tilts (left out below). Each cell: measured RMS / predicted one sigma.</p>",
        _scrolled("numbers", f"<tr><th>distance</th><th>sightings</th>{head}</tr>{''.join(rows)}"),
        *([f"<p>{told}</p>"] if (told := by_light_text(compared)) else []),
        f"<p>Squared error weighted by the budget&#8217;s covariance averages {whole:.1f}, by the chain&#8217;s own "
        f"{own:.1f}; 6 is honest. One rig is one throw of its systematic errors: its measured errors lie about the "
        "predicted ones, more or less, and only many rigs agree with them on average.</p>",
    ]


def by_light_text(compared: Compared) -> str:
    """What the sightings that rest on the surface would be without it; nothing where none does."""
    if not len(compared.by_light):
        return ""
    rms = np.sqrt(np.square(compared.by_light).mean(axis=0)) * SCALES
    told = ", ".join(f"{name} {value:.3f} {unit}" for name, value, unit in zip(COMPONENTS, rms, UNITS, strict=True))
    return f"{len(compared.by_light)} sightings rest on the surface too; by light alone their RMS errors are {told}."


def _figure(plot: Plot) -> str:
    caption = escape(plot.caption)
    return (
        f'<figure><picture><source media="{_PHONE}" srcset="{_data(plot.narrow)}">'
        f'<img src="{_data(plot.png)}" alt="{caption}"></picture><figcaption>{caption}</figcaption></figure>'
    )


def _data(png: bytes) -> str:
    return f"data:image/png;base64,{base64.b64encode(png).decode('ascii')}"
