"""asterism coverage: where tools have been on the surface, out of recordings."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from asterism.server.command.number_arguments import positive
from asterism.server.command.shared_arguments import add_force, named

if TYPE_CHECKING:
    from asterism.server.coverage.added import Added
    from asterism.server.coverage.days import Day
    from asterism.server.coverage.visits import CoverageMap

EXAMPLES = (
    "asterism coverage RECORDING -o map\n"
    "asterism coverage monday tuesday --tool-radius 0.015 -o map\n"
    "asterism coverage recordings -o map\n"
)


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    part.add_argument(
        "recordings", metavar="RECORDING", nargs="+", type=Path,
        help="a recording of robots that stand on the rig's surface; several are joined, as are those in a folder",
    )  # fmt: skip
    part.add_argument(
        "--tool-radius", metavar="METRES", type=positive,
        help="of every robot's tool, a disc about the point on which it stands (default: as the rig has it in "
        "`stands: {radius: ...}`, else 0.01)",
    )  # fmt: skip
    part.add_argument("-o", "--out", metavar="DIR", type=named, required=True, help="folder for what is found")
    add_force(part)


def run(options: argparse.Namespace) -> int:
    """Add the recordings up, print the table, write the folder."""
    from asterism.server.chain.kernel_list import COVERAGE
    from asterism.server.chain.warm_up import warm_up
    from asterism.server.command.coverage_tables import print_coverage
    from asterism.server.command.progress import working
    from asterism.server.coverage.days import days_of
    from asterism.server.coverage.folder import write_folder
    from asterism.server.coverage.summary import Summary
    from asterism.server.output import check_folder, new_folder
    from asterism.server.service.say import say

    check_folder(options.out, options.force)
    with working("reading what there is"):
        days, passed = days_of(options.recordings, options.tool_radius)
    for day in passed:
        say(f"{day.path}: passed over, what was joined of its camera '{day.camera}' is there as well")
    warm_up(COVERAGE)
    found, added = added_up(days)
    print_coverage(found, added)
    cameras = ", ".join(dict.fromkeys(day.camera for day in days))
    with new_folder(options.out, options.force) as out, working("drawing"):
        told = write_folder(Summary.of(cameras, found, added), out.path)
    say(f"wrote {options.out}{out.note}")
    if told:
        say(told)
    return 0


def added_up(days: "list[Day]") -> "tuple[CoverageMap, list[Added]]":
    """The map of all, and what each recording added to it."""
    from asterism.server.command.progress import working
    from asterism.server.coverage.accumulate import Coverage
    from asterism.server.coverage.added import added_by
    from asterism.server.coverage.grid import pitch_for
    from asterism.server.coverage.recorded import add_recorded
    from asterism.server.coverage.working import FINEST, MOST_PATCHES

    tools = {robot: tool for day in days for part in day.parts for robot, tool in part.tools.items()}
    surface, least = days[0].parts[0].surface, min(tool.radius_m for tool in tools.values())
    pitch = pitch_for(surface, least, FINEST, MOST_PATCHES)
    coverage, added = Coverage.none(surface, tools, pitch, MOST_PATCHES), []
    chunks, read = sum(len(part.file.chunks) for day in days for part in day.parts), 0
    with working("adding up where tools were") as now:

        def show(more: int) -> None:
            nonlocal read
            read += more
            now(f"{min(100, 100 * read // max(chunks, 1))} %")

        for day in days:
            before = coverage.map
            coverage = add_recorded(coverage.cut(), day.parts, show)
            added.append(added_by(str(day.path), *day.span, before, coverage.map))
    return coverage.map, added
