"""The tables of docs/hardware.md: spots and what poses are worth, by distance: `python -m docs.programs.spots`.

Computed by the product's own bounds: the centre of an LED's image from its light (server/centres/centre_noise.py), the
pose from its centres (server/design/pose_bounds.py), for the demonstration's robot `alpha`. A test compares the page
with them.
"""

import math
import re

from docs.programs.tree import REPOSITORY

from asterism.protocol.geometry import Floats
from asterism.protocol.rig import load_rig
from asterism.server.centres.centre_noise import centre_variances
from asterism.server.design.pose_bounds import pose_bound
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.simulation.simulate import Look

PAGE = REPOSITORY / "docs" / "hardware.md"
FOCAL_PX, SIZE_PX = 1400.0, (1280, 1024)
DISTANCES_M = (0.5, 0.8, 1.2, 1.6, 2.0, 3.0)
DIAMETERS_MM = (3, 5, 10)
LIGHT_MM = 5  # the light that the poses are computed for
TILT_DEG = 30.0
LEAST_NOISE_PX = 0.01  # what lenses and LEDs leave in practice is no less
BETWEEN = re.compile(r"(?<=<!-- spots -->\n).*?(?=<!-- end of spots -->)", re.DOTALL)


def centre_noise_px(radius_px: float) -> float:
    """Least standard deviation of a centre's coordinate, px, for a round image of that radius and the usual light."""
    look = Look()
    along, across = centre_variances(radius_px, radius_px, look.brightness, look, True)
    return math.sqrt((along + across) / 2)


def row(distance: float, points: Floats) -> str:
    """One distance, as the table shows it."""
    sizes = [mm * 1e-3 * FOCAL_PX / distance for mm in DIAMETERS_MM]
    noise = centre_noise_px(LIGHT_MM * 0.5e-3 * FOCAL_PX / distance)
    used = max(noise, LEAST_NOISE_PX)
    bound = pose_bound(points, distance, math.radians(TILT_DEG), used / FOCAL_PX)
    cells = [
        f"{distance:g}",
        "x".join(f"{size * distance / FOCAL_PX:.2f}" for size in SIZE_PX),
        *(f"{size:.1f}" for size in sizes),
        f"{noise:.4f}",
        f"{bound.across_m * 1e3:.3f}",
        f"{bound.depth_m * 1e3:.2f}",
        f"{math.degrees(bound.tilt_rad):.3f}",
    ]
    return "| " + " | ".join(cells) + " |"


def table() -> str:
    """The table in Markdown."""
    points = load_rig(DEMO_RIG).robots[0].leds
    lights = " | ".join(f"{mm} mm light, px" for mm in DIAMETERS_MM)
    head = f"| distance, m | in view, m | {lights} | its centre, px | x, y, mm | z, mm | tilt, ° |"
    rule = "|" + "---:|" * head.strip("|").count("|") + "---:|"
    return "\n".join([head, rule, *(row(distance, points) for distance in DISTANCES_M)]) + "\n"


def made() -> str:
    """The page with its table as it must be."""
    return BETWEEN.sub(lambda _: table(), PAGE.read_text())


if __name__ == "__main__":
    PAGE.write_text(made())
    print(PAGE)
