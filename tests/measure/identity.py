"""Who is who, at scale: `python -m tests.measure.identity [--sightings N]`.

Rendered frames with clutter, hidden LEDs, reflections, strangers and robots side by side, each located alone. A robot's
LED is "in place" if a spot that was kept lies within one pixel of where the LED truly is: what is lost before is the
image's fault or the segmentation's, what is lost after is identification's. "covered": clutter or another LED is in its
way. "wrong": more than 20 mm off, the other tilt too if it is told, or not there; "tilt": more than 5 degrees off in
silence (tests/chain/judging.py); "strained": neither, but the squared error is 60 or more in units of the covariance.
Everything is seeded: whatever is listed below the tables can be had again as `SCENES[name](number)`.
"""

import argparse
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig
from asterism.server import Frame, Lost, PoseEstimate, Tracks, localize
from asterism.server.pose.lens import project_point
from asterism.server.simulation.simulate import Scene, Truth
from tests.chain.judging import Judged
from tests.identity.foreign_light import LOOK, Light, leds_of
from tests.rigs import make_rig

BLOCK = 10  # frames that share a rig and a scene
RANGES = ((0.9, 1.3), (1.2, 1.6), (1.4, 1.8))
COVERED = 6.0  # grey levels of foreign light beside an LED: the least that the segmentation sees


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """A frame, the rig it is located with, everything lit in it, and the light that is nobody's LED."""

    scene: Scene
    rig: Rig
    image: NDArray[np.uint8]
    truth: list[Truth]
    foreign: Floats  # (h, w) expected grey levels


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """One robot in one shot."""

    where: str
    judged: Judged
    in_place: int  # of its visible LEDs
    covered: int
    impostors: int  # LEDs of the answer that rest on a spot more than a pixel away from the true place
    reason: str

    @property
    def bad(self) -> str:
        """What is wrong with the answer, if anything is."""
        if self.judged.wrong:
            return "wrong"
        if self.judged.silent_tilt:
            return "tilt"
        return "strained" if self.judged.answer and not self.judged.tilted and self.judged.nees >= 60.0 else ""

    def __str__(self) -> str:
        lit = f"{self.where}: {self.judged.visible} lit, {self.in_place} in place, {self.covered} covered"
        answer = self.judged.answer
        if answer is None:
            return f"{lit}; not found: {self.reason}"
        sigma = np.sqrt(np.linalg.eigvalsh(answer.covariance[:3, :3])[-1])
        turn = np.sqrt(np.linalg.eigvalsh(answer.covariance[3:, 3:])[-1])
        said = f"{len(answer.leds)} LEDs, {self.impostors} impostors, rms {answer.rms_px:.3f} px"
        said += f", sigma {1e3 * sigma:.2f} mm {np.degrees(turn):.2f} deg"
        said += f", other tilt 1:{answer.alternative.odds:.0f}" if answer.alternative else ""
        if self.judged.true is None:
            return f"{lit}; {self.bad}: {said}"
        error = self.judged.error
        off, deg = 1e3 * np.linalg.norm(error[:3]), np.degrees(np.linalg.norm(error[3:]))
        return f"{lit}; {self.bad}: off {off:.1f} mm {deg:.1f} deg, nees {self.judged.nees:.0f}; {said}"


@lru_cache(maxsize=2)
def _scene(robots: int, seed: int, range_m: tuple[float, float]) -> Scene:
    return Scene(make_rig(robots, seed, range_m=range_m), seed, LOOK)


@lru_cache(maxsize=1)
def _catalogue() -> Rig:
    """Two hundred constellations; of 40 000 pairs the nearest are 4.6 mm apart."""
    return make_rig(200, range_m=RANGES[2])


@lru_cache(maxsize=1)
def _chosen(block: int) -> Scene:
    """Fifty robots: forty-five of the catalogue, and five that it doesn't know."""
    unknown = [replace(robot, id=f"s{robot.id}") for robot in make_rig(5, seed=6000).robots]
    known = np.random.default_rng([block, 14]).permutation(200)[:45]
    robots, order = [_catalogue().robots[k] for k in known] + unknown, np.random.default_rng(15).permutation(50)
    return Scene(replace(_catalogue(), robots=tuple(robots[k] for k in order)), block, LOOK)


def _hide(truth: list[Truth], rng: np.random.Generator, share: float, counts: tuple[int, ...]) -> list[Truth]:
    """Hide so many LEDs of a share of the robots."""
    out = []
    for entry in truth:
        dark: list[int] = rng.permutation(6)[: rng.choice(counts)].tolist() if rng.random() < share else []
        out.append(replace(entry, lit=tuple(led not in dark for led in range(6))))
    return out


def _shot(scene: Scene, number: int, truth: list[Truth], light: Light, rig: Rig | None = None) -> Shot:
    image = light.on(scene.render(number, truth))
    return Shot(scene, rig or scene.rig, image, truth, light.levels)


def crowd(robots: int, number: int, clutter: float = 0.5, share: float = 0.3, hidden: tuple[int, ...] = (1, 2)) -> Shot:
    """Robots all over the view, ``clutter`` bright things an LED, some LEDs hidden."""
    block, rng = number // BLOCK, np.random.default_rng([robots, number, 7])
    scene = _scene(robots, block, RANGES[block % 3] if robots < 50 else RANGES[2])
    truth = _hide(scene.truth(number, 1.7 * number), rng, share, hidden)
    light = Light(scene, rng)
    light.clutter(round(clutter * 6 * robots), truth)
    return _shot(scene, number, truth, light)


def nobody(number: int) -> Shot:
    """Clutter and no robot."""
    rng, scene = np.random.default_rng([number, 8]), _scene(8, number // 50, RANGES[1])
    light = Light(scene, rng)
    light.clutter(int(rng.integers(10, 250)), [])
    return _shot(scene, number, [], light)


def polished(number: int, share: float = 0.0, hidden: tuple[int, ...] = (1,)) -> Shot:
    """A floor that mirrors every robot, complete, 0.12 m farther; some LEDs of the robots themselves are hidden."""
    block, rng = number // BLOCK, np.random.default_rng([number, 9])
    scene = _scene(8, block, RANGES[block % 3])
    truth = _hide(scene.truth(number, 1.7 * number), rng, share, hidden)
    light, dim = Light(scene, rng), rng.uniform(0.15, 0.55)
    for entry in truth:
        normal = entry.T_camera_robot.rotation[:, 2]
        for led in leds_of(scene.rig, entry) - 0.12 * normal:
            facing = -float(normal @ led) / float(np.linalg.norm(led))
            light.disc(led, normal, 0.0025, dim * LOOK.brightness * max(facing, 0.0))
    return _shot(scene, number, truth, light)


def strangers(number: int) -> Shot:
    """Twenty robots of which ten are not in the rig; some LEDs hidden."""
    block, rng = number // BLOCK, np.random.default_rng([number, 10])
    ours, others = make_rig(10, block, range_m=RANGES[block % 3]), make_rig(10, block + 5000)
    unknown = tuple(replace(robot, id=f"s{robot.id}") for robot in others.robots)
    both = tuple(robot for pair in zip(ours.robots, unknown, strict=True) for robot in pair)
    scene = Scene(replace(ours, robots=both), block, LOOK)
    truth = _hide(scene.truth(number, 1.7 * number), rng, 0.3, (1, 2))
    return _shot(scene, number, truth, Light(scene, rng), ours)


def catalogue(number: int) -> Shot:
    """Fifty robots in clutter, five of them strangers; the rig has a hundred and fifty-five more."""
    rng, scene = np.random.default_rng([number, 13]), _chosen(number // BLOCK)
    truth = _hide(scene.truth(number, 1.7 * number), rng, 0.3, (1, 2))
    light = Light(scene, rng)
    light.clutter(150, truth)
    return _shot(scene, number, truth, light, _catalogue())


def touching(number: int) -> Shot:
    """Four pairs, each side by side on one plane, disc against disc (0.05 m and an LED's radius each)."""
    block, rng = number // BLOCK, np.random.default_rng([number, 11])
    scene = _scene(8, block, RANGES[1])
    truth: list[Truth] = []
    for pair in range(4):
        at = np.array([0.2 * (pair % 2 * 2 - 1), 0.16 * (pair // 2 * 2 - 1), 1.0]) * rng.uniform(1.2, 1.6)
        normal = np.array([0.0, 0.0, -1.0]) + np.tan(np.radians(40)) * rng.uniform(-0.7, 0.7, 3) * [1, 1, 0]
        normal /= np.linalg.norm(normal)
        x = np.cross(normal, rng.normal(size=3))
        x /= np.linalg.norm(x)
        y = np.cross(normal, x)
        for side in (-1, 1):
            angle = rng.uniform(0, 2 * np.pi)
            ahead = np.cos(angle) * x + np.sin(angle) * y
            turn = np.column_stack([ahead, np.cross(normal, ahead), normal])
            centre = Pose.from_matrix(turn, at + side * 0.0525 * x)
            truth.append(Truth(f"r{len(truth):02d}", centre, (True,) * 6))
    return _shot(scene, number, truth, Light(scene, rng))


SCENES: dict[str, Callable[[int], Shot]] = {
    "crowd 8": lambda k: crowd(8, k),
    "crowd 20": lambda k: crowd(20, k),
    "crowd 50": lambda k: crowd(50, k),
    "clutter alone": nobody,
    "polished floor": polished,
    "polished, robot lacks 1": lambda k: polished(k, 0.3, (1,)),
    "polished, robot lacks 2": lambda k: polished(k, 0.3, (2,)),
    "four LEDs, no clutter": lambda k: crowd(8, k, 0.0, 1.0, (2,)),
    "strangers": strangers,
    "touching pairs": touching,
    "50 robots, catalogue of 200": catalogue,
}


def look_at(name: str, number: int) -> tuple[list[Sighting], float]:
    """Locate a shot alone and judge every robot of the rig; and how many ms it took."""
    shot = SCENES[name](number)
    frame = Frame(shot.image, exposed_ns=1, index=number)
    start = time.perf_counter()
    result, _ = localize(frame, shot.rig, Tracks.none())
    took = 1e3 * (time.perf_counter() - start)
    spots, kept = result.blobs.centres_px, result.blobs.centres_px[result.blobs.kept]
    places, h, w = {}, *shot.image.shape
    for entry in shot.truth:
        at = np.array([project_point(shot.scene.lens, *led) for led in leds_of(shot.scene.rig, entry)])
        places[entry.robot] = at, np.array(entry.lit)
    lamps = np.concatenate([at[lit] for at, lit in places.values()]) if places else np.empty((0, 2))
    sightings = []
    for robot, answer in result.answers.items():
        at, lit = places.get(robot, (np.empty((6, 2)), np.zeros(6, np.bool_)))
        in_place = covered = 0
        for x, y in at[lit]:
            in_place += bool(len(kept) and np.hypot(*(kept - (x, y)).T).min() < 1.0)
            near = shot.foreign[
                max(round(y) - 6, 0) : min(round(y) + 7, h), max(round(x) - 6, 0) : min(round(x) + 7, w)
            ]
            covered += bool(near.max() > COVERED or (np.hypot(*(lamps - (x, y)).T) < 9.0).sum() > 1)
        found = answer if isinstance(answer, PoseEstimate) else None
        true = next((entry.T_camera_robot for entry in shot.truth if entry.robot == robot), None)
        away = spots[list(found.spots)] - at[list(found.leds)] if found and true else np.zeros((0, 2))
        sightings.append(
            Sighting(
                f"{name} {number} {robot}",
                Judged(robot, int(lit.sum()), found, true),
                in_place,
                covered,
                int((np.hypot(*away.T) > 1.0).sum()),
                answer.reason if isinstance(answer, Lost) else "",
            )
        )
    return sightings, took


def _table(title: str, *headings: str) -> Table:
    table = Table(title=title, box=box.SIMPLE_HEAD, pad_edge=False)
    for k, heading in enumerate(headings):
        table.add_column(heading, justify="right" if k else "left", no_wrap=not k)
    return table


def _times(console: Console) -> None:
    """Time against clutter, and a glaring frame."""
    table = _table("one frame alone, ten robots, ms", "bright things beside the LEDs", "median", "most", "found")
    scene = Scene(make_rig(10), 0, LOOK)
    for count in (0, 50, 100, 150, 200, 250, 300, -300):
        times, found = [], 0
        for k in range(8):
            truth, light = scene.truth(k, 1.7 * k), Light(scene, np.random.default_rng([k, 12]))
            light.clutter(abs(count), truth)
            if count < 0:
                x, y = light.rng.integers(0, [980, 824])
                light.levels[y : y + 200, x : x + 300] += 400.0
                light.levels[light.rng.integers(0, 1024, 200), light.rng.integers(0, 1280, 200)] += 220.0
            shot = _shot(scene, k, truth, light)
            for repeat in range(6):
                start = time.perf_counter()
                result, _ = localize(Frame(shot.image, exposed_ns=1, index=k), shot.rig, Tracks.none())
                if repeat:
                    times.append(1e3 * (time.perf_counter() - start))
            found += sum(isinstance(answer, PoseEstimate) for answer in result.answers.values())
        label = str(count) if count >= 0 else "300, a 300x200 lamp, 200 hot pixels"
        table.add_row(label, f"{np.median(times):.1f}", f"{max(times):.1f}", f"{found}/80")
    console.print(table)


def main(sightings: int, most: int) -> None:
    """Measure and print."""
    console = Console(width=140)
    frames = {f"crowd {n}": -(-sightings // (3 * n)) for n in (8, 20, 50)} | {"clutter alone": 1000}
    counted = _table(
        "frames alone", "scene", "frames", "LEDs lit", "robots", "found", "5 or 6 in place", "found of those",
        "wrong", "tilt", "strained", "ms: median", "99 %",
    )  # fmt: skip
    reasons: Counter[tuple[str, int]] = Counter()
    listed: list[str] = []
    for name in SCENES:
        seen, took = [], []
        for number in track(
            range(frames.get(name, 100)), description=name, transient=True, disable=not console.is_terminal
        ):
            robots, ms = look_at(name, number)
            seen += robots
            took.append(ms)
        cells = [name, str(len(took))]
        for lit in sorted({robot.judged.visible for robot in seen}, reverse=True):
            some = [robot for robot in seen if robot.judged.visible == lit]
            good = [robot for robot in some if robot.in_place >= 5]
            bad = Counter(robot.bad for robot in some)
            of = [sum(robot.judged.answer is not None for robot in group) for group in (some, good)]
            counted.add_row(
                *cells, str(lit) if lit else "not there", str(len(some)), str(of[0]), str(len(good)), str(of[1]),
                *(str(bad[kind]) for kind in ("wrong", "tilt", "strained")),
                *([f"{q:.1f}" for q in np.percentile(took, [50, 99])] if cells[0] else []),
            )  # fmt: skip
            cells = ["", ""]
            reasons.update((robot.reason, lit) for robot in some if lit and robot.judged.answer is None)
        worth = [robot for robot in seen if robot.bad or (robot.judged.visible >= 5 and robot.judged.answer is None)]
        listed += [str(robot) for robot in worth]
    console.print(counted)
    why = _table("why visible robots were not found", "reason", "LEDs lit", "robots")
    for (reason, lit), count in sorted(reasons.items()):
        why.add_row(reason, str(lit), str(count))
    console.print(why)
    _times(console)
    for line in listed[:most]:
        console.print(line, soft_wrap=True, highlight=False)
    if len(listed) > most:
        console.print(f"... {len(listed) - most} more; --list {len(listed)} shows all")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sightings", type=int, default=4000, help="of robots in clutter")
    parser.add_argument("--list", type=int, default=40, dest="most", help="failures to list")
    given = parser.parse_args()
    main(given.sightings, given.most)
