"""Films in memory, and a batch of them in this process: what cutting does, without what opening files costs."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from asterism.protocol.capture import Capture
from asterism.protocol.geometry import Pose
from asterism.protocol.rig import Rig
from asterism.server import Frame
from asterism.server.service.batch import solving
from asterism.server.service.batch.assembling import assemble
from asterism.server.service.batch.cutting import Piece
from asterism.server.service.batch.folder import Outcome
from asterism.server.service.batch.jobs import Film
from asterism.server.service.batch.running import Course, run
from asterism.server.simulation.simulate import Look, Scene
from tests.rigs import make_camera, make_rig

RATE_HZ = 60.0
BEGIN_NS = 1_700_000_000_000_000_000


class Held:
    """Frames that are there already."""

    live, unreadable, name, rate_hz = False, 0, "held", RATE_HZ

    def __init__(self, frames: list[Frame]) -> None:
        self._frames = frames
        self.length = self.places = len(frames)

    def frames(self) -> Iterator[Frame]:
        return iter(self._frames)

    def part(self, first: int, end: int) -> Iterator[Frame]:
        return islice(self._frames, first, end)


class Bench(Scene):
    """The first of the robots stand still."""

    standing = 0

    def pose(self, robot: int, time_s: float) -> Pose:
        return super().pose(robot, 0.0 if robot < self.standing else time_s)


def small_rig(robots: int) -> Rig:
    """A rig of small images, so that films are localized fast."""
    return replace(
        make_rig(robots, 4), camera=make_camera(640, 512, 700.0), T_world_camera=Pose.identity(), capture=Capture()
    )


def with_standing(rig: Rig, standing: int) -> Rig:
    """The rig that has its camera followed by its first robots, which stand still."""
    places = [Bench(rig, 3).pose(k, 0.0) if k < standing else None for k in range(len(rig.robots))]
    robots = (replace(robot, T_world_fixed=place) for robot, place in zip(rig.robots, places, strict=True))
    return replace(rig, follows_world=True, robots=tuple(robots))


def filmed(rig: Rig, count: int, standing: int = 0, hidden: float = 0.03) -> list[Frame]:
    """A film of the rig's robots, some of which stand still."""
    scene = Bench(rig, 3, Look(hidden=hidden))
    scene.standing = standing
    return [
        Frame(scene.render(k, scene.truth(k, k / RATE_HZ)), BEGIN_NS + round(k * 1e9 / RATE_HZ), k, f"{k:06d}")
        for k in range(count)
    ]


def off(rig: Rig, metres: float, rng: np.random.Generator) -> Rig:
    """The rig with its LEDs beside where they are, as a ruler leaves them."""
    noise = [metres * rng.normal(size=(6, 2)) for _ in rig.robots]
    leds = [robot.leds + np.column_stack([n, np.zeros(6)]) for robot, n in zip(rig.robots, noise, strict=True)]
    return replace(rig, robots=tuple(replace(robot, leds=at) for robot, at in zip(rig.robots, leds, strict=True)))


def batched(
    monkeypatch: pytest.MonkeyPatch, folder: Path, frames: list[Frame], rig: Rig, pieces: list[Piece], key: str = "key"
) -> tuple[bytes, Outcome]:
    """The lines of a film that was cut so, and what came of it."""
    monkeypatch.setattr(solving, "open_source", lambda *_, **__: Held(frames))
    own = folder / key
    own.mkdir(parents=True, exist_ok=True)
    course = Course("film", Film("held", None, rig, str(own), False, None, own), pieces, len(frames))
    course.recall()
    found: list[Outcome] = []
    with ThreadPoolExecutor(2) as executor:
        run([course], executor, (), lambda course: found.append(assemble(course, folder)))
    outcome = found[0]
    return (folder / outcome.file).read_bytes() if outcome.file else b"", outcome
