"""Many films at once: `python -m tests.measure.batch [FRAMES] [TURNS]` (default 600, 3).

By turns, `batch` on one core, with one process that solves, and on all of them: six films of so many frames, and one
film that is six times as long and is cut. The demonstration's frames are simulated once; films are links to them.
Printed: seconds on the clock and of processors of either, their ratios, and the load of the machine: what others'
processes take is missing in the first ratio, so the second tells what cutting and more starts cost by themselves.
Lines are compared byte for byte, also with `locate`'s of the first film.
"""

import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from rich.console import Console
from rich.table import Table

from asterism.server.chain.compile_beside import cores
from asterism.server.simulation.demo_rig import DEMO_RIG

FILMS = 6


def films_in(folder: Path, frames: int) -> tuple[list[Path], Path]:
    """Some films, and a long one that is all of them, one after the other."""
    subprocess.run(_asterism("simulate", DEMO_RIG, folder / "film", "--frames", frames), check=True)
    images = sorted((folder / "film" / "frames").glob("*.png"))
    short = [folder / f"film{k}" for k in range(FILMS)]
    long = folder / "long"
    long.mkdir()
    for k, film in enumerate(short):
        film.mkdir()
        for number, image in enumerate(images):
            (film / image.name).hardlink_to(image)
            (long / f"{k * frames + number:06d}.png").hardlink_to(image)
    return short, long


def _asterism(*words: object) -> list[str]:
    return [sys.executable, "-m", "asterism", *map(str, words), "--quiet"]


def _timed(command: list[str], alone: bool) -> tuple[float, float]:
    """Seconds on the clock, and of processors."""
    core = min(os.sched_getaffinity(0))
    before, began = os.times(), time.perf_counter()
    words = ["taskset", "--cpu-list", str(core), *command] if alone else command
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
    after = os.times()
    spent = after.children_user + after.children_system - before.children_user - before.children_system
    return time.perf_counter() - began, spent


def turn(folder: Path, films: list[Path]) -> tuple[tuple[float, float], tuple[float, float]]:
    """One after the other, and on all cores."""
    one, all_ = folder / "one", folder / "all"
    alone = _timed(_asterism("batch", DEMO_RIG, *films, "-o", one), alone=True)
    together = _timed(_asterism("batch", DEMO_RIG, *films, "-o", all_), alone=False)
    subprocess.run(_asterism("locate", DEMO_RIG, films[0], "-o", one / "locate"), check=True)
    assert (one / "locate").read_bytes() == (all_ / f"{films[0].name}.jsonl").read_bytes()
    for film in films:
        assert (one / f"{film.name}.jsonl").read_bytes() == (all_ / f"{film.name}.jsonl").read_bytes(), film
    return alone, together


def main(frames: int = 600, turns: int = 3) -> None:
    """Print the table."""
    table = Table("films", "turn", "one s", "all s", "ratio", "one CPU s", "all CPU s", "ratio", "load", box=None)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        short, long = films_in(folder, frames)
        for what, films in ((f"{FILMS} of {frames}", short), (f"1 of {FILMS * frames}, cut", [long])):
            ratios = []
            for k in range(turns):
                own = folder / f"{what[0]}-{k}"
                own.mkdir()
                (wall, spent), (wall2, spent2) = turn(own, films)
                ratios.append(wall / wall2)
                cells = (wall, wall2, wall / wall2, spent, spent2, spent / spent2, os.getloadavg()[0])
                table.add_row(what, str(k + 1), *(f"{cell:.2f}" for cell in cells))
            table.add_row(what, "median", "", "", f"{statistics.median(ratios):.2f}")
    console = Console()
    console.print(table)
    console.print(f"{cores()} cores; the lines are the same, byte for byte")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
