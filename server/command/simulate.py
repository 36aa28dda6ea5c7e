"""asterism simulate: frames of simulated robots, with truth."""

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import msgspec

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Pose
from asterism.protocol.rig import Rig, load_rig
from asterism.protocol.yaml_file import parse_yaml
from asterism.server.chain.kernel_list import SIMULATE
from asterism.server.chain.warm_up import warm_up
from asterism.server.command.number_arguments import count, positive, share, whole
from asterism.server.command.progress import progress
from asterism.server.command.shared_arguments import add_force, named
from asterism.server.output import check_folder, new_folder
from asterism.server.simulation.hand_film import hand_pose, pivot_pose
from asterism.server.simulation.simulate import Look, Scene, Truth
from asterism.server.sources.frame_times import HEADER, NAME
from asterism.server.sources.source import DEFAULT_RATE_HZ

EXAMPLES = (
    "asterism simulate rig.yaml out --frames 300\n"
    "asterism simulate rig.yaml out --hide 0.05 --glints 10 --seed 3\n"
    "asterism simulate rig.yaml film --hand alpha --frames 300\n"
    "asterism simulate rig.yaml pivot --pivot alpha:tool --frames 100\n"
)


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    part.add_argument("rig", metavar="RIG", help="rig.yaml")
    part.add_argument("out", metavar="OUT", type=named, help="a new or empty folder")
    add_force(part)
    part.add_argument("--frames", metavar="N", type=count, default=60, help="how many (default: 60)")
    part.add_argument("--rate", metavar="HZ", type=positive, help="default: the rig's capture.rate, or 60")
    part.add_argument("--seed", metavar="N", type=whole, default=0, help="default: 0")
    part.add_argument(
        "--hide", metavar="P", type=share, default=0.0, help="probability that an LED is hidden (default: 0)"
    )
    shown = part.add_mutually_exclusive_group()
    shown.add_argument(
        "--hand", metavar="ROBOT", help="this robot alone, shown by hand from all sides: a film to calibrate with"
    )
    shown.add_argument(
        "--pivot", metavar="ROBOT:POINT", help="this robot alone, tilted about a point of it that rests at one place"
    )
    part.add_argument("--glints", metavar="N", type=whole, default=0, help="glints a frame (default: 0)")


def run(options: argparse.Namespace) -> int:
    """Write OUT/frames/NNNNN.png and times.csv, OUT/truth.jsonl (locate's format, with `visible`), the rig's files."""
    out: Path = options.out
    check_folder(out, options.force)
    rig = load_rig(options.rig)
    files = _files(Path(options.rig), rig)
    rate = options.rate or rig.capture.rate_hz or DEFAULT_RATE_HZ
    shown, pose_of = _shown(rig, options)
    warm_up(SIMULATE)
    scene = Scene(shown, options.seed, Look(hidden=options.hide, glints=options.glints))
    encoder = msgspec.json.Encoder()
    with new_folder(out, options.force) as made:
        frames = made.path / "frames"
        frames.mkdir()
        (made.path / "rig.yaml").write_text(rig.rig_text, encoding="utf-8")
        for name, text in files.items():
            file = made.path / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, encoding="utf-8")
        with (made.path / "truth.jsonl").open("wb") as truth_file, (frames / NAME).open("w") as times:
            times.write(f"{HEADER}\n")
            for index in progress(range(options.frames), options.frames, "simulating"):
                truth = scene.truth(index, index / rate)
                if pose_of is not None:
                    truth = [replace(truth[0], T_camera_robot=pose_of(index))]
                name = f"{index:05d}.png"
                _, png = cv2.imencode(".png", scene.render(index, truth))
                (frames / name).write_bytes(png.tobytes())
                robots = [_truth_line(entry, rig) for entry in truth]
                exposed_ns = round(index * 1e9 / rate)
                times.write(f"{name},{exposed_ns}\n")
                line = {"frame": name, "exposed_ns": exposed_ns, "robots": robots}
                truth_file.write(encoder.encode(line) + b"\n")
    print(f"{options.frames} frames in {out / 'frames'}, their truth in {out / 'truth.jsonl'}{made.note}")
    return 0


def _truth_line(entry: Truth, rig: Rig) -> dict[str, Any]:
    pose = entry.T_camera_robot
    if rig.T_world_camera is not None:
        pose = rig.T_world_camera @ pose
    return {
        "id": entry.robot,
        "position": pose.position.tolist(),
        "orientation": pose.orientation.tolist(),
        "visible": sum(entry.lit),
    }


def _shown(rig: Rig, options: argparse.Namespace) -> tuple[Rig, Callable[[int], Pose] | None]:
    """The rig that is filmed, and T_camera_robot of its one robot by the frame's number, where a hand moves it."""
    if options.hand is not None:
        alone = _alone(rig, options.hand, f"--hand {options.hand}")
        return alone, lambda index: hand_pose(rig, alone.robots[0], index, options.frames, options.seed)
    if options.pivot is not None:
        robot, _, point = options.pivot.rpartition(":")
        alone = _alone(rig, robot, f"--pivot {options.pivot}")
        points = alone.robots[0].points
        if point not in points:
            known = f"one of {', '.join(points)}" if points else f"the rig to give {robot} `points`"
            raise InputError(f"--pivot {options.pivot}: {robot} has no point {point!r}, expected {known}")
        return alone, lambda index: pivot_pose(rig, alone.robots[0], point, index, options.frames, options.seed)
    return rig, None


def _alone(rig: Rig, robot: str, argument: str) -> Rig:
    """The rig with that robot only. Raises InputError if it is not there."""
    ids = [each.id for each in rig.robots]
    if robot not in ids:
        raise InputError(f"{argument}: {robot!r} is not in the rig, expected one of {', '.join(ids)}")
    return replace(rig, robots=(rig.robot(robot),))


def _files(rig_path: Path, rig: Rig) -> dict[str, str]:
    """The files that the rig names, by the names it gives them, relative to the rig's copy."""
    camera = parse_yaml(rig.rig_text, str(rig_path)).text("camera")
    robots = {rig.robots_name: rig.files[rig.robots_name]} if rig.robots_name else {}
    files = {camera: rig.camera_text, **robots, **rig.offset_texts}
    for name in files:
        if Path(name).is_absolute() or ".." in Path(name).parts:
            key = "camera" if name == camera else "robots" if name in robots else "led.offset"
            raise InputError(f"{rig_path}: {key}: {name}, expected a file beside the rig to copy it")
    return files
