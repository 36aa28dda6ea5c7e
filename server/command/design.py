"""asterism design: constellations that cannot be confused, with a drill plan."""

import argparse
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from asterism.protocol.geometry import Floats
from asterism.protocol.program import typed
from asterism.protocol.rig import parse_rig
from asterism.server.chain.kernel_list import DESIGN
from asterism.server.chain.warm_up import warm_up
from asterism.server.command.number_arguments import count, positive
from asterism.server.command.progress import interruptible, working
from asterism.server.command.shared_arguments import add_out
from asterism.server.design.drill_plan import drill_plan
from asterism.server.design.page import pdf, svg
from asterism.server.design.plate_design import FOCAL_PX, HOLE_RADIUS, RIM, Design, Request, design
from asterism.server.design.plate_files import camera_text, rig_text
from asterism.server.design.telling_apart import SIGMAS, TILT_DEG, image_px
from asterism.server.output import check_folder, new_folder

EXAMPLES = "asterism design --robots 8 --disc 0.1 --spacing 0.02 --distance 1.5 --sigma 0.05 -o plates\n"


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    part.add_argument("--robots", metavar="K", type=count, required=True, help="how many constellations")
    part.add_argument("--disc", metavar="M", type=positive, required=True, help="diameter of the plates, m")
    part.add_argument("--spacing", metavar="M", type=positive, required=True, help="between two LEDs at least, m")
    part.add_argument("--distance", metavar="M", type=positive, required=True, help="from the camera at most, m")
    part.add_argument("--sigma", metavar="PX", type=positive, required=True, help="of an LED's centre, px")
    add_out(part, "DIR", "a new or empty folder")


def run(options: argparse.Namespace) -> int:
    """Write OUT/rig.yaml, camera.yaml and drill/ID.svg and .pdf; print what keeps the constellations apart."""
    out: Path = options.out
    check_folder(out, options.force)
    request = Request(options.robots, options.disc, options.spacing, options.distance, options.sigma)
    warm_up(DESIGN)
    with working("searching"):
        found = interruptible(lambda: design(request))
    rig, camera = rig_text(found), camera_text()
    parse_rig(rig, camera, str(out))
    with new_folder(out, options.force) as made:
        (made.path / "rig.yaml").write_text(rig, encoding="utf-8")
        (made.path / "camera.yaml").write_text(camera, encoding="utf-8")
        (made.path / "drill").mkdir()
        for name, layout in zip(found.names, found.layouts, strict=True):
            page = drill_plan(name, layout, request.disc, HOLE_RADIUS)
            (made.path / "drill" / f"{name}.svg").write_text(svg(page), encoding="utf-8")
            (made.path / "drill" / f"{name}.pdf").write_bytes(pdf(page))
    _tell(found)
    print(
        f"written: {out / 'rig.yaml'}; {out / 'camera.yaml'}, nominal: put your calibrated camera's in its place; "
        f"{out / 'drill'}: a drill plan of each, SVG and PDF{made.note}"
    )
    print(f"next: {typed('check', out / 'rig.yaml')}")
    return 0


def _tell(found: Design) -> None:
    asked, layouts = found.request, found.layouts
    console = Console()
    if not console.is_terminal:
        console = Console(width=160)
    apart = np.linalg.norm(layouts[:, :, None] - layouts[:, None], axis=-1) + np.eye(6)
    console.print(
        f"{asked.robots} constellation{'s' * (asked.robots > 1)} on plates of {asked.disc * 1e3:g} mm: LEDs "
        f"{apart.min() * 1e3:.2f} mm apart and {RIM * 1e3:g} mm from the edge, or more",
        highlight=False,
    )
    table = Table(box=None, header_style="bold", padding=(0, 1))
    for name in ("least separation", "LEDs", "mm", f"px at {asked.distance:g} m", f"tilted {TILT_DEG:g}°", "where"):
        table.add_column(
            name, justify="left" if name in ("least separation", "LEDs", "where") else "right", no_wrap=True
        )
    itself = np.eye(len(layouts), dtype=bool)
    for leds, separation in (("all visible", found.visible), ("one hidden", found.hidden)):
        for which, mask in (("of two robots", ~itself), ("of one and itself", itself)):
            if mask.any():
                table.add_row(which, leds, *_least(found, np.where(mask, separation, np.inf)))
    console.print(table)
    console.print(
        f"needed: {asked.needed * 1e3:.2f} mm, which is {SIGMAS:g} sigma = {SIGMAS * asked.sigma_px:g} px at "
        f"{asked.distance:g} m and {TILT_DEG:g}° of tilt for f = {FOCAL_PX:g} px; mirror images in a polished surface "
        "are reckoned with",
        highlight=False,
    )


def _least(found: Design, separation: Floats) -> tuple[str, str, str, str]:
    seen, taken = np.unravel_index(int(np.argmin(separation)), separation.shape)
    least, names = float(separation[seen, taken]), found.names
    flat, tilted = (image_px(least, FOCAL_PX, found.request.distance, tilt) for tilt in (0.0, TILT_DEG))
    where = names[seen] if seen == taken else f"{names[seen]} taken for {names[taken]}"
    return f"{least * 1e3:.2f}", f"{flat:.2f}", f"{tilted:.2f}", where
