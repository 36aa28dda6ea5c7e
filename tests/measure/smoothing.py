"""What `--smooth` gains, its lag, and whether its covariances are meant: `python -m tests.measure.smoothing [DRIVES]`.

Drives with starts, stops, circles, turns on the spot (`tests/chain/drives.py`), errors of poses drawn from covariances
as the chain tells them: RMSE over that of frames alone, RMSE of the twist, NEES of both (6 where covariances are
meant), forwards, and forwards and backwards. NEES by what the robot does. The lag of starts, stops and turns. Drives
rendered and located, with a true rig and with one whose LEDs are off. And films of the demonstration's robots.
"""

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace

import cv2
import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from asterism.protocol.geometry import Floats, Pose, log_rotation
from asterism.protocol.rig import Rig, load_rig
from asterism.server import Frame, FrameResult, PoseEstimate, Tracks, localize
from asterism.server.chain.smooth import Motions, SmoothedPose, smooth
from asterism.server.chain.smooth_both import smooth_both
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.simulation.simulate import Look, Scene, Truth
from tests.chain.drives import KINDS, Drives, covariances_of, drawn, drives
from tests.chain.judging import truth_of
from tests.chain.judging_motion import Found, both_ways, forwards, pose_errors, weighted
from tests.helpers import SHARED
from tests.measure.smoothing_lag import lags

STEP_NS = 16_666_667
SPEEDS = (0.0, 0.03, 0.1, 0.3, 1.0)
CASES = ((30.0, 0.02), (60.0, 0.005), (60.0, 0.02), (60.0, 0.1), (120.0, 0.02))  # Hz, px
SECONDS, SETTLED_S = 8.0, 0.5
SEEDS = (201, 202)  # none that the filter's numbers were chosen by
OFF_M = 0.05e-3  # of LEDs in a rig that is off
LEARNED_S = 4.0

Film = Iterator[tuple[Frame, dict[str, Pose]]]


def drawn_drives(seed: int, count: int, rate_hz: float, sigma_px: float) -> tuple[Drives, Floats, Floats, Floats]:
    """Drives, the same at every rate, with measured positions, rotations and their covariances."""
    told = drives(np.random.default_rng(seed), count, SECONDS, rate_hz)
    covariances = covariances_of(told.positions, told.rotations, sigma_px)
    rng = np.random.default_rng([seed, int(rate_hz), int(1e4 * sigma_px)])
    return told, *drawn(rng, told.positions, told.rotations, covariances), covariances


def rms(errors: Floats) -> Floats:
    """(6,) of all but the last axis."""
    found: Floats = np.sqrt(np.mean(errors**2, axis=tuple(range(errors.ndim - 1))))
    return found


def case_row(name: str, found: list[Found], raw: list[Floats]) -> list[str]:
    """One case's figures."""
    poses, twists = (rms(np.concatenate([getattr(f, part) for f in found], axis=1)) for part in ("poses", "twists"))
    ratios = poses / rms(np.concatenate(raw, axis=1))
    nees = [
        np.mean([weighted(f.poses, f.pose_covariances) for f in found]),
        np.mean([weighted(f.twists, f.twist_covariances) for f in found]),
    ]
    speed, turn = 1e3 * np.sqrt(np.mean(twists[:3] ** 2)), np.degrees(np.sqrt(np.mean(twists[3:] ** 2)))
    parts = (np.mean(ratios[:3]), np.mean(ratios[3:5]), ratios[5], speed, turn, *nees)
    return [name, *(f"{value:.2f}" for value in parts)]


def settled(found: Found, first: int) -> Found:
    """Without the first frames."""
    return Found(*(part[first:] for part in found))


def tell_drives(count: int, console: Console) -> None:
    """Drawn errors: RMSE and NEES by case, NEES by manner."""
    table = Table(title="drives, RMSE over that of frames alone; twist's RMSE", box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("case", "x y z", "tilt", "yaw", "mm/s", "deg/s", "NEES pose", "twist"):
        table.add_column(heading, justify="left" if heading == "case" else "right")
    by_manner: dict[str, list[list[Floats]]] = {}
    for way, joined, fewer in (("forwards", forwards, 1), ("both", both_ways, 4)):
        everything: list[tuple[Floats, Floats]] = []
        for rate_hz, sigma_px in CASES:
            found, raw, first = [], [], int(SETTLED_S * rate_hz)
            for seed in SEEDS:
                told, *seen = drawn_drives(seed, max(count // fewer, 1), rate_hz, sigma_px)
                found.append(settled(joined(told, *seen), first))
                raw.append(pose_errors(told, *seen[:2])[first:])
                nees = weighted(*found[-1][:2]), weighted(*found[-1][2:])
                everything.append((np.mean(nees[0]), np.mean(nees[1])))
                for k, kind in enumerate(KINDS):
                    there = told.manners[first:] == k
                    by_manner.setdefault(f"{way}: {kind}", [[], []])
                    for part in range(2):
                        by_manner[f"{way}: {kind}"][part].append(nees[part][there])
            table.add_row(*case_row(f"{way}, {rate_hz:.0f} Hz, {sigma_px:g} px", found, raw))
        table.add_row(f"{way}, all", "", "", "", "", "", *(f"{value:.2f}" for value in np.mean(everything, axis=0)))
    console.print(table)
    table = Table(title="NEES by what the robot does", box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("", "pose", "twist", "twist, median (5.3)"):
        table.add_column(heading, justify="right" if heading else "left")
    for kind, (pose, twist) in by_manner.items():
        poses, twists = np.concatenate(pose), np.concatenate(twist)
        table.add_row(kind, f"{np.mean(poses):.1f}", f"{np.mean(twists):.1f}", f"{np.median(twists):.1f}")
    console.print(table)


def driving(rig: Rig, seed: int, seconds: float) -> Iterator[tuple[Frame, dict[str, tuple[Pose, Floats]]]]:
    """Rendered frames of the rig's first robot on a drive, with T_world_robot and twist."""
    told = drives(np.random.default_rng(seed), 1, seconds, 60.0)
    scene, T_camera_world = Scene(rig, seed, Look()), (rig.T_world_camera or Pose.identity()).inverse()
    robot = rig.robots[0].id
    for k in range(len(told.positions)):
        pose = Pose.from_matrix(told.rotations[k, 0], told.positions[k, 0])
        image = scene.render(k, [Truth(robot, T_camera_world @ pose, (True,) * 6)])
        yield Frame(image, 1 + k * STEP_NS, k), {robot: (pose, told.twists[k, 0])}


def tell_rendered(count: int, console: Console) -> None:
    """Rendered drives: a true rig, one whose LEDs are off, and that with all errors taken for noise."""
    table = Table(title=f"rendered drives from {LEARNED_S:g} s on, NEES", box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("rig", "frames alone", "forwards", "twist", "both", "twist"):
        table.add_column(heading, justify="left" if heading == "rig" else "right")
    rig = load_rig(DEMO_RIG)
    for name, off_m, knows in (("true", 0.0, True), ("LEDs off", OFF_M, True), ("as if noise", OFF_M, False)):
        nees: list[list[float]] = [[], [], [], [], []]
        for seed in range(count):
            rng = np.random.default_rng([7, seed])
            moved = replace(rig.robots[0], leds=rig.robots[0].leds + off_m * rng.standard_normal((6, 3)) * [1, 1, 0])
            told = replace(rig, robots=(moved, *rig.robots[1:]))
            truths, results = _located(rig, told, seed, knows)
            motions, ways = (
                Motions.none(),
                [results, [], [result for _, result in smooth_both(enumerate(results), told)]],
            )
            for result in results:
                smoothed, motions = smooth(result, motions, told)
                ways[1].append(smoothed)
            for way, part in zip(ways, (0, 1, 3), strict=True):
                for result, truth in zip(way, truths, strict=True):
                    if result.exposed_ns > LEARNED_S * 1e9:
                        _judge(result, truth, nees[part], nees[part + 1] if part else None)
        table.add_row(name, *(f"{np.mean(part):.1f}" for part in nees))
    console.print(table)


def _located(
    rig: Rig, told: Rig, seed: int, knows: bool
) -> tuple[list[dict[str, tuple[Pose, Floats]]], list[FrameResult]]:
    tracks, truths, results = Tracks.none(), [], []
    for frame, truth in driving(rig, 300 + seed, 2.0 * LEARNED_S):
        result, tracks = localize(frame, told, tracks)
        truths.append(truth)
        results.append(result if knows else replace(result, learned=np.zeros(len(rig.robots))))
    return truths, results


def _judge(
    result: FrameResult, truth: dict[str, tuple[Pose, Floats]], poses: list[float], twists: list[float] | None
) -> None:
    off, nees = errors(result, {robot: pose for robot, (pose, _) in truth.items()})
    poses.extend(nees)
    for robot, (_, twist) in truth.items():
        answer = result.answers[robot]
        if twists is not None and off and isinstance(answer, SmoothedPose) and answer.velocity is not None:
            error = np.concatenate([answer.velocity.linear, answer.velocity.angular]) - twist
            twists.append(float(error @ np.linalg.solve(answer.velocity.covariance, error)))


def rendered(rig: Rig, speed: float, frames: int) -> Film:
    """Simulated frames with T_parent_robot of every robot."""
    scene = Scene(rig, 7, Look())
    T_parent_camera = rig.T_world_camera or Pose.identity()
    for k in range(frames):
        truth = scene.truth(k, speed * k / 60)
        yield (
            Frame(scene.render(k, truth), 1 + k * STEP_NS, k),
            {entry.robot: T_parent_camera @ entry.T_camera_robot for entry in truth},
        )


def sample() -> Film:
    """The sample film."""
    folder = SHARED / "samples" / "film"
    for k, entry in enumerate(truth_of(folder)):
        image = cv2.imread(str(folder / "frames" / entry["frame"]), cv2.IMREAD_GRAYSCALE)
        robots = {r["id"]: Pose(np.array(r["position"]), np.array(r["orientation"])) for r in entry["robots"]}
        yield Frame(np.asarray(image, np.uint8), 1 + k * STEP_NS, k), robots


def errors(result: FrameResult, truth: dict[str, Pose]) -> tuple[list[Floats], list[float]]:
    """(6,) m and rad of every located robot, and their NEES."""
    off, nees = [], []
    for robot, answer in result.answers.items():
        if isinstance(answer, PoseEstimate):
            true = truth[robot]
            turned = log_rotation(answer.pose.rotation @ true.rotation.T)
            off.append(np.concatenate([answer.position - true.position, turned]))
            nees.append(float(off[-1] @ np.linalg.solve(answer.covariance, off[-1])))
    return off, nees


def row(name: str, rig: Rig, film: Film) -> list[str]:
    """One film's figures."""
    tracks, motions = Tracks.none(), Motions.none()
    told: tuple[list[Floats], list[Floats]] = ([], [])
    nees: tuple[list[float], list[float]] = ([], [])
    for frame, truth in film:
        result, tracks = localize(frame, rig, tracks)
        smoothed, motions = smooth(result, motions, rig)
        for place, answers in enumerate((result, smoothed)):
            off, weights = errors(answers, truth)
            told[place].extend(off)
            nees[place].extend(weights)
    alone, joined = (np.sqrt(np.mean(np.square(part), axis=0)) for part in told)
    return [name, *(f"{ratio:.2f}" for ratio in joined / alone), *(f"{np.mean(part):.1f}" for part in nees)]


def tell_films(frames: int, console: Console) -> None:
    """The demonstration's robots, and the sample film if it is there."""
    table = Table(title="films, RMSE smoothed over RMSE of frames alone", box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("film", "x", "y", "z", "rx", "ry", "rz", "NEES alone", "smoothed"):
        table.add_column(heading, justify="left" if heading == "film" else "right")
    rig = load_rig(DEMO_RIG)
    for speed in SPEEDS:
        table.add_row(*row(f"demo, speed {speed:g}", rig, rendered(rig, speed, frames)))
    folder = SHARED / "samples" / "film"
    if folder.exists():
        table.add_row(*row("sample film", load_rig(folder / "rig.yaml"), sample()))
    console.print(table)


def main(count: int) -> None:
    """Measure and print."""
    console = Console(width=100)
    parts: tuple[Callable[[], None], ...] = (
        lambda: tell_drives(count, console),
        lambda: console.print(lags(count)),
        lambda: tell_films(120, console),
        lambda: tell_rendered(max(count // 2, 1), console),
    )
    for part in parts:
        part()


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 24)
