"""Time and accuracy of a frame, beside one memory pass and other programs: `python -m tests.measure.speed [OUT]`.

One thread; the same frames for all (the tag detectors see the same robots with a tag on top), in forty buffers, so that
none is in the cache from before; the contestants take turns, so that a busy machine hurts them alike. Times are
medians; "right" are poses within 20 mm and 5 degrees of the truth, and of those the z errors are medians. Errors
against distance are those of six robots without lens distortion, each frame alone. OUT receives plots.
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
from asterism.server import Frame, PoseEstimate, Tracks, localize
from asterism.server.centres import blobs
from asterism.server.chain import pipeline
from asterism.server.identity.plan import plan_for
from asterism.server.segmentation.background import background_of
from asterism.server.segmentation.components import connect
from asterism.server.segmentation.pixels import whole_of
from asterism.server.segmentation.segment import SEED_LEAST, SEED_SIGMAS
from asterism.server.segmentation.spots import Background, Limits, Seeds, measure_spots
from asterism.server.segmentation.thresholds import begin_thresholds
from asterism.server.simulation.simulate import Scene
from tests.measure import tags
from tests.measure.plain_chain import PlainChain
from tests.rigs import make_camera, make_rig

FRAMES, RATE = 40, 60
SIZES = {"1280x1024": (1280, 1024, 1400.0), "2448x2048": (2448, 2048, 2700.0)}
DISTANCES = (0.8, 1.1, 1.5, 2.0, 2.6)  # m
STEP_S = 1 / 3  # between the frames at a distance: other poses in each
MEMORY = "one np.max over the frame"
FOLLOWING, ALONE = "asterism, following", "asterism, each frame alone"
PLAIN = "plain OpenCV chain, each frame alone"
# How the plots show them.
STYLES = {
    FOLLOWING: "C0o-", ALONE: "C1s-", PLAIN: "C2^-", tags.Aruco.name: "C3D-", tags.AprilTags.name: "C4v-", MEMORY: "k:",
}  # fmt: skip
STAGES = (
    (blobs, "segment"), (blobs, "refine_centres"), (pipeline, "rays_of"), (pipeline, "identify"),
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
            turn(MEMORY, lambda image=image: np.max(image))
            cold, after = turn(ALONE, lambda frame=frame: localize(frame, rig, Tracks.none()))
            results[ALONE].judge(found(cold), true[k])
            if k == 0:
                tracks = after
            else:
                warm, tracks = turn(FOLLOWING, lambda frame=frame, tracks=tracks: localize(frame, rig, tracks))
                results[FOLLOWING].judge(found(warm), true[k])
            if peers:
                answers = turn(PLAIN, lambda image=image: plain.locate(image))
                results[PLAIN].judge({robot: Pose.from_matrix(*answer) for robot, answer in answers.items()}, true[k])
    if peers:
        run_tags(rig, 0, 1 / RATE, results, turn)
    return dict(results)


def without_distortion(camera: Camera) -> Camera:
    """The same camera with a perfect lens."""
    return Camera(camera.name, camera.width, camera.height, camera.matrix, "plumb_bob", np.zeros(5))


def run_tags(
    rig: Rig, seed: int, step_s: float, results: dict[str, Result], turn: Callable[[str, Callable[[], Any]], Any]
) -> None:
    """The tag detectors, on a few frames, ``step_s`` apart, of the scene of that seed: they take long."""
    ideal = Rig(without_distortion(rig.camera), rig.robots, range_m=rig.range_m)
    scene = Scene(ideal, seed)
    for detector in (tags.Aruco(ideal), tags.AprilTags(ideal)):
        for k in range(8):
            truth = scene.truth(k, k * step_s)
            image: NDArray[np.uint8] = tags.render(ideal, truth, seed=k)
            poses = turn(detector.name, lambda detector=detector, image=image: detector.locate(image))
            true = {
                n: entry.T_camera_robot @ ideal.robots[n].T_robot_plane for n, entry in enumerate(truth)
            }  # fmt: skip
            results[detector.name].judge(poses, true)


def parts_of_segment(rig: Rig, images: list[NDArray[np.uint8]]) -> dict[str, list[float]]:
    """Times, us, of the kernels that `segment` calls, each on its own on every frame."""
    taken: dict[str, list[float]] = defaultdict(list)
    plan = plan_for(rig)
    scratch = plan.borrow_scratch()

    def timed(kernel: Callable[..., Any], *arguments: Any) -> Any:
        start = time.perf_counter()
        value = kernel(*arguments)
        taken[kernel.__name__].append((time.perf_counter() - start) * 1e6)
        return value

    for image in 3 * images:
        level, noise = timed(background_of, image)
        seeds = (SEED_SIGMAS, SEED_LEAST)
        timed(begin_thresholds, level, noise, *seeds, image.shape[0], scratch.thresholds)
        tables = (scratch.runs, scratch.parent, scratch.components)
        count, _ = timed(connect, image, scratch.thresholds, whole_of(image), *tables)
        limits = Limits(*seeds, plan.largest_radius_px, plan.masks)
        components, background = scratch.components[:count], Background(level, noise)
        seeds_of = Seeds(image, scratch.thresholds, False)
        timed(measure_spots, image, seeds_of, components, background, limits, scratch.spots)
    return {kernel: times_us[len(images) :] for kernel, times_us in taken.items()}


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
        title=f"{len(rig.robots)} robots, following: where the time goes", box=box.SIMPLE_HEAD, pad_edge=False,
        min_width=44,
    )  # fmt: skip
    table.add_column("stage")
    table.add_column("median us", justify="right")
    whole = float(np.median(taken["the whole frame"]))
    for _, name in STAGES:
        table.add_row(name.strip("_"), f"{np.median(taken[name]):.0f}")
        if name == "segment":
            for kernel, times_us in parts_of_segment(rig, images).items():
                table.add_row(f"  {kernel}", f"{np.median(times_us):.0f}")
    rest = whole - sum(float(np.median(taken[name])) for _, name in STAGES)
    table.add_row("rest (Python)", f"{rest:.0f}")
    table.add_row("the whole frame", f"{whole:.0f}")
    return table


def against_distance() -> dict[str, list[Result]]:
    """What everybody makes of six robots at each of the distances."""
    told: dict[str, list[Result]] = defaultdict(list)
    for distance in DISTANCES:
        rig = make_rig(6, seed=3, camera=without_distortion(make_camera()), range_m=(0.9 * distance, 1.1 * distance))
        results: dict[str, Result] = defaultdict(Result)
        scene, plain = Scene(rig, seed=1), PlainChain(rig)
        for k in range(10):
            truth = scene.truth(k, k * STEP_S)
            image, true = scene.render(k, truth), {entry.robot: entry.T_camera_robot for entry in truth}
            results[ALONE].judge(found(localize(Frame(image, 1, k), rig, Tracks.none())[0]), true)
            poses = {robot: Pose.from_matrix(*answer) for robot, answer in plain.locate(image).items()}
            results[PLAIN].judge(poses, true)
        run_tags(rig, 1, STEP_S, results, lambda _, call: call())
        for name, result in results.items():
            told[name].append(result)
    return dict(told)


def z_error_mm(result: Result) -> float:
    """Median, of the poses that are right; nan if none is."""
    return 1e3 * float(np.median(result.z_errors)) if result.z_errors else float("nan")


def distance_table(told: dict[str, list[Result]]) -> Table:
    """Error of everybody against distance."""
    table = Table(title="median z error, mm (right), against distance", box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("frame to poses")
    for distance in DISTANCES:
        table.add_column(f"{distance:g} m", justify="right")
    for name, results in told.items():
        errors = [f"{z_error_mm(result):.3f}" if result.z_errors else "-" for result in results]
        shares = [f"({100 * result.right / result.asked:.0f} %)" for result in results]
        table.add_row(name, *(" ".join(pair) for pair in zip(errors, shares, strict=True)))
    return table


def plot_times(times: dict[str, dict[int, dict[str, Result]]], out: Path) -> None:
    """Time of a frame against robots, one panel per size of image."""
    from matplotlib import pyplot as plt
    from matplotlib.ticker import NullLocator

    figure, panels = plt.subplots(1, len(times), figsize=(12, 5.4), sharey=True, layout="constrained")
    for panel, (size, by_count) in zip(panels, times.items(), strict=True):
        for name, style in STYLES.items():
            counts = [count for count in sorted(by_count) if name in by_count[count]]
            medians = [float(np.median(by_count[count][name].times_ms)) for count in counts]
            panel.plot(counts, medians, style, label=name)
        panel.set(title=f"frame to poses, {size}, one thread", xlabel="robots in view", xscale="log", yscale="log")
        panel.set_xticks(sorted(by_count), [str(count) for count in sorted(by_count)])
        panel.xaxis.set_minor_locator(NullLocator())
        panel.grid(visible=True, which="major", alpha=0.3)
    ticks = (0.03, 0.1, 0.3, 1, 3, 10, 30, 100, 300)
    panels[0].set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    panels[0].minorticks_off()
    panels[0].set_ylabel("median time of a frame, ms")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    figure.savefig(out, dpi=110)


def plot_errors(told: dict[str, list[Result]], beside: dict[str, Result], out: Path) -> None:
    """Error against distance, and error beside time."""
    from matplotlib import pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(12, 5.4), sharey=True, layout="constrained")
    for name, results in told.items():
        left.plot(DISTANCES, [z_error_mm(result) for result in results], STYLES[name], label=name)
    left.set(
        title="error against distance, six robots", xlabel="distance, m", ylabel="median z error, mm", yscale="log"
    )
    left.set_xticks(DISTANCES, [f"{distance:g}" for distance in DISTANCES])
    for name, style in STYLES.items():
        if name != MEMORY:
            right.plot(
                [float(np.median(beside[name].times_ms))], [z_error_mm(beside[name])], style, markersize=10, label=name
            )
    right.set(
        title="error beside time, ten robots at 0.8 to 2 m, 1280x1024",
        xlabel="median time of a frame, ms",
        xscale="log",
    )
    times = (1, 3, 10, 30, 100, 300)
    right.set_xticks(times, [str(time) for time in times])
    ticks = (0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20)
    left.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    for panel in (left, right):
        panel.minorticks_off()
        panel.grid(visible=True, which="major", alpha=0.3)
    figure.legend(*right.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    figure.savefig(out, dpi=110)


def main(out: Path | None, console: Console) -> list[Path]:
    """Measure and print; the plots that were written."""
    cv2.setNumThreads(1)
    times: dict[str, dict[int, dict[str, Result]]] = {}
    for size, (width, height, focal) in SIZES.items():
        times[size] = {}
        for count in (1, 10, 50):
            camera = make_camera(width, height, focal)
            rig = make_rig(count, camera=camera, range_m=(0.8, 2.0) if count <= 10 else (1.9, 2.3))
            results = run(rig, rounds=3, peers=size == "1280x1024" and count <= 10)
            times[size][count] = results
            table = Table(
                title=f"{size}, {count} robot{'s' * (count > 1)}, one thread", box=box.SIMPLE_HEAD, pad_edge=False
            )
            for heading in ("frame to poses", "median ms", "99 %", "x np.max", "right", "z error mm"):
                table.add_column(heading, justify="left" if heading == "frame to poses" else "right")
            base = float(np.median(results[MEMORY].times_ms))
            for name, result in results.items():
                median, late = np.percentile(result.times_ms, [50, 99])
                share = f"{100 * result.right / result.asked:.1f} %" if result.asked else ""
                depth = f"{z_error_mm(result):.3f}" if result.z_errors else ""
                table.add_row(name, f"{median:.2f}", f"{late:.2f}", f"{median / base:.1f}", share, depth)
            console.print(table)
    console.print(stages(make_rig(10)))
    told = against_distance()
    console.print(distance_table(told))
    if out is None:
        return []
    import matplotlib as mpl

    mpl.use("Agg")
    out.mkdir(parents=True, exist_ok=True)
    plot_times(times, out / "time.png")
    plot_errors(told, times["1280x1024"][10], out / "error.png")
    return [out / "time.png", out / "error.png"]


if __name__ == "__main__":
    for path in main(Path(sys.argv[1]) if len(sys.argv) > 1 else None, Console(width=110)):
        print(path)
