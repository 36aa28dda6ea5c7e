"""A GigE Vision camera over real sockets, Aravis' emulated one on loopback: `python -m tests.measure.gige [SECONDS]`.

The demo rig's simulated frames, 1280x1024, for SECONDS (default 20) each: frame numbers without a gap at the emulator's
own rate; the time of mid-exposure against the moment at which the emulator took the frame, with its clock right and
100 ppm fast, from the fifteenth second on; one packet of a hundred lost, what was counted and used of the frames, and
their poses against the truth; a camera that is ended and started again; and for how long closing one holds up another
thread. The emulator sends its first packet at once, as no camera does: what delay is always there is not in this.
"""

import itertools
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from asterism.protocol.capture import Capture
from asterism.protocol.geometry import angle_between
from asterism.protocol.rig import Rig, load_rig
from asterism.server.chain.pipeline import localize
from asterism.server.pose.solve import PoseEstimate
from asterism.server.pose.track import Tracks
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.simulation.simulate import Scene
from asterism.server.sources.background import wait_for_background
from asterism.server.sources.camera import Camera
from asterism.server.sources.open_source import open_source
from tests.sources.genicam.fake_camera import ADDRESS, FakeCamera, fake_camera, truth_of

EXPOSURE_US, RATE_HZ, LENGTH = 500.0, 30.0, 24
SETTLED_S = 15.0
TIMES = 5  # that the camera is unplugged
WRONG_M, WRONG_DEG = 0.002, 1.5


class Film:
    """Frames forwards and backwards, so that nothing jumps, and where the robots are in each."""

    def __init__(self, rig: Rig) -> None:
        scene = Scene(rig, 0)
        order = [*range(LENGTH), *range(LENGTH - 2, 0, -1)]
        self.truth = [scene.truth(k, k / 60.0) for k in order]
        rendered = [scene.render(k, scene.truth(k, k / 60.0)) for k in range(LENGTH)]
        self.images = np.stack([rendered[k] for k in order])
        self._places = {image.tobytes(): place for place, image in enumerate(self.images)}

    def place(self, image: NDArray[np.uint8]) -> int | None:
        """Which one it is; None where it is none of them, bit for bit."""
        return self._places.get(image.tobytes())


@contextmanager
def opened(film: Film, rig: Rig, say: Callable[[str], None], *options: str) -> Iterator[tuple[Camera, FakeCamera]]:
    """The camera and its emulator."""
    with tempfile.TemporaryDirectory() as folder, fake_camera(Path(folder), film.images, *options) as emulator:
        camera = open_source(f"genicam:{ADDRESS}", rig, say)
        assert isinstance(camera, Camera)
        yield camera, emulator
        camera.close()


def run_time(film: Film, rig: Rig, seconds: float, *options: str) -> list[str]:
    """Errors of mid-exposure, ms: median and largest, and where one begins to be right to a millisecond."""
    errors, at = [], []
    with opened(film, rig, print, "--truth", *options) as (camera, _):
        began = time.monotonic()
        for frame in camera.frames():
            took_ns = truth_of(frame.image) + EXPOSURE_US * 500
            errors.append((frame.exposed_ns - camera.clock.at_ns(round(took_ns), frame.session)) / 1e6)
            at.append(time.monotonic() - began)
            if at[-1] > seconds:
                break
        lost = f"{camera.missed + camera.unreadable} of {len(errors)} missing"
    late = np.abs(np.array(errors)[np.array(at) > SETTLED_S])
    first = np.array(at)[np.flatnonzero(np.abs(errors) > 1.0)[-1:]]
    return [
        f"{len(errors) / at[-1]:.1f} Hz, {lost}; error {np.median(late):.2f} ms, at most {late.max():.2f} ms; "
        f"last above 1 ms at {first[0] if len(first) else 0.0:.1f} s"
    ]


def run_lost(film: Film, rig: Rig, seconds: float) -> list[str]:
    """One packet of a hundred lost; jumbo frames, or none would be whole."""
    foreign = wrong = poses = 0
    tracks, until = Tracks.none(), time.monotonic() + seconds
    said: list[str] = []
    with opened(film, rig, said.append, "--lost", "0.01", "--packet", "9000") as (camera, emulator):
        numbers = []
        for frame in camera.frames():
            place = film.place(frame.image)
            foreign += place is None
            result, tracks = localize(frame, rig, tracks)
            for true in film.truth[place or 0]:
                answer = result.answers[true.robot]
                if isinstance(answer, PoseEstimate):
                    poses += 1
                    wrong += is_wrong(rig, answer, true.T_camera_robot)
            numbers.append(frame.index)
            if time.monotonic() > until:
                break
        sent = emulator.sent()
        counted = len(numbers) + camera.unreadable + camera.missed
    return [
        f"{len(numbers)} whole frames, {foreign} of them not as sent; {camera.unreadable} incomplete, "
        f"{camera.missed} missed; {counted} counted of {sent} sent by then",
        f"{poses} poses, {wrong} wrong (by {1e3 * WRONG_M:g} mm or {WRONG_DEG:g} degrees)",
        *said,
    ]


def is_wrong(rig: Rig, answer: PoseEstimate, true: object) -> bool:
    """Farther from the truth than any honest error; both in the camera's frame."""
    T = answer.pose if rig.T_world_camera is None else rig.T_world_camera.inverse() @ answer.pose
    away = float(np.linalg.norm(T.position - true.position))  # type: ignore[attr-defined]
    turned = angle_between(T.rotation, true.rotation)  # type: ignore[attr-defined]
    return away > WRONG_M or turned > np.radians(WRONG_DEG)


def run_back(film: Film, rig: Rig) -> list[str]:
    """Unplugged, and plugged in again two seconds later."""
    said: list[tuple[float, str]] = []
    gone, back = [], []
    with opened(film, rig, lambda text: said.append((time.monotonic(), text))) as (camera, emulator):
        stream = camera.frames()
        for _ in range(TIMES):
            list(itertools.islice(stream, 20))
            emulator.unplug()
            unplugged = time.monotonic()
            starts: list[float] = []
            thread = threading.Thread(target=plug_in, args=(emulator, starts))
            thread.start()
            while not starts:  # what was under way still comes
                next(stream)
            thread.join()
            back.append(time.monotonic() - starts[0])
            gone.append(next(at for at, text in said if at > unplugged and "vanished" in text) - unplugged)
    told = f"said after {max(gone):.2f} s at most; frames {max(back):.2f} s at most after the camera was back"
    return [f"{told} ({TIMES} times)"]


def plug_in(emulator: FakeCamera, starts: list[float]) -> None:
    """After two seconds."""
    time.sleep(2.0)
    emulator.start()
    starts.append(time.monotonic())


def run_closing(film: Film, rig: Rig) -> list[str]:
    """The longest time another thread was held up while a camera that is there, and one that is gone, are let go."""
    gaps: dict[str, float] = {"nothing": longest_gap(lambda: time.sleep(2.0))}
    calls: list[float] = []

    def let_go(camera: Camera) -> None:
        began = time.monotonic()
        assert camera._device is not None
        camera._device.close()
        calls.append(time.monotonic() - began)
        wait_for_background(20.0)

    for _ in range(3):
        with opened(film, rig, print) as (camera, emulator):
            gaps["there"] = max(gaps.get("there", 0.0), longest_gap(lambda camera=camera: let_go(camera)))
        with opened(film, rig, print) as (camera, emulator):
            emulator.unplug()
            gaps["gone"] = max(gaps.get("gone", 0.0), longest_gap(lambda camera=camera: let_go(camera)))
            emulator.start()
    told = ", ".join(f"{1e3 * gap:.0f} ms ({what})" for what, gap in gaps.items())
    return [f"longest gap of another thread: {told}; the call itself {1e3 * max(calls):.1f} ms at most"]


def longest_gap(work: Callable[[], None]) -> float:
    """Of a thread that does next to nothing every millisecond, s."""
    done, longest = threading.Event(), [0.0]

    def tick() -> None:
        before = time.monotonic()
        while not done.is_set():
            time.sleep(0.001)
            now = time.monotonic()
            longest[0] = max(longest[0], now - before)
            before = now

    thread = threading.Thread(target=tick)
    thread.start()
    work()
    done.set()
    thread.join()
    return longest[0]


def main(seconds: float) -> None:
    """Print the table."""
    rig = replace(load_rig(DEMO_RIG), capture=Capture(rate_hz=RATE_HZ, exposure_us=EXPOSURE_US))
    film = Film(rig)
    table = Table("what", "figures")
    for what, lines in (
        ("clock right", run_time(film, rig, seconds)),
        ("clock 100 ppm fast", run_time(film, rig, seconds, "--drift", "100")),
        ("clock 100 ppm slow", run_time(film, rig, seconds, "--drift=-100")),
        ("1 % of packets lost", run_lost(film, rig, seconds)),
        ("unplugged and back", run_back(film, rig)),
        ("closing", run_closing(film, rig)),
    ):
        table.add_row(what, "\n".join(lines))
    Console(width=160).print(table)


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 20.0)
