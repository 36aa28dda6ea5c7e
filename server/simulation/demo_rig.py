"""Where the demonstration's rigs lie."""

from pathlib import Path

DEMO_RIG = Path(__file__).parent / "demo" / "rig.yaml"
DEMO_WORKPIECE = DEMO_RIG.with_name("workpiece.yaml")  # the same, with the surface that its robots stand on
