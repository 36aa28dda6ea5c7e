"""asterism example: a folder to try everything in without hardware."""

import argparse
import shlex
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from string import Template

import numpy as np

from asterism.protocol.program import NAME, program
from asterism.protocol.rig import Robot
from asterism.server.calibration.lens.camera_file import camera_text
from asterism.server.command.example_cameras import FEWEST, MOST, files_of_several
from asterism.server.command.example_surface import files_with_surface
from asterism.server.command.example_texts import range_line, robot_lines, row
from asterism.server.command.number_arguments import whole
from asterism.server.command.shared_arguments import add_force, named
from asterism.server.output import new_folder
from asterism.server.simulation.measured_rig import BOARD, TOOL, TRUTH_MARK, MeasuredRig, draw_rig

EXAMPLES = (
    "asterism example try\n"
    "asterism example try2 --seed 2\n"
    "asterism example hall --cameras 3\n"
    "asterism example mould --surface\n"
)

README = Path(__file__).parent.parent / "simulation" / "example" / "README.md"


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    part.add_argument("out", metavar="DIR", type=named, help="a new or empty folder")
    part.add_argument(
        "--seed", metavar="N", type=whole, default=0, help="another lens, robot, ruler's errors (default: 0)"
    )
    kind = part.add_mutually_exclusive_group()
    kind.add_argument(
        "--cameras",
        metavar="N",
        type=whole,
        help=f"several cameras about one floor, {FEWEST} to {MOST}, whose places are to be calibrated",
    )
    kind.add_argument("--surface", action="store_true", help="robots that polish a mould, whose surface is to be found")
    add_force(part)


def run(options: argparse.Namespace) -> int:
    """Write DIR's files, say how to go on."""
    out: Path = options.out
    files: Mapping[str, str | bytes]
    if options.surface:
        files, what = files_with_surface(options.seed), "a rig, a mould as it is and as it was drawn"
    elif options.cameras is None:
        files, what = files_of(draw_rig(options.seed), options.seed), "a rig as it is and as you would measure it"
    else:
        files = files_of_several(options.cameras, options.seed)
        what = f"{options.cameras} cameras' rigs as they are and as you would measure them"
    with new_folder(out, options.force) as made:
        for name, text in files.items():
            (made.path / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    print(f"written: README.md, {what}, in {out}{made.note}")
    if program() != NAME:
        # README.md says `asterism`, and a relative path would not lead there from inside the folder.
        print(f"go on:   export PATH={shlex.quote(str(Path(sys.executable).parent))}:$PATH")
        print(f"then:    cd {shlex.quote(str(out))} and paste the commands of README.md, line by line")
    else:
        print(f"go on:   cd {shlex.quote(str(out))} and paste the commands of README.md, line by line")
    return 0


def files_of(rig: MeasuredRig, seed: int) -> dict[str, str]:
    """The folder's files by name."""
    first, second, metres = rig.calipers
    return {
        "README.md": Template(README.read_text(encoding="utf-8")).substitute(
            seed=seed, first=first, second=second, distance=f"{metres:.5f}", mm=f"{1e3 * metres:.2f}"
        ),
        "true-camera.yaml": f"{TRUTH_MARK}\n{camera_text(rig.true.camera)}",
        "true.yaml": _true_text(rig, rig.true.robots[0], world=True),
        "true-board.yaml": _true_text(rig, rig.board, world=False),
        "board.yaml": _board_text(),
        "rig.yaml": _rig_text(rig),
    }


def _true_text(rig: MeasuredRig, robot: Robot, world: bool) -> str:
    lines = [TRUTH_MARK, "camera: true-camera.yaml", range_line(rig.true)]
    place = rig.true.T_world_camera
    if world and place is not None:
        lines += ["world:                              # T_world_camera"]
        lines += [f"  position: {row(place.position, 6)}", f"  orientation: {row(place.orientation, 9)}"]
    return "\n".join([*lines, "robots:", *robot_lines(robot, 7, "m, to a tenth of a micrometre")]) + "\n"


def _rig_text(rig: MeasuredRig) -> str:
    lines = [
        "# The rig as you would write it on the first day: nothing is calibrated, LEDs were measured with a ruler.",
        "camera: camera.yaml                 # there is none yet: asterism calibrate camera makes it",
        range_line(rig.true),
    ]
    drawn = replace(rig.true.robots[0], leds=rig.ruler, points={"tool": np.array(TOOL)})
    return "\n".join([*lines, "robots:", *robot_lines(drawn, 4, "m, read to half a millimetre")]) + "\n"


def _board_text() -> str:
    rows = [f"  - [{x:.3f}, {y:.3f}, 0.0]" for x, y in BOARD]
    return "\n".join(["# A circuit board with six LEDs, as its drawing has it, m.", "leds:", *rows]) + "\n"
