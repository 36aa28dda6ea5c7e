"""A link between two network namespaces that delays, loses and carries little, as a wireless one does.

The kernel's own `tc netem` where it has that; else two taps with a program of ours between them, which does the same:
every packet takes its time on a link of that rate, waits behind the ones before (`QUEUE` of them at most), comes later
by the delay, and is lost by chance.
"""

import contextlib
import fcntl
import os
import queue
import random
import select
import struct
import subprocess
import threading
import time
from typing import NamedTuple

QUEUE = 1000  # packets, as netem has it
TUNSETIFF, IFF_TAP, IFF_NO_PI = 0x400454CA, 0x0002, 0x1000


class Quality(NamedTuple):
    """In each direction."""

    delay_s: float = 0.020
    loss: float = 0.01
    rate_bits: float = 1e6

    def netem(self) -> list[str]:
        """As `tc` has it."""
        return [
            *("delay", f"{1e3 * self.delay_s:g}ms", "loss", f"{100 * self.loss:g}%"),
            *("rate", f"{self.rate_bits:g}bit", "limit", str(QUEUE)),
        ]


def run(*words: str) -> None:
    """A command of iproute2, which has to succeed."""
    subprocess.run(words, check=True, capture_output=True, text=True)


class End(NamedTuple):
    """Where the link ends: a namespace, the device there, its address with the prefix's length."""

    space: str
    device: str
    address: str

    def inside(self, *words: str) -> None:
        """A command in that namespace."""
        run("ip", "netns", "exec", self.space, *words)

    def bring_up(self) -> None:
        """Give it its address, and begin."""
        self.inside("ip", "addr", "add", self.address, "dev", self.device)
        self.inside("ip", "link", "set", self.device, "up")


def kernel_has_netem() -> bool:
    """Whether `tc netem` does anything here; tried in a namespace of its own."""
    tried = subprocess.run(
        ["unshare", "-n", "tc", "qdisc", "add", "dev", "lo", "root", "netem", "delay", "1ms"],
        capture_output=True,
        check=False,
    )
    return tried.returncode == 0


class SlowLink:
    """Between two ends. A context manager; ``how`` says by what it is made."""

    def __init__(self, ends: tuple[End, End], quality: Quality, seed: int = 0) -> None:
        self.quality = quality
        self._ends = ends
        self._netem = kernel_has_netem()
        self.how = "tc netem" if self._netem else "two taps and a program of ours: this kernel has no netem"
        self._cut = False
        self._stop = threading.Event()
        self._files: list[int] = []
        self._threads: list[threading.Thread] = []
        self._rng = random.Random(seed)

    def __enter__(self) -> "SlowLink":
        if self._netem:
            a, b = self._ends
            run("ip", "link", "add", a.device, "netns", a.space, "type", "veth", "peer", b.device, "netns", b.space)
            for end in self._ends:
                end.inside("tc", "qdisc", "add", "dev", end.device, "root", "netem", *self.quality.netem())
        else:
            self._files = [_tap(end) for end in self._ends]
            for source, to in (self._files, self._files[::-1]):
                self._carry(source, to)
        for end in self._ends:
            end.bring_up()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        for thread in self._threads:
            thread.join()
        for file in self._files:
            os.close(file)

    def cut(self, is_cut: bool) -> None:
        """Carry nothing, in silence, or carry again."""
        self._cut = is_cut
        if self._netem:
            lost = Quality(loss=1.0) if is_cut else self.quality
            for end in self._ends:
                end.inside("tc", "qdisc", "change", "dev", end.device, "root", "netem", *lost.netem())

    def _carry(self, source: int, to: int) -> None:
        on_its_way: queue.Queue[tuple[float, bytes]] = queue.Queue(QUEUE)
        for work in (self._take, self._give):
            thread = threading.Thread(target=work, args=(source if work == self._take else to, on_its_way))
            self._threads.append(thread)
            thread.start()

    def _take(self, source: int, on_its_way: "queue.Queue[tuple[float, bytes]]") -> None:
        free_s = 0.0  # when the link has sent what it was given
        while not self._stop.is_set():
            if not select.select([source], [], [], 0.05)[0]:
                continue
            packet = os.read(source, 65536)
            if self._cut or self._rng.random() < self.quality.loss:
                continue
            free_s = max(free_s, time.monotonic()) + 8 * len(packet) / self.quality.rate_bits
            with contextlib.suppress(queue.Full):
                on_its_way.put_nowait((free_s + self.quality.delay_s, packet))

    def _give(self, to: int, on_its_way: "queue.Queue[tuple[float, bytes]]") -> None:
        while not self._stop.is_set():
            try:
                due_s, packet = on_its_way.get(timeout=0.05)
            except queue.Empty:
                continue
            time.sleep(max(due_s - time.monotonic(), 0.0))
            with contextlib.suppress(OSError):  # it is down
                if not self._cut:
                    os.write(to, packet)


def _tap(end: End) -> int:
    """A tap device in that namespace, and what is sent into it."""
    file = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(file, TUNSETIFF, struct.pack("16sH22x", end.device.encode(), IFF_TAP | IFF_NO_PI))
    run("ip", "link", "set", end.device, "netns", end.space)
    return file
