"""Rigs of three cameras about one floor, which share a file of robots, for `tests.measure.hosts`."""

import re
from pathlib import Path

import numpy as np

from asterism.protocol.geometry import Pose
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.several import looking_at

CAMERAS = ("left", "right", "third")
ROBOTS = 3
EYES = ((-0.65, 0.0, 1.13), (0.65, 0.0, 1.13), (0.05, 0.55, 1.15))  # m, in the world


def write_rigs(folder: Path, rate_hz: float) -> dict[str, Path]:
    """The rigs by their cameras."""
    text = DEMO_RIG.read_text()
    robots = re.split(r"^  (?=\w+:)", text.partition("robots:\n")[2], flags=re.MULTILINE)[1 : ROBOTS + 1]
    (folder / "robots.yaml").write_text("".join(f"  {robot}" for robot in robots).replace("\n  ", "\n")[2:])
    camera = (DEMO_RIG.parent / "camera.yaml").read_text()
    made = {}
    for name, eye in zip(CAMERAS, EYES, strict=True):
        place = looking_at(np.array(eye), np.zeros(3))
        (folder / f"{name}-camera.yaml").write_text(camera.replace("camera_name: demo", f"camera_name: {name}"))
        made[name] = folder / f"{name}.yaml"
        made[name].write_text(_rig(name, place, rate_hz))
    return made


def _rig(name: str, place: Pose, rate_hz: float) -> str:
    position, orientation = place.position.tolist(), place.orientation.tolist()
    return (
        f"camera: {name}-camera.yaml\nrange: [0.9, 1.7]\ncapture: {{rate: {rate_hz:g}}}\n"
        f"world:\n  position: {position}\n  orientation: {orientation}\nrobots: robots.yaml\n"
    )
