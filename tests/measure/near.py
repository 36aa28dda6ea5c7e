"""Robots near a wide lens: `python -m tests.measure.near [--frames N] [--out FILE.svg]`.

Rendered frames of 960x600 with one robot of 0.11 m among eight of the rig, f = 450 px, anywhere in the image but with
every LED in view, each located alone; under a fisheye (equidistant) at least 50 degrees off the axis, up to its image's
edge. "width" is the robot's over its distance. "wrong" as in tests/chain/judging.py; "led.radius": where the rig says
that the LEDs are so many times as large as they are. "four LEDs beside others": of robots with four LEDs lit in frames
with two that have six. FILE receives a plot of found against width.
"""

import argparse
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig
from asterism.server import Frame, PoseEstimate, Tracks, localize
from asterism.server.identity.plan import plan_for
from asterism.server.simulation.simulate import Scene, Truth
from tests.chain.judging import Judged
from tests.identity.near_poses import LENSES, near_poses, near_rig
from tests.measure.line_plot import Axis, draw_lines

WIDTH_M = 0.11
AWAY = (0.2, 0.22, 0.26, 0.35, 0.55)  # m
TILTS = ((0.0, 60.0), (60.0, 70.0))  # degrees, against the line of sight
OFF_AXIS = {"wide": 0.0, "fisheye": 50.0}  # degrees
TOLD = (0.25, 2.0, 4.0)
Seen = tuple[int, Pose, Floats]


def judge(scene: Scene, rig: Rig, number: int, seen: Iterable[Seen], lit: dict[int, int]) -> list[Judged]:
    """Locate a frame of the ``seen`` robots with so many LEDs ``lit`` of each, and judge every robot of the rig."""
    rng, poses = np.random.default_rng([number, 21]), {robot: pose for robot, pose, _ in seen}
    nowhere = Pose(np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0, 0.0]))
    truth = []
    for k, robot in enumerate(scene.rig.robots):
        shown = rng.permutation(6) < lit.get(k, 0)
        pose = poses.get(k, nowhere) @ robot.T_robot_plane.inverse()
        truth.append(Truth(robot.id, pose, tuple(bool(one) for one in shown)))
    result, _ = localize(Frame(scene.render(number, truth), exposed_ns=1, index=number), rig, Tracks.none())
    judged = []
    for k, entry in enumerate(truth):
        answer = result.answers[entry.robot]
        found, true = answer if isinstance(answer, PoseEstimate) else None, entry.T_camera_robot
        judged.append(Judged(entry.robot, lit.get(k, 0), found, true if k in lit else None))
    return judged


def alone(lens: str, away_m: float, tilt: tuple[float, float], told: float, lit: int, frames: int) -> tuple[int, int]:
    """Of so many robots how many are found, and how many answers are wrong."""
    true, rig = near_rig(8, lens), near_rig(8, lens, told=told)
    scene, rng = Scene(true, seed=1), np.random.default_rng([round(1000 * away_m), lit, 20])
    found = wrong = 0
    poses = near_poses(plan_for(true), rng, away_m, tilt, OFF_AXIS[lens])
    for number in track(range(frames), transient=True, description=f"{lens} {away_m} m"):
        one = next(poses)
        judged = judge(scene, rig, number, [one], {one[0]: lit})
        found += judged[one[0]].answer is not None
        wrong += sum(robot.wrong for robot in judged)
    return found, wrong


def beside(lens: str, away_m: float, frames: int) -> tuple[int, int]:
    """The same of robots with four LEDs lit, each beside two that have six."""
    rig = near_rig(8, lens)
    scene, rng = Scene(rig, seed=1), np.random.default_rng([round(1000 * away_m), 22])
    found = wrong = 0
    poses = near_poses(plan_for(rig), rng, away_m, (0.0, 60.0))
    for number in track(range(frames), transient=True, description=f"{lens} {away_m} m"):
        seen: list[Seen] = []
        for one in poses:
            middle = one[2].mean(axis=0)
            apart = [np.hypot(*(middle - other[2].mean(axis=0))) > 1.2 * 450 * WIDTH_M / away_m for other in seen]
            if all(apart) and one[0] not in [other[0] for other in seen]:
                seen.append(one)
            if len(seen) == 3:
                break
        judged = judge(scene, rig, number, seen, {one[0]: 4 if one is seen[0] else 6 for one in seen})
        found += judged[seen[0][0]].answer is not None
        wrong += sum(robot.wrong for robot in judged)
    return found, wrong


def plot(shares: dict[str, list[float]], out: Path) -> None:
    """Found against width over distance, the mean of the lenses, which follow one another in ``shares``."""
    widths = [WIDTH_M / away_m for away_m in AWAY][::-1]
    across = Axis("robot's width over its distance", (0.2, 0.3, 0.4, 0.5), (0.19, 0.56))
    up = Axis("found afresh, % of robots", (70, 80, 90, 100), (70.0, 100.0))
    lines = {
        name: (widths, np.reshape(found, (-1, len(AWAY))).mean(axis=0)[::-1].tolist()) for name, found in shares.items()
    }
    draw_lines(lines, across, up, out)


def main(frames: int, out: Path | None) -> None:
    """Measure and print."""
    console = Console(width=140)
    table = Table(title=f"robots near a wide lens, {frames} frames a cell: found / wrong", box=box.SIMPLE_HEAD)
    columns = [f"{lit} LEDs" for lit in (6, 5)] + [f"led.radius x {told:g}" for told in TOLD]
    for heading in ("lens", "distance", "width", "tilt", *columns):
        table.add_column(heading, justify="right")
    shares: dict[str, list[float]] = {}
    for lens in LENSES:
        for tilt in TILTS:
            for away_m in AWAY:
                cells = [alone(lens, away_m, tilt, 1.0, lit, frames) for lit in (6, 5)]
                cells += [alone(lens, away_m, tilt, told, 6, max(frames // 5, 1)) for told in TOLD]
                for lit, (found, _) in zip((6, 5), cells, strict=False):
                    line = shares.setdefault(f"{lit} LEDs, {tilt[0]:g} to {tilt[1]:g}°", [])
                    line.append(100 * found / frames)
                asked = [frames, frames] + [max(frames // 5, 1)] * len(TOLD)
                told = [f"{100 * found / n:.1f} % / {wrong}" for (found, wrong), n in zip(cells, asked, strict=True)]
                table.add_row(lens, f"{away_m} m", f"{WIDTH_M / away_m:.2f}", f"{tilt[0]:g}-{tilt[1]:g}", *told)
    console.print(table)
    for away_m in (0.4, 0.55):
        found, wrong = beside("wide", away_m, frames)
        console.print(f"four LEDs beside others, wide, {away_m} m: {100 * found / frames:.1f} % found, {wrong} wrong")
    if out is not None:
        plot(shares, out)
        console.print(out)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=250, help="in each cell")
    parser.add_argument("--out", type=Path, help="the plot")
    given = parser.parse_args()
    main(given.frames, given.out)
