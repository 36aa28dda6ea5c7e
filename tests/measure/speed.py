"""A frame with ten robots beside one memory pass and a plain OpenCV chain: `python -m tests.measure.speed`.

Everything on one thread and on the same forty frames in forty buffers, so that no frame is in the cache from before;
the contestants take turns frame by frame, so that a busy machine hurts them alike. Times are medians.
"""

import time
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from asterism.protocol.geometry import angle_between
from asterism.protocol.rig import Rig
from asterism.server import Frame, PoseEstimate, Tracks, localize
from asterism.server.simulate import Scene
from tests.measure.plain_chain import PlainChain
from tests.rigs import make_rig

ROBOTS, FRAMES, ROUNDS, RATE = 10, 40, 5, 60


def right(rig: Rig, result: Any, truth: dict[str, Any]) -> int:
    """How many robots have a pose within 20 mm and 5 degrees of the truth."""
    count = 0
    for robot, answer in result.answers.items():
        if isinstance(answer, PoseEstimate):
            true = truth[robot]
            away = np.linalg.norm(answer.position - true.position)
            count += bool(away < 0.02 and angle_between(answer.pose.rotation, true.rotation) < np.radians(5))
    return count


def main() -> None:
    """Measure and print."""
    cv2.setNumThreads(1)
    rig = make_rig(ROBOTS)
    scene = Scene(rig, seed=0)
    truths = [scene.truth(k, k / RATE) for k in range(FRAMES)]
    images = [scene.render(k, truths[k]) for k in range(FRAMES)]
    poses = [{entry.robot: entry.T_camera_robot for entry in truth} for truth in truths]
    plain = PlainChain(rig)
    times: dict[str, list[float]] = {name: [] for name in ("np.max", "warm", "cold", "plain")}
    found = dict.fromkeys(times, 0)

    def timed(name: str, call: Callable[[], Any]) -> Any:
        start = time.perf_counter()
        value = call()
        times[name].append((time.perf_counter() - start) * 1e3)
        return value

    for round_ in range(ROUNDS + 1):
        tracks = Tracks.none()
        if round_ == 1:  # the first round warms up: compilation, caches
            for name in times:
                times[name], found[name] = [], 0
        for k, image in enumerate(images):
            frame = Frame(image, exposed_ns=1 + k * 10**9 // RATE, index=k)
            timed("np.max", lambda image=image: np.max(image))
            result = timed("cold", lambda frame=frame: localize(frame, rig, Tracks.none()))[0]
            found["cold"] += right(rig, result, poses[k])
            if k == 0:
                tracks = localize(frame, rig, tracks)[1]  # the frame before the first warm one
            else:
                result, tracks = timed("warm", lambda frame=frame, tracks=tracks: localize(frame, rig, tracks))
                found["warm"] += right(rig, result, poses[k])
            answers = timed("plain", lambda image=image: plain.locate(image))
            for robot, (rotation, position) in answers.items():
                true = poses[k][robot]
                near = np.linalg.norm(position - true.position) < 0.02
                found["plain"] += bool(near and angle_between(rotation, true.rotation) < np.radians(5))

    table = Table(
        title=f"{rig.camera.width}x{rig.camera.height}, {ROBOTS} robots, one thread, {ROUNDS} x {FRAMES} frames",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
    )
    for heading in ("frame to poses", "median", "99 %", "x np.max", "poses that are right"):
        table.add_column(heading, justify="left" if heading == "frame to poses" else "right")
    names = {
        "np.max": "one np.max over the frame",
        "warm": "asterism, following",
        "cold": "asterism, each frame alone",
        "plain": "plain OpenCV chain, each frame alone",
    }
    base = float(np.median(times["np.max"]))
    for name, label in names.items():
        median, late = np.percentile(times[name], [50, 99])
        share = "" if name == "np.max" else f"{100 * found[name] / (ROBOTS * len(times[name])):.1f} %"
        table.add_row(label, f"{median:.2f} ms", f"{late:.2f} ms", f"{median / base:.0f}", share)
    Console(width=100).print(table)


if __name__ == "__main__":
    main()
