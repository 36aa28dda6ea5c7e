"""All figures of speed and accuracy in one report, with plots: `make bench`, or `python -m tests.measure.bench OUT`.

What the tables mean is said in speed.py, centres.py and accuracy.py, each of which runs alone as well.
"""

import os
import platform
import sys
import time
from importlib.metadata import version
from pathlib import Path

from rich.console import Console

from tests.measure import accuracy, centres, speed

PACKAGES = ("numpy", "numba", "opencv-python-headless", "pupil-apriltags")


def conditions() -> str:
    """What the figures were measured on."""
    load = f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "unknown"
    packages = ", ".join(f"{name} {version(name)}" for name in PACKAGES)
    machine = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, load {load}"
    return f"{machine}; Python {platform.python_version()}, {packages}"


def main(out: Path) -> None:
    """Measure everything, print the report, and say where the plots are."""
    console, start = Console(width=120), time.monotonic()
    out.mkdir(parents=True, exist_ok=True)
    console.print(conditions())
    console.rule("Time of a frame, and what it buys")
    plots = speed.main(out, console)
    console.rule("Centres of spots: RMS error of a coordinate, px, over the Cramer-Rao bound")
    plots += centres.main(out / "centres.png", console)
    console.rule("Poses and identities")
    accuracy.main(accuracy.samples(), console)
    console.rule(f"Plots, after {time.monotonic() - start:.0f} s")
    for path in plots:
        console.print(str(path), soft_wrap=True, highlight=False)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(Path(sys.argv[1]))
