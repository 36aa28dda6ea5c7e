"""A V4L2 camera through the kernel's own driver: `python -m tests.measure.v4l2 [SOURCE] [--pull]`.

For every pixel format that is read: the rate, what was lost, how old mid-exposure is when a frame is had, how evenly
stamps follow one another. --pull (root) takes the driver away from the camera as a pulled cable does, while
somebody still holds the old node, so that it comes back under another number; told is how soon that is said and how
soon frames are back. Without a camera the kernel has one: `modprobe vivid node_types=0x1`.
"""

import argparse
import os
import threading
import time
from contextlib import closing
from pathlib import Path

import numpy as np

from asterism.protocol.capture import Capture
from asterism.protocol.messages import Clock
from asterism.server.sources.camera import Camera, Taken
from asterism.server.sources.v4l2.camera import V4l2Opener
from asterism.server.sources.v4l2.node import KERNEL, Node
from asterism.server.sources.v4l2.offers import read_offers
from asterism.server.sources.v4l2.pixels import FORMATS
from asterism.server.sources.v4l2.place import name_of

LEAST_HZ = 20.0
AWAY_S = 2.0
GIVEN_UP_S = 30.0


def formats(name: str, frames: int) -> None:
    """A line for every pixel format, at the largest size that comes with at least `LEAST_HZ`."""
    with closing(Node(os.path.realpath(name))) as node:
        offers = [offer for offer in read_offers(node) if offer.fourcc in FORMATS]
        print(f"{node.card}, {node.bus}")
    for offer in offers:
        modes = [mode for mode in offer.modes if not mode.rates or mode.rates[0] >= LEAST_HZ] or list(offer.modes)
        mode = max(modes, key=lambda mode: mode.width * mode.height)
        capture = Capture(pixel_format=offer.fourcc, rate_hz=mode.rates[0] if mode.rates else None)
        opener = V4l2Opener(name, capture, mode.size, lambda text: print(f"  {text}"))
        device = opener()
        assert device is not None
        taken: list[tuple[Taken, int]] = []
        while len(taken) < frames:
            one = device.read()
            assert one is not None, "the camera fell silent"
            if isinstance(one, Taken):
                taken.append((one, time.monotonic_ns()))
        device.close()
        clocks = sorted({Clock.Name(one.clock) for one, _ in taken})
        stamps = np.array([one.mid_ns or now for one, now in taken]) / 1e6
        ages, steps = np.array([now for _, now in taken]) / 1e6 - stamps, np.diff(stamps)
        print(
            f"  {offer.fourcc} {mode.width}x{mode.height}: {1e3 / steps.mean():.2f} Hz of "
            f"{capture.rate_hz or float('nan'):g}, {opener.lost.count} lost, clock {' '.join(clocks)}, age "
            f"{np.median(ages):.2f} ms (99 %: {np.percentile(ages, 99):.2f}), steps +- {steps.std():.3f} ms, values "
            f"{min(int(one.image.min()) for one, _ in taken)} to {max(int(one.image.max()) for one, _ in taken)}"
        )


class Watched:
    """A camera as `serve` runs it: when it said what, and when its frames came, s."""

    def __init__(self, name: str) -> None:
        self.said: list[tuple[float, str]] = []
        self.said_s: list[float] = []
        self.frames_s: list[float] = []
        self.opener = V4l2Opener(name, Capture(), None, self._say)
        self.camera = Camera(name, self.opener, None, self._say)
        threading.Thread(target=self._run, daemon=True).start()

    def _say(self, text: str) -> None:
        self.said.append((time.monotonic(), text))
        self.said_s.append(self.said[-1][0])

    def _run(self) -> None:
        for _ in self.camera.frames():
            self.frames_s.append(time.monotonic())


def first_after(times_s: list[float], since_s: float) -> float:
    """How long after a moment the first of some events came, s; it is waited for."""
    while time.monotonic() < since_s + GIVEN_UP_S:
        if times_s and times_s[-1] > since_s:
            return next(at_s for at_s in times_s if at_s > since_s) - since_s
        time.sleep(0.001)
    return float("inf")


def pull(name: str, times: int) -> None:
    """Take the camera away and give it back; how soon is it said, how soon are frames back?"""
    watched = Watched(name)
    for _ in range(times):
        first_after(watched.frames_s, time.monotonic() + 1.0)
        with Path(watched.opener.path).open("rb", buffering=0):
            device = (KERNEL.folder / Path(watched.opener.path).name / "device").resolve()
            driver = (device / "driver").resolve()
            gone_s = time.monotonic()
            (driver / "unbind").write_text(device.name)
            told_s = first_after(watched.said_s, gone_s)
            time.sleep(AWAY_S)
            back_s = time.monotonic()
            (driver / "bind").write_text(device.name)
            again_s = first_after(watched.frames_s, back_s)
        print(f"  said after {told_s:.3f} s, frames {again_s:.3f} s after its return")
    for at_s, text in watched.said:
        print(f"  {at_s - watched.said_s[0]:8.3f} s  {text}")
    watched.camera.close()


if __name__ == "__main__":
    words = argparse.ArgumentParser()
    words.add_argument("source", nargs="?", default="0")
    words.add_argument("--frames", type=int, default=100)
    words.add_argument("--pull", action="store_true")
    options = words.parse_args()
    formats(name_of(options.source), options.frames)
    if options.pull:
        pull(name_of(options.source), 5)
