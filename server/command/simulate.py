"""asterism simulate: frames of simulated robots, with truth."""

import argparse
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import msgspec

from asterism.protocol.errors import InputError, WorldError
from asterism.protocol.rig import Rig, load_rig
from asterism.protocol.yaml_file import parse_yaml
from asterism.server.chain.kernel_list import SIMULATE
from asterism.server.chain.warm_up import warm_up
from asterism.server.command.progress import progress
from asterism.server.simulation.hand_film import hand_pose
from asterism.server.simulation.simulate import Look, Scene
from asterism.server.sources.source import DEFAULT_RATE_HZ


def run(options: argparse.Namespace) -> int:
    """Write OUT/frames/NNNNN.png, OUT/truth.jsonl (in locate's format, with `visible`), and the rig's files."""
    rig = load_rig(options.rig)
    if options.glints < 0:
        raise InputError(f"--glints: {options.glints}, expected 0 or more")
    out: Path = options.out
    frames = out / "frames"
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out}: exists already, expected a new or empty folder")
    files = _files(Path(options.rig), rig)
    rate = options.rate or rig.capture.rate_hz or DEFAULT_RATE_HZ
    shown = rig if options.hand is None else _alone(rig, options.hand)
    warm_up(SIMULATE)
    scene = Scene(shown, options.seed, Look(hidden=options.hide, glints=options.glints))
    encoder = msgspec.json.Encoder()
    try:
        frames.mkdir(parents=True)
        (out / "rig.yaml").write_text(rig.rig_text)
        for name, text in files.items():
            file = out / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text)
        with (out / "truth.jsonl").open("wb") as truth_file:
            for index in progress(range(options.frames), options.frames, "simulating"):
                truth = scene.truth(index, index / rate)
                if options.hand is not None:
                    pose = hand_pose(rig, shown.robots[0], index, options.frames, options.seed)
                    truth = [replace(truth[0], T_camera_robot=pose)]
                name = f"{index:05d}.png"
                if not cv2.imwrite(str(frames / name), scene.render(index, truth)):
                    raise WorldError(f"{frames / name}: cannot be written; is the disk full?")
                robots = []
                for entry in truth:
                    pose = entry.T_camera_robot
                    if rig.T_world_camera is not None:
                        pose = rig.T_world_camera @ pose
                    robots.append(
                        {
                            "id": entry.robot,
                            "position": pose.position.tolist(),
                            "orientation": pose.orientation.tolist(),
                            "visible": sum(entry.lit),
                        }
                    )
                line = {"frame": name, "exposed_ns": round(index * 1e9 / rate), "robots": robots}
                truth_file.write(encoder.encode(line) + b"\n")
    except OSError as error:
        shutil.rmtree(frames, ignore_errors=True)
        raise WorldError(f"{out}: cannot be written ({error.strerror})") from None
    print(f"{options.frames} frames in {frames}, their truth in {out / 'truth.jsonl'}")
    return 0


def _alone(rig: Rig, robot: str) -> Rig:
    """The rig with that robot only. Raises InputError if it is not there."""
    ids = [each.id for each in rig.robots]
    if robot not in ids:
        raise InputError(f"--hand {robot}: is not in the rig, expected one of {', '.join(ids)}")
    return replace(rig, robots=(rig.robot(robot),))


def _files(rig_path: Path, rig: Rig) -> dict[str, str]:
    """The files that the rig names, by the names it gives them, relative to the rig's copy."""
    camera = parse_yaml(rig.rig_text, str(rig_path)).text("camera")
    files = {camera: rig.camera_text, **rig.offset_texts}
    for name in files:
        if Path(name).is_absolute() or ".." in Path(name).parts:
            key = "camera" if name == camera else "led.offset"
            raise InputError(f"{rig_path}: {key}: {name}, expected a file beside the rig to copy it")
    return files
