"""The six LED positions of a robot, as a rig has them: refused where they are no constellation that can be located."""

import numpy as np

from asterism.protocol.constellation import LEDS, extent
from asterism.protocol.geometry import Floats
from asterism.protocol.rig_hints import in_metres
from asterism.protocol.yaml_file import Section

COPLANAR = 0.02  # of the extent: LEDs farther from their common plane are refused
LARGEST_M = 5.0  # between two LEDs of a robot
NEAREST_LEDS = 0.03  # of the extent: LEDs nearer than this would be one spot


def read_leds(section: Section) -> Floats:
    """The positions (6, 3), m, under a robot's `leds`. Raises InputError with what was found and what is accepted."""
    rows = section.rows("leds", 3, "x, y, z in the robot's frame, m")
    if len(rows) != LEDS:
        raise section.error("leds", f"{len(rows)} positions, expected {LEDS}")
    leds = np.array(rows)
    size = extent(leds)
    if size > LARGEST_M:
        raise section.error(
            "leds",
            f"the LEDs are up to {size:g} m apart, expected at most {LARGEST_M:g} m; {in_metres(rows[0])}",
        )
    spacing = np.linalg.norm(leds[:, None] - leds[None], axis=-1) + np.eye(LEDS) * 1e9
    first, second = (int(i) for i in np.unravel_index(int(np.argmin(spacing)), spacing.shape))
    if size == 0.0 or spacing[first, second] < NEAREST_LEDS * size:
        raise section.error(
            "leds",
            f"LEDs {first} and {second} are {spacing[first, second] * 1e3:.3g} mm apart, expected at least "
            f"{NEAREST_LEDS:.0%} of the constellation's extent ({size * 1e3:.3g} mm)",
        )
    centred = leds - leds.mean(axis=0)
    _, lengths, axes = np.linalg.svd(centred)
    if lengths[1] < 0.05 * lengths[0]:
        raise section.error("leds", "the LEDs lie on one line, expected six positions spread over a plane")
    off = np.abs(centred @ axes[2])
    if off.max() > COPLANAR * size:
        raise section.error(
            "leds",
            f"LED {int(np.argmax(off))} lies {off.max() * 1e3:.3g} mm off the common plane, expected coplanar LEDs "
            f"(at most {COPLANAR:.0%} of their extent, {COPLANAR * size * 1e3:.3g} mm)",
        )
    return leds
