"""Damaged recordings by the thousand: `python -m tests.measure.mutations [ROUNDS] [SEED]`.

Small recordings as this version and version 0.1 write them, packed in every way, are damaged in every way that
`tests/recordings/mutations.py` knows, ROUNDS times each (default 20). Printed for every kind of damage: how many
files, how many broke what `tests/recordings/judge.py` says must be true, the longest time of one file, and at the end
the memory that the process had at most.
"""

import resource
import shutil
import sys
import tempfile
import time
import traceback
from collections import Counter
from pathlib import Path

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from tests.recordings.judge import readers_refuse_in_a_sentence, recovered
from tests.recordings.mutations import MUTATIONS, hand_made, payloads, recordings, untouched


def judge(work: Path, original: Path, kind: str, seed: tuple[int, ...]) -> str:
    """Damage one file of a copy of a recording; returns what was found wrong, as a line."""
    shutil.rmtree(work, ignore_errors=True)
    shutil.copytree(original, work)
    file = work / f"{('poses', 'frames')[seed[-1] % 2]}-0001.mcap"
    data = file.read_bytes()
    damage = MUTATIONS[kind](data, np.random.default_rng(seed))
    file.write_bytes(damage.data)
    try:
        readers_refuse_in_a_sentence(work)
        recovered(work, payloads(data, untouched(data, damage)))
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__} at {Path(place.filename).name}:{place.lineno}: {str(error)[:100]}"
    return ""


def main(rounds: int, seed: int) -> None:
    """Measure and print."""
    table = Table(title=f"{rounds} rounds", box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("damage", "files", "wrong", "longest, s"):
        table.add_column(heading, justify="left" if heading == "damage" else "right")
    wrong: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        originals = recordings(Path(folder), *hand_made(24, np.random.default_rng(seed)))
        for number, kind in enumerate(MUTATIONS):
            files = failed = 0
            longest = 0.0
            for turn in range(rounds):
                for which, (name, original) in enumerate(originals.items()):
                    began = time.perf_counter()
                    found = judge(Path(folder) / "work", original, kind, (seed, number, which, turn))
                    longest = max(longest, time.perf_counter() - began)
                    files += 1
                    if found:
                        failed += 1
                        wrong[f"{kind}, {name}, {turn}: {found}"] += 1
            table.add_row(kind, str(files), str(failed), f"{longest:.2f}")
    console = Console(width=150)
    console.print(table)
    for line in wrong:
        console.print(line)
    console.print(f"at most {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB of memory")


if __name__ == "__main__":
    main(*[int(word) for word in [*sys.argv[1:], *("20", "0")[len(sys.argv) - 1 :]]])
