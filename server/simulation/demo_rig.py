"""Where the demonstration's rig lies."""

from pathlib import Path

DEMO_RIG = Path(__file__).parent / "demo" / "rig.yaml"
