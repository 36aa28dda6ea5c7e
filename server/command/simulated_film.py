"""The files of a simulated camera: frames, their times, their truth, the rig."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import cv2
import msgspec

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Pose
from asterism.protocol.rig import Rig
from asterism.protocol.surface import HEIGHTS, STL
from asterism.protocol.yaml_file import Section, parse_yaml
from asterism.server.simulation.simulate import Scene, Truth
from asterism.server.sources.frame_times import HEADER, NAME

TRUTH = "truth.jsonl"


class Film(ExitStack):
    """One camera's folder in the making; ``beside`` are the files that its rig names, by the names it gives them."""

    def __init__(self, folder: Path, scene: Scene, beside: dict[str, str]) -> None:
        super().__init__()
        self.folder = folder
        self.scene = scene
        self._encoder = msgspec.json.Encoder()
        self._beside = beside

    def __enter__(self) -> Self:
        frames = self.folder / "frames"
        frames.mkdir(parents=True)
        for name, text in {"rig.yaml": self.scene.rig.rig_text, **self._beside}.items():
            file = self.folder / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, encoding="utf-8")
        self._truth = self.enter_context((self.folder / TRUTH).open("wb"))
        self._times = self.enter_context((frames / NAME).open("w"))
        self._times.write(f"{HEADER}\n")
        return self

    def take(self, index: int, exposed_ns: int, pose_of: Callable[[int], Pose] | None = None) -> list[Truth]:
        """Expose frame ``index``; ``pose_of`` gives T_camera_robot of the one robot, where a hand moves it."""
        truth = self.scene.truth(index, exposed_ns * 1e-9)
        if pose_of is not None:
            truth = [replace(truth[0], T_camera_robot=pose_of(index))]
        name = f"{index:05d}.png"
        _, png = cv2.imencode(".png", self.scene.render(index, truth))
        (self.folder / "frames" / name).write_bytes(png.tobytes())
        self._times.write(f"{name},{exposed_ns}\n")
        robots = [
            {**_told(entry, self.scene.rig), "visible": sum(seen)}
            for entry, seen in zip(truth, self.visible(truth), strict=True)
        ]
        line = {"frame": name, "exposed_ns": exposed_ns, "robots": robots}
        self._truth.write(self._encoder.encode(line) + b"\n")
        return truth

    def visible(self, truth: Sequence[Truth]) -> list[tuple[bool, ...]]:
        """Which LEDs of every robot the frame shows."""
        return [self.scene.visible(k, entry) for k, entry in enumerate(truth)]


class WorldTruth(ExitStack):
    """Where robots are in the world at every exposure of any camera, with how many LEDs each camera sees then.

    Exposures come in the order of their times; those of one time are one line.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._path = folder / TRUTH
        self._encoder = msgspec.json.Encoder()
        self._line: dict[str, Any] | None = None

    def __enter__(self) -> Self:
        self._stream = self.enter_context(self._path.open("wb"))
        self.callback(self._write)
        return self

    def add(self, film: Film, exposed_ns: int, truth: Sequence[Truth]) -> None:
        """What one camera exposed."""
        if self._line is None or self._line["exposed_ns"] != exposed_ns:
            self._write()
            self._line = {"frame": str(exposed_ns), "exposed_ns": exposed_ns, "robots": {}}
        robots, camera = self._line["robots"], film.scene.rig.camera.name
        for entry, seen in zip(truth, film.visible(truth), strict=True):
            told = robots.setdefault(entry.robot, {**_told(entry, film.scene.rig), "visible": {}})
            told["visible"][camera] = sum(seen)

    def _write(self) -> None:
        if self._line is not None:
            line = {**self._line, "robots": list(self._line["robots"].values())}
            self._stream.write(self._encoder.encode(line) + b"\n")
        self._line = None


def named_files(rig_path: Path, rig: Rig) -> dict[str, str]:
    """The files that the rig names, by the names it gives them, relative to the rig's copy."""
    section = parse_yaml(rig.rig_text, str(rig_path))
    camera = section.text("camera")
    robots = {rig.robots_name: rig.files[rig.robots_name]} if rig.robots_name else {}
    surface = _surface_file(section, rig)
    files = {camera: rig.camera_text, **robots, **surface, **rig.offset_texts}
    for name in files:
        if Path(name).is_absolute() or ".." in Path(name).parts:
            key = next(
                (key for key, held in (("camera", {camera}), ("robots", robots), ("surface", surface)) if name in held),
                "led.offset",
            )
            raise InputError(f"{rig_path}: {key}: {name}, expected a file beside the rig to copy it")
    return files


def _surface_file(section: Section, rig: Rig) -> dict[str, str]:
    """The file that the rig's surface is in, where it is in one."""
    if rig.surface is None:
        return {}
    inner = section.section("surface")
    return {inner.text(key): rig.files[inner.text(key)] for key in (HEIGHTS, STL) if key in inner}


def _told(entry: Truth, rig: Rig) -> dict[str, Any]:
    pose = entry.T_camera_robot
    if rig.T_world_camera is not None:
        pose = rig.T_world_camera @ pose
    return {"id": entry.robot, "position": pose.position.tolist(), "orientation": pose.orientation.tolist()}
