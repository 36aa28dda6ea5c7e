"""A rig of ten robots in files, for servers that are measured: the demo's five, and five more of the same kind."""

from pathlib import Path

from asterism.protocol.rig import load_rig
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.rigs import random_layouts

MORE = ("foxtrot", "golf", "hotel", "india", "juliett")
SEED = 40  # of constellations that `load_rig` finds apart from the demo's


def write_ten_robots(folder: Path, rate_hz: float) -> Path:
    """Write the rig and its camera into a folder; returns the rig's file."""
    text = DEMO_RIG.read_text().replace("rate: 60", f"rate: {rate_hz:g}")
    for name, layout in zip(MORE, random_layouts(len(MORE), SEED), strict=True):
        leds = ", ".join(f"[{x:.4f}, {y:.4f}, 0.012]" for x, y in layout)
        text += f"  {name}:\n    leds: [{leds}]\n    led: {{radius: 0.0025}}\n"
        text += "    normal: {world: [0, 0, 1], within_deg: 40}\n"
    for file in DEMO_RIG.parent.glob("*.yaml"):
        (folder / file.name).write_text(file.read_text())
    rig = folder / DEMO_RIG.name
    rig.write_text(text)
    load_rig(rig)
    return rig
