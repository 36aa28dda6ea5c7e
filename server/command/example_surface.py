"""What `asterism example --surface` writes: a mould as it is and as it was drawn, a rig that knows nothing of it."""

from dataclasses import replace
from pathlib import Path
from string import Template

from asterism.protocol.geometry import Pose
from asterism.protocol.heights_file import heights_text
from asterism.protocol.rig import Rig
from asterism.protocol.surface import Heights
from asterism.server.calibration.lens.camera_file import camera_text
from asterism.server.command.example_texts import range_line, robot_lines, row, world_lines
from asterism.server.simulation.measured_mould import BOTTOM_M, MeasuredMould, draw_mould
from asterism.server.simulation.measured_rig import TRUTH_MARK
from asterism.server.simulation.stl_writer import block_stl

README = Path(__file__).parent.parent / "simulation" / "example" / "surface.md"
TRUE_MOULD = "true-mould.csv"
UNCERTAINTY = """# How well the rig is known, one standard deviation each, since it was calibrated.
led_position_m: 0.00001             # of each LED, m
focal_relative: 0.0001              # of the focal length, as a share
principal_point_px: 0.1
distortion_relative: 0.001
"""


def files_with_surface(seed: int) -> dict[str, str | bytes]:
    """The folder's files by name."""
    mould = draw_mould(seed)
    surface = mould.true.surface
    assert surface is not None
    assert isinstance(surface.shape, Heights)
    x, y = mould.dent
    return {
        "README.md": Template(README.read_text(encoding="utf-8")).substitute(
            seed=seed, dent_x=f"{x:.2f}", dent_y=f"{y:.2f}"
        ),
        "camera.yaml": camera_text(mould.true.camera),
        "rig.yaml": _rig(_bare(mould), "# The rig, calibrated; nothing is known yet of what robots stand on.", []),
        "uncertainty.yaml": UNCERTAINTY,
        "mould.stl": block_stl(mould.drawing, BOTTOM_M),
        "true.yaml": _rig(mould.true, TRUTH_MARK, _surface_lines(surface.T_world_surface)),
        TRUE_MOULD: f"{TRUTH_MARK}\n{heights_text(surface.shape)}",
    }


def _bare(mould: MeasuredMould) -> Rig:
    """The rig whose robots stand on nothing that is known."""
    robots = tuple(replace(robot, stands=None) for robot in mould.true.robots)
    return replace(mould.true, robots=robots, surface=None)


def _rig(rig: Rig, remark: str, surface: list[str]) -> str:
    place = rig.T_world_camera
    assert place is not None
    lines = [remark, "camera: camera.yaml", range_line(rig), *world_lines(place, 6), *surface, "robots:"]
    for robot in rig.robots:
        lines += robot_lines(robot, 4, "m")
    return "\n".join(lines) + "\n"


def _surface_lines(frame: Pose) -> list[str]:
    return [
        "surface:",
        f"  heights: {TRUE_MOULD}",
        f"  frame: {{position: {row(frame.position, 6)}, orientation: {row(frame.orientation, 9)}}}",
    ]
