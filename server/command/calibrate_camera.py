"""asterism calibrate camera: the lens model from views of a planar target."""

import argparse
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from asterism.protocol.camera import parse_camera
from asterism.protocol.errors import InputError
from asterism.protocol.keys import key_problem
from asterism.protocol.rig_files import report_path
from asterism.server.calibration.lens.board_points import Seen, find_points
from asterism.server.calibration.lens.bundle import View
from asterism.server.calibration.lens.calibration import calibrate_camera, implausible, refuse_too_few
from asterism.server.calibration.lens.camera_file import camera_text, report_text
from asterism.server.calibration.lens.coverage import COLUMNS, ROWS, empty_parts, missing, points_by_cell, signature
from asterism.server.calibration.lens.fit import CameraFit, ends_inside
from asterism.server.calibration.lens.plots import coverage_png, residuals_png
from asterism.server.calibration.lens.targets import Target, parse_target
from asterism.server.calibration.result_file import check_result_file
from asterism.server.chain.frame import Frame
from asterism.server.chain.warm_up import FINDING, warm_up
from asterism.server.command.calibrate import TARGET
from asterism.server.command.foreign_camera import FOREIGN, take_foreign
from asterism.server.command.joined import joined
from asterism.server.command.progress import progress, working
from asterism.server.command.shared_arguments import CAMERA_OR_FILES, add_out, add_ros_domain, add_server, add_topic
from asterism.server.output import new_file
from asterism.server.service.say import say
from asterism.server.sources.open_source import open_source
from asterism.server.sources.source import Source

EXAMPLES = (
    "asterism calibrate camera boards/ --target chessboard:9x6:0.025 -o camera.yaml\n"
    "asterism calibrate camera /dev/video0 --target charuco:8x6:0.028 -o camera.yaml\n"
    "asterism calibrate camera film/ --target leds:alpha.yaml -o camera.yaml\n"
    "asterism calibrate camera --from ost.yaml -o camera.yaml\n"
)

SAMPLES = 5  # images that are kept for a hint
STILL_PX = 1.0  # between two frames of a live camera: the board is held still
NEW_SHARE = 0.06  # of the image's width: a view differs so much from all before
ENOUGH_VIEWS = 25  # of a live camera, if they cover the image


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    part.add_argument("source", metavar="SOURCE", nargs="?", help=CAMERA_OR_FILES)
    add_topic(part)
    add_ros_domain(part)
    add_out(part, "camera.yaml", "what is written")
    add_server(part)
    part.add_argument("--target", metavar="TARGET", help=TARGET)
    part.add_argument("--from", metavar="FILE", dest="foreign", help=FOREIGN)
    part.add_argument(
        "--model",
        choices=["auto", "plumb_bob", "rational_polynomial", "equidistant"],
        default="auto",
        help="auto: the one with the least held-out error (default)",
    )


def run(options: argparse.Namespace) -> int:
    """Find the target, fit, write the calibration with report and plots, say how good it is; or take another's."""
    if options.foreign is not None:
        return take_foreign(options)
    if options.source is None or options.target is None:
        raise InputError(
            "expected SOURCE and --target: images of a board, and what board that is; or --from FILE, a calibration of "
            "another program's"
        )
    for path in (options.out, *_beside(options.out)):
        check_result_file(path, options.force)
    if options.source == "sim":
        raise InputError("sim: shows no calibration target; expected images, a film, a recording or a camera")
    name = options.out.stem
    if problem := key_problem(name):
        raise InputError(f"{options.out}: the camera is named after the file, and {name!r} {problem}")
    target = parse_target(options.target)
    source = open_source(options.source, None, say, topic=options.topic, ros_domain=options.ros_domain or 0)
    if target.kind == "leds":
        warm_up(*FINDING)
    search = _Search(target)
    with joined(source, options):
        if source.live:
            _watch(source, search)
        else:
            _look_through(source, search)
    refuse_too_few(search.views, search.looked_at, target, options.source, search.samples)
    width, height = search.size
    with working("fitting the lens") as doing:
        fit, held_out = calibrate_camera(search.views, width, height, target, options.model, doing)
    camera = parse_camera(camera_text(replace(fit.camera, name=name)), str(options.out))
    remarks = missing(fit)
    if ends_inside(camera):
        remarks.append("the lens model ends inside the image: LEDs near its edge have no ray")
    if hint := implausible(fit):
        remarks.append(hint)
    with working("drawing the plots"):
        plots = coverage_png(fit), residuals_png(fit)
    report = report_text(fit, target.name, options.source, held_out, remarks)
    contents = (camera_text(camera).encode(), report.encode(), *plots)
    kept = _write(dict(zip((options.out, *_beside(options.out)), contents, strict=True)), options.force)
    _tell(fit, held_out, search)
    for remark in remarks:
        print(f"warning: {remark}")
    print(f"written: {', '.join([str(options.out), *(path.name for path in _beside(options.out))])}")
    if kept:
        print(f"kept beside: {', '.join(map(str, kept))}")
    return 0


class _Search:
    """The views found so far."""

    def __init__(self, target: Target) -> None:
        self.target = target
        self.views: list[View] = []
        self.looked_at = 0
        self.samples: list[NDArray[np.uint8]] = []
        self.size = (0, 0)

    def look(self, frame: Frame) -> Seen | None:
        """The target in a frame."""
        self.looked_at += 1
        self.size = frame.image.shape[1], frame.image.shape[0]
        seen = find_points(frame.image, self.target)
        if seen is None and len(self.samples) < SAMPLES:
            self.samples.append(frame.image)
        return seen


def _look_through(source: Source, search: _Search) -> None:
    for frame in progress(source.frames(), source.length, "looking for the target"):
        seen = search.look(frame)
        if seen is not None:
            search.views.append(View(frame.name, seen))


def _watch(source: Source, search: _Search) -> None:
    """Take views from a live camera, each still and new, and say where to hold the board next; until Ctrl-C."""
    say("show the board in all parts of the image, tilted to all sides, near and far; hold it still; end with Ctrl-C")
    before: View | None = None
    try:
        for frame in source.frames():
            seen = search.look(frame)
            view = None if seen is None else View(frame.name, seen)
            still = view is not None and before is not None and _away(view, before) < STILL_PX
            if view is not None and still and _is_new(view, search):
                search.views.append(view)
                counts = points_by_cell(search.views, *search.size)
                parts = empty_parts(counts)
                say(f"{len(search.views)} views; {_map(counts)}; " + (f"next: {parts[0]}" if parts else "all covered"))
                if not parts and len(search.views) >= ENOUGH_VIEWS:
                    break
            before = view
    except KeyboardInterrupt:
        say("ended by Ctrl-C")


def _away(view: View, other: View) -> float:
    return float(np.abs(signature(view) - signature(other)).max())


def _is_new(view: View, search: _Search) -> bool:
    return all(_away(view, other) > NEW_SHARE * search.size[0] for other in search.views)


def _map(counts: NDArray[np.int64]) -> str:
    """The parts of the image, row by row: # covered, . not yet."""
    return " ".join("".join("#" if counts[row, k] >= 3 else "." for k in range(COLUMNS)) for row in range(ROWS))


def _beside(out: Path) -> tuple[Path, Path, Path]:
    """Where report and plots go."""
    return report_path(out), out.with_name(f"{out.stem}.coverage.png"), out.with_name(f"{out.stem}.residuals.png")


def _write(files: dict[Path, bytes], force: bool) -> list[Path]:
    """Write all or none; returns where older ones are kept."""
    with ExitStack() as stack:
        outputs = [stack.enter_context(new_file(path, force)) for path in files]
        for output, data in zip(outputs, files.values(), strict=True):
            output.path.write_bytes(data)
    return [output.kept for output in outputs if output.kept]


def _tell(fit: CameraFit, held_out: dict[str, float], search: _Search) -> None:
    console = Console()
    if not console.is_terminal:
        console = Console(width=160)
    console.print(
        f"the target is in {len(search.views)} of {search.looked_at} images; {len(fit.views)} views used, "
        f"{sum(len(off) for off in fit.residuals)} points, {fit.odd_points} points left out",
        highlight=False,
    )
    for name, rms in fit.odd_views:
        console.print(f"left out as a whole: {name}, {rms:.2f} px from the others' lens", highlight=False)
    table = Table(box=None, header_style="bold", padding=(0, 1))
    for name in ("model", "held out, px", ""):
        table.add_column(name, justify="right" if "px" in name else "left", no_wrap=True)
    for name, error in held_out.items():
        table.add_row(name, f"{error:.4f}", "taken" if name == fit.camera.model else "")
    console.print(table)
    table = Table(box=None, header_style="bold", padding=(0, 1))
    values = [*(fit.camera.matrix[at] for at in ((0, 0), (1, 1), (0, 2), (1, 2))), *fit.camera.distortion]
    for name in ("", "value", "sigma"):
        table.add_column(name, justify="right" if name else "left", no_wrap=True)
    for (name, sigma), value in zip(fit.sigmas.items(), values, strict=True):
        table.add_row(name, f"{value:.6g}", f"{sigma:.2g}")
    console.print(table)
    console.print(
        f"RMS distance of a point: {fit.total_rms_px:.3f} px fitted, {fit.total_held_out_px:.3f} px in views held out",
        highlight=False,
    )
