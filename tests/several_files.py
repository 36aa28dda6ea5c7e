"""Several cameras' rigs and films as files, with one file of robots for all."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path

import cv2

from asterism.protocol.rig import Rig
from asterism.server.calibration.lens.camera_file import camera_text
from asterism.server.chain.frame import Frame
from asterism.server.sources.frame_times import HEADER, NAME

ROBOTS = "robots.yaml"


def write_rigs(folder: Path, rigs: Sequence[Rig]) -> list[Path]:
    """`<camera>.yaml` with `<camera>-camera.yaml` for every rig, and `robots.yaml`, which all of them name."""
    robots = {robot.id: {"leds": robot.leds.tolist(), "led": {"radius": robot.led_radius}} for robot in rigs[0].robots}
    (folder / ROBOTS).write_text("".join(f"{robot}: {json.dumps(words)}\n" for robot, words in robots.items()))
    return [_write_rig(folder, rig) for rig in rigs]


def _write_rig(folder: Path, rig: Rig) -> Path:
    name, place = rig.camera.name, rig.T_world_camera
    assert place is not None
    world = {"position": place.position.tolist(), "orientation": place.orientation.tolist()}
    (folder / f"{name}-camera.yaml").write_text(camera_text(rig.camera))
    text = (
        f"camera: {name}-camera.yaml\nrange: {list(rig.range_m or ())}\nworld: {json.dumps(world)}\nrobots: {ROBOTS}\n"
    )
    (folder / f"{name}.yaml").write_text(text)
    return folder / f"{name}.yaml"


def write_film(folder: Path, frames: Iterable[Frame]) -> Path:
    """A folder of images with their `times.csv`."""
    folder.mkdir()
    times = [HEADER]
    for frame in frames:
        name = f"{frame.index:05d}.png"
        (folder / name).write_bytes(cv2.imencode(".png", frame.image)[1].tobytes())
        times.append(f"{name},{frame.exposed_ns}")
    (folder / NAME).write_text("\n".join(times) + "\n")
    return folder
