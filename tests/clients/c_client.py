"""The C client, compiled and run: messages and events go in as bytes, what it made of them comes back as numbers."""

import os
import shutil
import struct
import subprocess
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.helpers import REPOSITORY

SOURCES = REPOSITORY / "clients" / "c"
DRIVER = Path(__file__).with_name("c_driver.c")
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Werror", "-O1", "-g")
SANITIZED = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")
NAME = 129
POSE = np.dtype(
    [
        ("exposed_ns", "i8"),
        ("published_ns", "i8"),
        ("session", "u8"),
        ("sequence", "u8"),
        ("position", "f8", 3),
        ("orientation", "f8", 4),
        ("covariance", "f8", (6, 6)),
        ("rms_px", "f8"),
        ("linear", "f8", 3),
        ("angular", "f8", 3),
        ("velocity_covariance", "f8", (6, 6)),
        ("accelerations", "f8", 2),
        ("state", "u1"),
        ("leds", "u1"),
        ("smoothed", "u1"),
        ("extrapolated", "u1"),
        ("has_velocity", "u1"),
        ("frame_id", f"S{NAME}"),
        ("robot", f"S{NAME}"),
    ]
)
STATES = {1: "TRACKED", 2: "TILT_AMBIGUOUS"}


def compiler() -> str | None:
    """The C compiler of this machine, if it has one."""
    return shutil.which(os.environ.get("CC", "cc"))


@dataclass(frozen=True)
class Read:
    """What became of one message: the words of its refusal, or the pose."""

    words: str
    pose: np.void | None


@dataclass(frozen=True)
class CClient:
    """The compiled driver; its answers are those of `c_driver.c`."""

    program: Path
    words: tuple[str, ...]
    sanitized: bool  # errors of memory and undefined behaviour end the program

    def poses(self, messages: Sequence[bytes], robot: str | None = "alpha") -> list[Read]:
        """Each message read as a pose of ``robot``, or of any."""
        told = self._run(["poses", *([robot] if robot is not None else [])], map(_with_size, messages))
        reads, at = [], 0
        for _ in messages:
            error, at = told[at], at + 1
            pose = None if error else np.frombuffer(told, POSE, 1, at)[0]
            at += 0 if error else POSE.itemsize
            reads.append(Read(self.words[error], pose))
        assert at == len(told)
        return reads

    def times(self, what: str, messages: Sequence[bytes]) -> list[tuple[str, int, int]]:
        """Each message read as one of the "beats" or "rigs": words, session, clock in ns."""
        told = self._run([what], map(_with_size, messages))
        return [(self.words[error], session, time_ns) for error, session, time_ns in struct.iter_unpack("<BQq", told)]

    def events(self, events: Iterable[tuple[str, int, int, int, int]], alone: bool) -> list[tuple[str, int, bool]]:
        """What a clock says after each event (kind, session, three times): words, age in ns, whether it is heard."""
        packed = (struct.pack("<5q", ord(kind), *numbers) for kind, *numbers in events)
        told = self._run(["alone" if alone else "events"], packed)
        return [(self.words[error], age_ns, bool(heard)) for error, age_ns, heard in struct.iter_unpack("<3q", told)]

    def _run(self, words: list[str], parts: Iterable[bytes]) -> bytes:
        done = subprocess.run([self.program, *words], input=b"".join(parts), capture_output=True, check=False)
        assert done.returncode == 0, done.stderr.decode()[:4000]
        return done.stdout


def build(folder: Path, *flags: str) -> CClient:
    """Compiled into that folder, with the sanitizers where the compiler has them."""
    program = folder / "driver"
    done = _compile(program, *SANITIZED, *flags)
    sanitized = done.returncode == 0
    if not sanitized:
        done = _compile(program, *flags)
    assert done.returncode == 0, done.stderr
    words = subprocess.run([program, "words"], capture_output=True, text=True, check=True).stdout.splitlines()
    return CClient(program, tuple(words), sanitized)


def _compile(program: Path, *flags: str) -> subprocess.CompletedProcess[str]:
    sources = [str(DRIVER), *map(str, sorted(SOURCES.glob("asterism_*.c")))]
    command = [compiler() or "cc", *STRICT, *flags, f"-I{SOURCES}", *sources, "-o", str(program)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def _with_size(message: bytes) -> bytes:
    return struct.pack("<I", len(message)) + message
