"""Time and accuracy of a frame, beside one memory pass and other programs: `python -m tests.measure.speed [OUT]`.

One thread; the same frames for all (the tag detectors see the same robots with a tag on top), in forty buffers, so that
none is in the cache from before; the contestants take turns, so that a busy machine hurts them alike. Times
are medians. With OUT, plots of time against robots and of error against distance are written there.
"""

import sys
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rich import box
from rich.console import Console
from rich.table import Table

from asterism.protocol.camera import Camera
from asterism.protocol.geometry import Pose, angle_between
from asterism.protocol.rig import Rig
from asterism.server import Frame, PoseEstimate, Tracks, blobs, localize, pipeline
from asterism.server.simulate import Scene
from tests.measure import tags
from tests.measure.plain_chain import PlainChain
from tests.rigs import make_camera, make_rig

FRAMES, RATE = 40, 60
SIZES = {"1280x1024": (1280, 1024, 1400.0), "2448x2048": (2448, 2048, 2700.0)}
STAGES = (
    (blobs, "background_of"), (blobs, "seed_thresholds"), (blobs, "mark_hot_columns"), (blobs, "connect"),
    (blobs, "measure_spots"), (blobs, "refine_centres"), (pipeline, "_rays"), (pipeline, "identify"),
    (pipeline, "refine_leaning"), (pipeline, "solve_robots"), (pipeline, "choose"),
)  # fmt: skip


@dataclass
class Result:
    """What one contestant did on one kind of frames."""

    times_ms: list[float] = field(default_factory=list)
    right: int = 0
    asked: int = 0
    z_errors: list[float] = field(default_factory=list)

    def judge(self, poses: dict[Any, Pose], true: dict[Any, Pose]) -> None:
        """Count poses within 20 mm and 5 degrees of the truth, and collect their z errors."""
        self.asked += len(true)
        for robot, pose in poses.items():
            if robot not in true:
                continue
            off = pose.position - true[robot].position
            if np.linalg.norm(off) < 0.02 and angle_between(pose.rotation, true[robot].rotation) < np.radians(5):
                self.right += 1
                self.z_errors.append(abs(float(off[2])))


def found(result: Any) -> dict[str, Pose]:
    """The poses of a FrameResult."""
    return {robot: answer.pose for robot, answer in result.answers.items() if isinstance(answer, PoseEstimate)}


def run(rig: Rig, rounds: int, peers: bool) -> dict[str, Result]:
    """Let the contestants take turns on forty frames, ``rounds`` times after one to warm up."""
    scene = Scene(rig, seed=0)
    truths = [scene.truth(k, k / RATE) for k in range(FRAMES)]
    images = [scene.render(k, truths[k]) for k in range(FRAMES)]
    true = [{entry.robot: entry.T_camera_robot for entry in truth} for truth in truths]
    results: dict[str, Result] = defaultdict(Result)
    plain = PlainChain(rig)

    def turn(name: str, call: Callable[[], Any]) -> Any:
        start = time.perf_counter()
        value = call()
        results[name].times_ms.append((time.perf_counter() - start) * 1e3)
        return value

    for round_ in range(rounds + 1):
        if round_ == 1:
            results.clear()
        tracks = Tracks.none()
        for k, image in enumerate(images):
            frame = Frame(image, exposed_ns=1 + k * 10**9 // RATE, index=k)
            turn("one np.max over the frame", lambda image=image: np.max(image))
            cold, after = turn("asterism, each frame alone", lambda frame=frame: localize(frame, rig, Tracks.none()))
            results["asterism, each frame alone"].judge(found(cold), true[k])
            if k == 0:
                tracks = after
            else:
                warm, tracks = turn(
                    "asterism, following", lambda frame=frame, tracks=tracks: localize(frame, rig, tracks)
                )
                results["asterism, following"].judge(found(warm), true[k])
            if peers:
                name = "plain OpenCV chain, each frame alone"
                answers = turn(name, lambda image=image: plain.locate(image))
                results[name].judge({robot: Pose.from_matrix(*answer) for robot, answer in answers.items()}, true[k])
    if peers:
        run_tags(rig, results, turn)
    return dict(results)


def without_distortion(camera: Camera) -> Camera:
    """The same camera with a perfect lens."""
    return Camera(camera.name, camera.width, camera.height, camera.matrix, "plumb_bob", np.zeros(5))


def run_tags(rig: Rig, results: dict[str, Result], turn: Callable[[str, Callable[[], Any]], Any]) -> None:
    """The tag detectors, on a few frames: they take long."""
    ideal = Rig(without_distortion(rig.camera), rig.robots, range_m=rig.range_m)
    scene = Scene(ideal, seed=0)
    for detector in (tags.Aruco(ideal), tags.AprilTags(ideal)):
        for k in range(8):
            truth = scene.truth(k, k / RATE)
            image: NDArray[np.uint8] = tags.render(ideal, truth, seed=k)
            poses = turn(detector.name, lambda detector=detector, image=image: detector.locate(image))
            true = {
                n: entry.T_camera_robot @ ideal.robots[n].T_robot_plane for n, entry in enumerate(truth)
            }  # fmt: skip
            results[detector.name].judge(poses, true)


def stages(rig: Rig) -> Table:
    """Where the time of following goes: each stage's share."""
    taken: dict[str, list[float]] = defaultdict(list)
    originals = [(module, name, getattr(module, name)) for module, name in STAGES]

    def watched(name: str, call: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*arguments: Any) -> Any:
            start = time.perf_counter()
            value = call(*arguments)
            taken[name].append((time.perf_counter() - start) * 1e6)
            return value

        return timed

    scene = Scene(rig, seed=0)
    images = [scene.render(k, scene.truth(k, k / RATE)) for k in range(FRAMES)]
    for module, name, call in originals:
        setattr(module, name, watched(name, call))
    try:
        for round_ in range(6):
            if round_ == 1:
                taken.clear()
            tracks = Tracks.none()
            for k, image in enumerate(images):
                start = time.perf_counter()
                _, tracks = localize(Frame(image, 1 + k * 10**9 // RATE, k), rig, tracks)
                taken["the whole frame"].append((time.perf_counter() - start) * 1e6)
    finally:
        for module, name, call in originals:
            setattr(module, name, call)
    table = Table(
        title=f"{len(rig.robots)} robots, following: where the time goes", box=box.SIMPLE_HEAD, pad_edge=False
    )
    table.add_column("stage")
    table.add_column("median us", justify="right")
    whole = float(np.median(taken["the whole frame"]))
    for _, name in STAGES:
        table.add_row(name.strip("_"), f"{np.median(taken[name]):.0f}")
    rest = whole - sum(float(np.median(taken[name])) for _, name in STAGES)
    table.add_row("rest (Python)", f"{rest:.0f}")
    table.add_row("the whole frame", f"{whole:.0f}")
    return table


def plot(times: dict[str, dict[int, dict[str, Result]]], out: Path) -> None:
    """Time against robots, and z error against distance."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(12, 5))
    for size, by_count in times.items():
        counts = sorted(by_count)
        for name in ("asterism, following", "asterism, each frame alone", "plain OpenCV chain, each frame alone"):
            if all(name in by_count[count] for count in counts):
                medians = [np.median(by_count[count][name].times_ms) for count in counts]
                left.plot(counts, medians, "o-", label=f"{name}, {size}")
        medians = [np.median(by_count[count]["one np.max over the frame"].times_ms) for count in counts]
        left.plot(counts, medians, "k:", label=f"np.max, {size}")
    left.set(xlabel="robots", ylabel="time of a frame, ms", xscale="log", yscale="log", title="time")
    left.legend(fontsize=7)
    distances = np.array([0.8, 1.1, 1.5, 2.0, 2.6])
    errors: dict[str, list[float]] = defaultdict(list)
    for distance in distances:
        rig = make_rig(6, seed=3, camera=without_distortion(make_camera()), range_m=(0.9 * distance, 1.1 * distance))
        results: dict[str, Result] = defaultdict(Result)
        scene = Scene(rig, seed=1)
        for k in range(10):
            truth = scene.truth(k, k / 3)
            result, _ = localize(Frame(scene.render(k, truth), 1, k), rig, Tracks.none())
            results["asterism"].judge(found(result), {entry.robot: entry.T_camera_robot for entry in truth})
        run_tags(rig, results, lambda _, call: call())
        for name, value in results.items():
            errors[name].append(float(np.median(value.z_errors)) * 1e3 if value.z_errors else np.nan)
    for name, values in errors.items():
        right.plot(distances, values, "o-", label=name)
    right.set(xlabel="distance, m", ylabel="median z error, mm", yscale="log", title="error")
    right.legend()
    figure.tight_layout()
    out.mkdir(parents=True, exist_ok=True)
    figure.savefig(out / "speed.png", dpi=110)


def main(out: Path | None) -> None:
    """Measure and print."""
    cv2.setNumThreads(1)
    console = Console(width=110)
    times: dict[str, dict[int, dict[str, Result]]] = {}
    for size, (width, height, focal) in SIZES.items():
        times[size] = {}
        for count in (1, 10, 50):
            camera = make_camera(width, height, focal)
            rig = make_rig(count, camera=camera, range_m=(0.8, 2.0) if count <= 10 else (1.9, 2.3))
            results = run(rig, rounds=3, peers=size == "1280x1024" and count <= 10)
            times[size][count] = results
            table = Table(title=f"{size}, {count} robots, one thread", box=box.SIMPLE_HEAD, pad_edge=False)
            for heading in ("frame to poses", "median ms", "99 %", "x np.max", "right", "z error mm"):
                table.add_column(heading, justify="left" if heading == "frame to poses" else "right")
            base = float(np.median(results["one np.max over the frame"].times_ms))
            for name, result in results.items():
                median, late = np.percentile(result.times_ms, [50, 99])
                share = f"{100 * result.right / result.asked:.1f} %" if result.asked else ""
                depth = f"{1e3 * np.median(result.z_errors):.3f}" if result.z_errors else ""
                table.add_row(name, f"{median:.2f}", f"{late:.2f}", f"{median / base:.1f}", share, depth)
            console.print(table)
    console.print(stages(make_rig(10)))
    if out is not None:
        plot(times, out)
        console.print(f"plots: {out / 'speed.png'}")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
