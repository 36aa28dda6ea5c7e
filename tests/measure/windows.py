"""What recording costs, and what windows around spots are worth: `python -m tests.measure.windows [FOLDER ...]`.

Without folders: 120 frames of the demonstration. A FOLDER holds `rig.yaml` and `frames/`. Printed for `none`, `all` and
`spots`: processor time of the recorder a frame, bytes of images a frame; for `spots` how many times smaller, and of all
poses the share that is solved again to the last bit and within 0.1 sigma of the whole frame, and the farthest.
"""

import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from rich import box
from rich.console import Console
from rich.table import Table

from asterism.protocol.codec import stamped
from asterism.protocol.messages import Message
from asterism.protocol.rig import Rig, load_rig
from asterism.recordings.reader import Recording
from asterism.recordings.recorder import FramesKept, Recorder
from asterism.server import Frame, Tracks, localize
from asterism.server.chain.report import report
from asterism.server.chain.warm_up import localizing, warm_up
from asterism.server.pose.solve import PoseEstimate
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.simulation.simulate import Scene
from tests.recordings.test_spots import START_NS, off_sigmas

Made = list[tuple[Frame, list[Message], dict[str, object]]]
LEAST_FRAMES = 300  # that are recorded for the time


def made_of(rig: Rig, images: list[NDArray[np.uint8]]) -> Made:
    """Frames, their messages and answers."""
    tracks, made = Tracks.none(), []
    for index, image in enumerate(images):
        frame = Frame(image, START_NS + index * 16_666_667, index)
        result, tracks = localize(frame, rig, tracks)
        told = [stamped(m, frame.exposed_ns) for m in report(frame, result, rig, frame.exposed_ns)]
        made.append((frame, told, dict(result.answers)))
    return made


def record(rig: Rig, made: Made, kept: FramesKept, times: int) -> tuple[Recorder, float]:
    """Record all so many times over: the recorder, and the processor time a frame, ms."""
    began = time.process_time()
    recorder = Recorder(Path(tempfile.mkdtemp()), rig, "measure", kept, wait=True)
    for turn in range(times):
        for frame, messages, _ in made:
            recorder.write(messages, frame.image, frame.exposed_ns, turn * len(made) + frame.index)
    recorder.close({})
    return recorder, (time.process_time() - began) / times / len(made) * 1e3


def solved_again(rig: Rig, recorder: Recorder, made: Made) -> NDArray[np.float64]:
    """By how many sigma each pose differs, inf where it is there only once."""
    tracks, off = Tracks.none(), []
    for image, exposed_ns, index in Recording(recorder.folder).frames():
        result, tracks = localize(Frame(image, exposed_ns, index), rig, tracks)
        for robot, answer in result.answers.items():
            was = made[index][2][robot]
            if isinstance(was, PoseEstimate) and isinstance(answer, PoseEstimate):
                off.append(off_sigmas(was, answer))
            elif isinstance(was, PoseEstimate) != isinstance(answer, PoseEstimate):
                off.append(np.inf)
    return np.array(off)


def measure(name: str, rig: Rig, images: list[NDArray[np.uint8]]) -> list[list[str]]:
    """Rows of the table."""
    warm_up(*localizing(rig))
    made, rows = made_of(rig, images), []
    times = -(-LEAST_FRAMES // len(made))
    for word, kept in (("none", FramesKept(0)), ("all", FramesKept()), ("spots", FramesKept(spots=True))):
        recorder, cost_ms = record(rig, made, kept, times)
        size = sum(file.stat().st_size for file in recorder.folder.glob("frames-*")) / times / len(made)
        row = [name, word, f"{cost_ms:.2f}", f"{size:.0f}"]
        if kept.spots:
            once, _ = record(rig, made, kept, 1)
            off = solved_again(rig, once, made)
            row += [f"{images[0].nbytes / size:.1f}", f"{len(off)}", f"{np.mean(off == 0):.1%}"]
            row += [f"{np.mean(off < 0.1):.1%}", f"{off.max(initial=0.0):.3f}"]
        rows.append(row)
    return rows


def main(folders: list[Path]) -> None:
    """Measure and print."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    heads = ("frames", "kept", "ms", "bytes", "smaller", "poses", "same", "within 0.1 sigma", "farthest")
    for heading in heads:
        table.add_column(heading, justify="right")
    if not folders:
        rig = load_rig(DEMO_RIG)
        scene = Scene(rig, 0)
        images = [scene.render(index, scene.truth(index, index / 60)) for index in range(120)]
        for row in measure("demo", rig, images):
            table.add_row(*row)
    for folder in folders:
        files = sorted((folder / "frames").iterdir())
        images = [cv2.imread(str(file), cv2.IMREAD_GRAYSCALE) for file in files]  # type: ignore[misc]
        for row in measure(folder.name, load_rig(folder / "rig.yaml"), images):
            table.add_row(*row)
    Console(width=120).print(table)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        tempfile.tempdir = place
        main([Path(word) for word in sys.argv[1:]])
