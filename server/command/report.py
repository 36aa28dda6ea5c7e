"""asterism report: the error budget of a rig and its workspace; with surveyed truth, measured beside predicted."""

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from asterism.protocol.errors import InputError
from asterism.protocol.rig import Rig, load_rig
from asterism.protocol.rig_files import UNCERTAINTY, own_path
from asterism.protocol.yaml_file import parse_yaml
from asterism.server.budget.budget import Light
from asterism.server.budget.page import assumptions, by_light_text, page
from asterism.server.budget.plots import plots_of
from asterism.server.budget.truth import Bin, Compared, bins_of, compare, light_of
from asterism.server.budget.truth_lines import is_lines, match_lines, sightings_of_lines
from asterism.server.budget.uncertainty import Uncertainty, read_uncertainty
from asterism.server.budget.workspace import Budget, budget_of
from asterism.server.calibration.leds.observations import Sighting, observe
from asterism.server.calibration.survey.survey import SurveyedFrame, match_frames, read_survey
from asterism.server.chain.warm_up import localizing, warm_up
from asterism.server.command.batch_tables import print_table
from asterism.server.command.calibrate import TRUTH
from asterism.server.command.fitted_rig import open_fitting
from asterism.server.command.progress import progress, working
from asterism.server.command.shared_arguments import FINITE_SOURCE, add_out, add_topic
from asterism.server.output import check_folder, new_folder
from asterism.server.service.batch.folder import Result, read_result
from asterism.server.service.say import say
from asterism.server.sources.open_source import refuse_endless
from asterism.server.sources.source import Source

EXAMPLES = (
    "asterism report rig.yaml -o report\n"
    "asterism report rig.yaml --truth truth.jsonl frames/ -o report\n"
    "asterism report left.yaml --truth truth.jsonl fused.jsonl -o report\n"
    "asterism report rig.yaml --batch poses -o report\n"
)

PAGE = "report.html"
TRUTH_NAME = "truth.jsonl"


class Seen(NamedTuple):
    """Frames by name with who was ``found`` in them, and the same frames ``surveyed``."""

    found: list[tuple[str, list[Sighting]]]
    surveyed: dict[str, SurveyedFrame]


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    part.add_argument("rig", metavar="RIG", help="rig.yaml")
    part.add_argument(
        "--truth",
        metavar=("TRUTH", "SOURCE"),
        nargs=2,
        help=f"measured beside predicted: {TRUTH}, and {FINITE_SOURCE}, or lines of locate or fuse",
    )
    part.add_argument(
        "--batch",
        metavar="DIR",
        type=Path,
        help="the same for all films of a batch that have a truth.jsonl beside them",
    )
    add_topic(part)
    add_out(part, "DIR", "where page and plots go, a new or empty folder")


def run(options: argparse.Namespace) -> int:
    """Write DIR/report.html and its plots, print the essence."""
    out: Path = options.out
    check_folder(out, options.force)
    rig = load_rig(options.rig)
    camera = Path(options.rig).parent / parse_yaml(rig.rig_text, options.rig).text("camera")
    uncertainty = read_uncertainty(Path(options.rig), rig.centre, camera)
    light = Light.assumed(rig.centre)
    measured = None
    if options.truth is None and options.topic is not None:
        raise InputError("--topic is for the source of --truth TRUTH SOURCE")
    if options.truth is not None and options.batch is not None:
        raise InputError("--truth and --batch exclude each other: one source, or all of a batch")
    if options.truth is not None:
        truth, name = options.truth
        refuse_endless(name, "report")
        if is_lines(name):
            compared = _compare_lines(rig, Path(truth), Path(name), uncertainty, light)
        else:
            rig, source = open_fitting(name, rig, say, options.topic)
            compared, light = _compare(rig, _observe(rig, Path(truth), source), uncertainty, light)
        measured = (compared, bins_of(compared), f"{name} beside {truth}")
    if options.batch is not None:
        result = read_result(options.batch)
        if films := _observe_batch(rig, result):
            compared, light = _compare(rig, films, uncertainty, light)
            measured = (compared, bins_of(compared), f"films of {options.batch} beside their truth")
        print_table(result)
    with working("reckoning the budget") as now:
        budget = budget_of(rig, uncertainty, light)
        now("plots")
        plots = plots_of(rig, budget, *(measured[:2] if measured else (None, [])))
    text = page(Path(options.rig).name, rig, uncertainty, light, budget, plots, measured)
    with new_folder(out, options.force) as made:
        for plot in plots:
            (made.path / plot.name).write_bytes(plot.png)
        (made.path / PAGE).write_text(text, encoding="utf-8")
    console = Console()
    if not console.is_terminal:
        console = Console(width=130)
    console.print(_known(rig, options.rig, uncertainty, light))
    console.print(_table(budget))
    if measured:
        _tell(console, measured[0], measured[1])
    print(f"written: {out / PAGE} and {len(plots)} plots beside it{made.note}")
    return 0


def _observe(rig: Rig, truth: Path, source: Source) -> Seen:
    """Who was found in a source's frames, and who was surveyed in them."""
    survey = read_survey(truth, [robot.id for robot in rig.robots])
    warm_up(*localizing(rig))
    seen = [
        (frame.name, sightings)
        for frame, sightings in observe(progress(source.frames(), source.length, "localizing"), rig)
    ]
    matched = match_frames(survey, [name for name, _ in seen], source.name)
    for remark in matched.remarks:
        say(remark)
    return Seen(seen, matched.frames)


def _observe_batch(rig: Rig, result: Result) -> Seen | None:
    """The same of all films that have truth; frames by their film and name. None where none has."""
    together = Seen([], {})
    for film in result.films:
        truth = next((path for path in _beside(Path(film.source)) if path.is_file()), None)
        if truth is None:
            say(f"{film.name}: no {TRUTH_NAME} is beside its frames")
            continue
        fitted, source = open_fitting(film.source, rig, say, result.topic)
        seen = _observe(fitted, truth, source)
        together.found.extend((f"{film.name}/{name}", sightings) for name, sightings in seen.found)
        together.surveyed.update((f"{film.name}/{name}", frame) for name, frame in seen.surveyed.items())
    return together if together.found else None


def _beside(source: Path) -> tuple[Path, ...]:
    return source / TRUTH_NAME, source.parent / TRUTH_NAME


def _compare(rig: Rig, seen: Seen, uncertainty: Uncertainty, light: Light) -> tuple[Compared, Light]:
    light = light_of(rig, light, [sighting for _, sightings in seen.found for sighting in sightings])
    return compare(rig, seen.found, seen.surveyed, uncertainty, light), light


def _compare_lines(rig: Rig, truth: Path, lines: Path, uncertainty: Uncertainty, light: Light) -> Compared:
    survey = read_survey(truth, [robot.id for robot in rig.robots])
    seen, matched, remarks = match_lines(survey, sightings_of_lines(lines, rig), str(lines))
    for remark in remarks:
        say(remark)
    say(f"measured: the poses of {lines}, about the axes of camera '{rig.camera.name}'; predicted: what it alone gives")
    return compare(rig, seen, matched, uncertainty, light)


def _known(rig: Rig, rig_name: str, uncertainty: Uncertainty, light: Light) -> Table:
    """What is taken for one standard deviation of every source, and who says so: nobody, a person, a calibration."""
    own, shared = own_path(Path(rig_name)), Path(rig_name).parent / UNCERTAINTY
    unread = uncertainty.file == own and shared.exists()
    where = f"by {uncertainty.file}" if uncertainty.file else f"neither {own.name} nor {UNCERTAINTY} is beside the rig"
    table = Table(
        title=f"what is not known exactly ({where}{f', {UNCERTAINTY} is not read' if unread else ''})",
        box=None,
        header_style="bold",
        padding=(0, 1),
    )
    table.add_column("source", no_wrap=True)
    table.add_column("one standard deviation")
    table.add_column("who says so")
    for name, what, origin in assumptions(uncertainty, light, rig):
        table.add_row(name, what, origin, style="yellow" if "assumed" in origin else "")
    return table


def _table(budget: Budget) -> Table:
    """Every source alone in the middle of the workspace, and its share of z's variance; all together at its ends."""
    near, middle, far = 0, len(budget.distances) // 2, len(budget.distances) - 1
    table = Table(
        title=f"one standard deviation, each source alone, at {budget.distances[middle]:.2f} m",
        box=None,
        header_style="bold",
        padding=(0, 1),
    )
    table.add_column("source", no_wrap=True)
    for name in ("x mm", "y mm", "z mm", "rx deg", "ry deg", "rz deg", "share of z"):
        table.add_column(name, justify="right", no_wrap=True)
    scales = np.array([1e3, 1e3, 1e3, *[np.degrees(1.0)] * 3])
    parts, whole = budget.by_distance[middle], budget.by_distance.sum(axis=1)
    for name, variances in zip(budget.sources, parts, strict=True):
        share = variances[2] / max(float(whole[middle, 2]), 1e-300)
        table.add_row(name, *(f"{value:.4f}" for value in np.sqrt(variances) * scales), f"{share:.0%}")
    for name, at in (("all together", middle), ("  near", near), ("  far", far)):
        label = name if at == middle else f"{name}, {budget.distances[at]:.2f} m"
        table.add_row(label, *(f"{value:.4f}" for value in np.sqrt(whole[at]) * scales), style="bold")
        if budget.alone is not None:
            table.add_row("  without surface", *(f"{value:.4f}" for value in np.sqrt(budget.alone[at]) * scales))
    return table


def _tell(console: Console, compared: Compared, bins: list[Bin]) -> None:
    """Every distance in two lines, so that 80 columns show all of it."""
    table = Table(title="measured RMS beside predicted one sigma", box=None, header_style="bold", padding=(0, 1))
    for name in ("at", "seen", "", "x mm", "y mm", "z mm", "rx deg", "ry deg", "rz deg"):
        table.add_column(name, justify="right", no_wrap=True)
    scales = np.array([1e3, 1e3, 1e3, *[np.degrees(1.0)] * 3])
    for part in bins:
        table.add_row(
            f"{part.distance:.2f} m", str(part.count), "measured", *(f"{a:.3f}" for a in part.measured * scales)
        )
        table.add_row("", "", "predicted", *(f"{b:.3f}" for b in part.predicted * scales), style="dim")
    console.print(table)
    if told := by_light_text(compared):
        console.print(told, highlight=False)
    whole, own = compared.nees
    console.print(
        f"{len(compared.errors)} sightings, {compared.lost} lost, {compared.flips} with the wrong tilt; squared error "
        f"over the budget's covariance {whole:.1f}, over the covariance published with each pose {own:.1f} "
        "(6 is honest)",
        highlight=False,
    )
