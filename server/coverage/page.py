"""A map as one HTML page that needs nothing but itself."""

import base64
from collections.abc import Iterable, Sequence
from html import escape

from asterism import __version__
from asterism.server.coverage.pictures import Picture
from asterism.server.coverage.regions import LEAST_OVERWORKED, OVERWORKED, Region, Regions, median_dwell
from asterism.server.coverage.summary import Summary, area, began, mean_speed, time, visited_m2, when
from asterism.server.coverage.visits import REASONS, Visits

SHOWN = 50  # regions of a list; all of them are in its file
MUCH_LEFT_OUT = 0.1  # of a robot's poses: said in bold
_STYLE = """
:root { color-scheme: light dark; --ink: #1b1b1b; --ground: #fff; --line: #d8d8d8; --soft: #555; --warn: #9a3b00; }
@media screen and (prefers-color-scheme: dark) {
  :root { --ink: #e4e4e4; --ground: #16181c; --line: #3a3d44; --soft: #a6a6a6; --warn: #ff9d5c; }
}
body { font: 100%/1.5 system-ui, sans-serif; color: var(--ink); background: var(--ground); max-width: 66rem;
  margin: 1.5rem auto; padding: 0 1rem; }
h1 { font-size: 1.6rem; line-height: 1.25; overflow-wrap: anywhere; margin-bottom: .2rem; }
h2 { font-size: 1.25rem; margin-top: 2rem; break-after: avoid; }
p, figcaption { max-width: 60rem; overflow-wrap: anywhere; }
.wide { overflow-x: auto; margin: .8rem 0; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: .93rem; }
th, td { padding: .25rem .7rem; text-align: right; border-bottom: 1px solid var(--line); vertical-align: top; }
th { border-bottom: 2px solid var(--soft); }
th:first-child, td:first-child, td.text, th.text { text-align: left; overflow-wrap: anywhere; }
tr { break-inside: avoid; } tr.all td { font-weight: 700; border-top: 2px solid var(--soft); }
figure { margin: 1.2rem 0 1.6rem; break-inside: avoid; } figcaption { color: var(--soft); }
img { max-width: 100%; height: auto; } .warn { color: var(--warn); font-weight: 600; }
@media print { body { margin: 0; max-width: none; font-size: 80%; } img { max-height: 20cm; } }
"""
_WHY = {
    "not tracked": "the robot was lost, or its pose ambiguous",
    "not sure enough": "one sigma of the tool's place across the surface was more than half the tool's radius",
    "lifted": "the tool was above the surface",
    "sunk": "or below: the surface is not where the rig has it",
    "tilted": "the robot's axis was not along the surface's normal",
    "beyond the edge": "there is no surface under the tool",
    "off the map": "so far away that the map would be too large",
    "gap": "times between two poses too long to know the way",
}


def page(told: Summary, pictures: Sequence[Picture], files: Sequence[tuple[str, str]]) -> str:
    """The page as text; ``files`` lie beside it: names, and what is in them."""
    title = f"Coverage, camera {escape(told.camera)}"
    shown = {picture.name: _figure(picture) for picture in pictures}
    together = [shown[picture.name] for picture in pictures if not picture.name.endswith("-by-robot.png")]
    by_robot = [shown[picture.name] for picture in pictures if picture.name.endswith("-by-robot.png")]
    parts = [
        "<!DOCTYPE html>",
        '<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{title}</title><style>{_STYLE}</style></head><body>",
        f"<h1>{title}</h1>",
        f"<p>{_essence(told)}</p>",
        "<h2>What counts, and what was left out</h2>",
        _left_out(told),
        "<h2>Recordings</h2>",
        _recordings(told),
        "<h2>Robots</h2>",
        _robots(told),
        *together[:1],
        f"<h2>Gaps: {len(told.gaps.found)}</h2>",
        f"<p>{_gap_rule(told)}</p>",
        _regions(told.gaps, "gaps.csv"),
        f"<h2>Overworked patches: {len(told.overworked.found)}</h2>",
        f"<p>{_much_rule(told)}</p>",
        _regions(told.overworked, "overworked.csv"),
        "<h2>Passes, speed, last visit</h2>",
        *together[1:],
        "<h2>Robot by robot</h2>",
        *by_robot,
        "<h2>Files</h2>",
        _table(("file", "what is in it"), [(name, what) for name, what in files], words=2),
    ]
    return "\n".join([*parts, "</body></html>\n"])


def _essence(told: Summary) -> str:
    grid, covered = told.covered.grid, told.covered
    visited, whole = told.visited_m2, grid.area_m2
    if grid.ends:
        part = f"<b>{visited / whole:.1%}</b> of the surface was under a tool: " if whole else ""
        much = f"{part}{area(visited)} of {area(whole)}."
    else:
        much = f"<b>{area(visited)}</b> was under a tool; the surface has no end of its own, so no share can be told."
    times = (
        f"{escape(began(covered.since_ns))} to {escape(when(covered.until_ns))}" if covered.until_ns else "no frames"
    )
    radii = sorted({visits.radius_m for visits in covered.robots.values()})
    discs = " to ".join(f"{radius * 1e3:.3g}" for radius in dict.fromkeys((radii[0], radii[-1])))
    return (
        f"{times}. {much} A tool is a disc with a radius of {discs} mm in the surface's tangent plane; patches are "
        f"{grid.pitch_m * 1e3:.3g} mm wide, and one was visited when its middle was under a tool. "
        f"Asterism {escape(__version__)}."
    )


def _left_out(told: Summary) -> str:
    seen = [reason for reason in REASONS if told.whole.left_out.get(reason)]
    if not seen:
        return "<p>Nothing was left out: every pose counted.</p>"
    rows = [_counts(robot, visits, seen) for robot, visits in told.covered.robots.items()]
    rows.append(_counts("all", told.whole, seen))
    why = "; ".join(f"<i>{reason}</i>: {escape(_WHY[reason])}" for reason in seen)
    poses = sum(told.whole.left_out.get(reason, 0) for reason in seen if reason != "gap")
    total = told.whole.counted + poses
    share = poses / total if total else 0.0
    word = f'<span class="warn">{share:.1%}</span>' if share > MUCH_LEFT_OUT else f"{share:.1%}"
    return (
        f"<p>{word} of all poses do not say where a tool was, and were left out. {why}.</p>"
        f"{_table(('robot', 'counted', 'time', *seen), rows)}"
    )


def _counts(robot: str, visits: Visits, reasons: Iterable[str]) -> tuple[str, ...]:
    return robot, str(visits.counted), time(visits.counted_s), *(str(visits.left_out.get(why, 0)) for why in reasons)


def _recordings(told: Summary) -> str:
    rows = [
        (each.name, began(each.since_ns), when(each.until_ns), area(each.over_m2), area(each.new_m2),
         time(each.counted_s), str(each.left_out))
        for each in told.added
    ]  # fmt: skip
    head = ("recording", "from", "to", "under a tool", "for the first time", "time, all tools", "left out")
    return _table(head, rows)


def _robots(told: Summary) -> str:
    rows = [_robot(told, robot, visits) for robot, visits in told.covered.robots.items()]
    rows.append(_robot(told, "all", told.whole))
    head = ("robot", "tool, mm", "under its tool", "share", "time", "median dwell", "most dwell", "mean speed")
    return _table(head, rows)


def _robot(told: Summary, robot: str, visits: Visits) -> tuple[str, ...]:
    over, whole = visited_m2(told.covered, visits), told.covered.grid.area_m2
    share = f"{over / whole:.1%}" if told.covered.grid.ends and whole else ""
    most = float(visits.dwell_s.max(initial=0.0))
    speed = f"{mean_speed(visits) * 1e3:.3g} mm/s" if most else ""
    tool = f"{visits.radius_m * 1e3:.3g}"
    return robot, tool, area(over), share, time(visits.counted_s), time(median_dwell(visits)), time(most), speed


def _gap_rule(told: Summary) -> str:
    less = f", or for less than {time(told.least_s)} in all" if told.least_s else ""
    ends = "" if told.covered.grid.ends else " The surface has no end of its own: only what is closed in is a gap."
    return (
        f"Connected parts of the surface that no tool has been over{less}.{ends} "
        f"{_specks(told.gaps, 'the tool&#8217;s area')}"
    )


def _much_rule(told: Summary) -> str:
    if not told.overworked.limit_s:
        return "Nothing was visited."
    least = f"{LEAST_OVERWORKED:g} of the tool&#8217;s area"
    return (
        f"Connected parts over which tools were longer than {time(told.overworked.limit_s)}: {OVERWORKED:g} times the "
        f"median dwell of all visited patches. {_specks(told.overworked, least)}"
    )


def _specks(regions: Regions, least: str) -> str:
    if not regions.specks:
        return f"None was left out for being smaller than {least}, {area(regions.least_m2)}."
    much = area(regions.specks_m2)
    return f"Left out as smaller than {least}, {area(regions.least_m2)}: {regions.specks}, {much} in all."


def _regions(regions: Regions, file: str) -> str:
    if not regions.found:
        return "<p>None.</p>"
    more = len(regions.found) - SHOWN
    rest = f"<p>{more} more are in <code>{file}</code>.</p>" if more > 0 else ""
    head = ("no.", "area", "x, y, z in the world, m", "length x width, mm", "mean dwell", "most dwell", "by", "last")
    return _table(head, [_region(each) for each in regions.found[:SHOWN]]) + rest


def _region(region: Region) -> tuple[str, ...]:
    place = ", ".join(f"{value:.3f}" for value in (region.place + 0.0).tolist())
    robots = ", ".join(f"{robot} {share:.0%}" for robot, share in region.robots) or "nobody"
    size = f"{region.length_m * 1e3:.0f} x {region.width_m * 1e3:.0f}"
    dwell = time(region.mean_s), time(region.most_s)
    return str(region.number), area(region.area_m2), place, size, *dwell, robots, when(region.last_ns)


def _table(head: Sequence[str], rows: Iterable[Sequence[str]], words: int = 1) -> str:
    """``words``: so many columns are text."""

    def line(cells: Sequence[str], tag: str) -> str:
        kinds = [' class="text"' if k < words else "" for k in range(len(cells))]
        texts = "".join(f"<{tag}{kind}>{escape(cell)}</{tag}>" for kind, cell in zip(kinds, cells, strict=True))
        row = '<tr class="all">' if cells[0] == "all" else "<tr>"
        return f"{row}{texts}</tr>"

    return f'<div class="wide"><table>{line(head, "th")}{"".join(line(row, "td") for row in rows)}</table></div>'


def _figure(picture: Picture) -> str:
    caption, data = escape(picture.caption), base64.b64encode(picture.png).decode("ascii")
    return (
        f'<figure><img src="data:image/png;base64,{data}" alt="{caption}"><figcaption>{caption}</figcaption></figure>'
    )
