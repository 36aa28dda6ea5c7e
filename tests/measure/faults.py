"""A server and its clients through faults, as processes of their own: `python -m tests.measure.faults 20 [NAME ...]`

Each fault of tests/measure/fault_kinds.py is done so many times (default 5; at most 5 where a round takes long), one
after another, to one server of the simulated camera, which records, with a client of another process listening all the
while. Told for each: how long after the fault's end poses are there again (median and worst; where they should never
have ceased, the longest time without one, if that was more than 0.5 s), poses that are wrong (more than 5 mm from the
simulation's truth), poses handed out older than they may be, tracebacks of any program, recordings that cannot be read,
and what the end of a recording lacks of what the client was told.
"""

import argparse
import os
import statistics
import time

from rich.console import Console
from rich.table import Table

from tests.measure.fault_judge import Judged, judge
from tests.measure.fault_kinds import FAULTS, Kind, problem
from tests.measure.fault_place import served

LONG = 5  # rounds, of a fault that takes long
CALM_S = 0.5  # after poses are there again
HEADINGS = (
    "rounds",
    "back, median s",
    "worst s",
    "poses",
    "wrong",
    "old",
    "tracebacks",
    "recordings",
    "unreadable",
    "lost s",
)


def rounds_of(kind: Kind, rounds: int) -> tuple[list[float], Judged]:
    """How soon poses were back each time, and what it all showed."""
    backs = []
    with served(kind.setting) as place:
        for _ in range(rounds):
            backs.append(kind.do(place))
            place.client.until_warm()
            time.sleep(CALM_S)
        return backs, judge(place)


def main() -> None:
    """Do it, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rounds", type=int, nargs="?", default=LONG)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(FAULTS)}")
    options = parser.parse_args()
    table = Table(box=None)
    table.add_column("fault")
    for heading in HEADINGS:
        table.add_column(heading, justify="right")
    began = time.monotonic()
    for name in options.names or FAULTS:
        kind = FAULTS[name]
        rounds = options.rounds if kind.short else min(options.rounds, LONG)
        try:
            if why := problem(kind):
                raise AssertionError(why)
            backs, judged = rounds_of(kind, rounds)
        except AssertionError as error:
            table.add_row(name, "", str(error))
            print(f"{name}: {error}", flush=True)
            continue
        counts = [str(count) for count in judged[:-1]]
        times = [f"{s:.2f}" for s in (statistics.median(backs), max(backs), judged.lost_s)]
        table.add_row(name, str(rounds), *times[:2], *counts, times[2])
        print(name, [f"{back:.2f}" for back in backs], judged, flush=True)
    table.title = f"{time.monotonic() - began:.0f} s, load {os.getloadavg()[0]:.1f}"
    Console(width=140).print(table)


if __name__ == "__main__":
    os.environ["PYTHONUNBUFFERED"] = "1"
    # As for most people: Python keeps what it made of the source.
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    main()
