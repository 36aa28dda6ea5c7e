"""asterism simulate: frames of simulated robots, with truth."""

import argparse
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Pose
from asterism.protocol.rig import Rig, load_rig
from asterism.server.chain.kernel_list import SIMULATE
from asterism.server.chain.warm_up import warm_up
from asterism.server.command.number_arguments import count, positive, share, whole
from asterism.server.command.progress import progress
from asterism.server.command.shared_arguments import add_force, named
from asterism.server.command.simulated_film import Film, WorldTruth, named_files
from asterism.server.output import check_folder, new_folder
from asterism.server.simulation.hand_film import hand_pose, pivot_pose
from asterism.server.simulation.shared_floor import check_shared
from asterism.server.simulation.simulate import Look, Scene
from asterism.server.simulation.work import Lift, Work
from asterism.server.sources.source import DEFAULT_RATE_HZ

EXAMPLES = (
    "asterism simulate rig.yaml out --frames 300\n"
    "asterism simulate rig.yaml out --hide 0.05 --glints 10 --seed 3\n"
    "asterism simulate rig.yaml film --hand alpha --frames 300\n"
    "asterism simulate rig.yaml pivot --pivot alpha:tool --frames 100\n"
    "asterism simulate left.yaml right.yaml out --stagger\n"
    "asterism simulate rig.yaml polished --raster --frames 600 --rate 10\n"
)

LANE_RADII = 1.0  # from lane to lane: half of what a tool goes over, its next lane goes over again


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    part.add_argument(
        "rig", metavar="RIG", nargs="+", help="rig.yaml; several: cameras of one world, each its own folder in OUT"
    )
    part.add_argument("out", metavar="OUT", type=named, help="a new or empty folder")
    add_force(part)
    part.add_argument("--frames", metavar="N", type=count, default=60, help="how many of each camera (default: 60)")
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
    shown.add_argument(
        "--raster", action="store_true", help="robots go over their parts in lanes, as near as their tools' radius asks"
    )
    part.add_argument(
        "--lift", metavar="ROBOT:METRES", help="this robot is off the surface from a third of the film to two thirds"
    )
    part.add_argument("--glints", metavar="N", type=whole, default=0, help="glints a frame (default: 0)")
    part.add_argument(
        "--stagger", action="store_true", help="several cameras expose one after the other, not all at once"
    )


def run(options: argparse.Namespace) -> int:
    """Write OUT/frames/NNNNN.png and times.csv, OUT/truth.jsonl (locate's format, with `visible`), the rig's files.

    Of several rigs each has these in OUT/<camera>, and OUT/truth.jsonl is of the world: a line for every exposure.
    """
    out: Path = options.out
    check_folder(out, options.force)
    rigs = [load_rig(path) for path in options.rig]
    files = [named_files(Path(path), rig) for path, rig in zip(options.rig, rigs, strict=True)]
    _check(options, rigs)
    shown, pose_of = _shown(rigs[0], options)
    warm_up(SIMULATE)
    look = Look(hidden=options.hide, glints=options.glints)
    work = Work(_lanes(rigs[0]) if options.raster else None, _lift(rigs[0], options))
    scenes = [Scene(rig, options.seed, look, work) for rig in [shown, *rigs[1:]]]
    several = len(rigs) > 1
    with new_folder(out, options.force) as made, ExitStack() as stack:
        films = [
            stack.enter_context(Film(made.path / scene.rig.camera.name if several else made.path, scene, beside))
            for scene, beside in zip(scenes, files, strict=True)
        ]
        world = stack.enter_context(WorldTruth(made.path)) if several else None
        exposures = _exposures(rigs, options)
        for exposed_ns, k, index in progress(exposures, len(exposures), "simulating"):
            truth = films[k].take(index, exposed_ns, pose_of)
            if world is not None:
                world.add(films[k], exposed_ns, truth)
    if scenes[0].lanes is not None:
        lanes = scenes[0].lanes
        print(f"lanes {1e3 * lanes.apart:.1f} mm apart; robots have driven all of them after {lanes.once_s:.1f} s")
    if several:
        cameras = ", ".join(rig.camera.name for rig in rigs)
        print(f"{options.frames} frames of each camera in {out} ({cameras})")
        print(f"where their robots are: {out / 'truth.jsonl'}{made.note}")
    else:
        print(f"{options.frames} frames in {out / 'frames'}, their truth in {out / 'truth.jsonl'}{made.note}")
    return 0


def _check(options: argparse.Namespace, rigs: Sequence[Rig]) -> None:
    """Raise InputError for what does not go together."""
    if len(rigs) > 1:
        for argument, value in (("--hand", options.hand), ("--pivot", options.pivot)):
            if value is not None:
                raise InputError(f"{argument} {value}: a hand shows a robot to one camera, expected one RIG")
        check_shared(options.rig, rigs)
    elif options.stagger:
        raise InputError("--stagger is for several cameras, expected several RIGs")


def _exposures(rigs: Sequence[Rig], options: argparse.Namespace) -> list[tuple[int, int, int]]:
    """Exposure time in ns, number of the camera and of its frame, in the order of the times."""
    found = []
    for k, rig in enumerate(rigs):
        rate = _rate(rig, options)
        phase = k / len(rigs) if options.stagger else 0.0
        found += [(round((index + phase) * 1e9 / rate), k, index) for index in range(options.frames)]
    return sorted(found)


def _rate(rig: Rig, options: argparse.Namespace) -> float:
    return float(options.rate or rig.capture.rate_hz or DEFAULT_RATE_HZ)


def _lanes(rig: Rig) -> float:
    """How far apart lanes are, m, for those tools of the rig that are the smallest. Raises InputError."""
    radii = [robot.stands.radius_m for robot in rig.robots if robot.stands is not None and robot.stands.radius_m]
    if not radii:
        raise InputError("--raster: no robot of the rig has a `radius` of its tool, expected one in its `stands`")
    return LANE_RADII * min(radii)


def _lift(rig: Rig, options: argparse.Namespace) -> Lift | None:
    """Who is lifted, how far, and when. Raises InputError."""
    if options.lift is None:
        return None
    argument = f"--lift {options.lift}"
    for other, value in (("--hand", options.hand), ("--pivot", options.pivot)):
        if value is not None:
            raise InputError(f"{argument}: goes with robots that drive, expected no {other}")
    robot, _, height = options.lift.rpartition(":")
    try:
        metres = positive(height)
    except argparse.ArgumentTypeError as problem:
        raise InputError(f"{argument}: {problem}; for example alpha:0.003") from None
    _alone(rig, robot, argument)
    seconds = options.frames / _rate(rig, options)
    return Lift(robot, metres, seconds / 3.0, 2.0 * seconds / 3.0)


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
