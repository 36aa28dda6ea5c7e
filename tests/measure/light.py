"""Centres under any lens, at any brightness, against what physics allows: `python -m tests.measure.light [OUT.svg]`.

Frames of six ellipses of aspect 0.85, at random phases and angles, rendered exactly (tests/centres/lenses.py), then
segmented and centred as the chain does it. "peak": grey levels of the spot's middle above the background, clipped at
255. "x" is the root mean square error of a coordinate over the Cramer-Rao bound of the true lens's model; NEES is the
squared error weighted by the covariance, over the 2 that are expected: less than 1 is modest, more is boastful. The
last table is of light that is not symmetric: there the covariance is to grow with the error. OUT.svg receives a plot
of NEES against brightness.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

from tests.centres.lenses import SYMMETRIC, Lens, coma, gauss
from tests.centres.lit_frames import Disturb, bound, centre_spots, light_beside, step_beside
from tests.measure.line_plot import Axis, draw_lines

LEVELS = (30.0, 60.0, 120.0, 200.0, 255.0, 350.0, 500.0)
RADII = (1.5, 2.5, 4.0)  # px, of the long semi-axis
FRAMES = 24  # of six spots: one sigma of x is 4 %, of NEES 8 %
PLOTTED = ("gauss 0.7", "airy 1.683", "airy and gauss", "halo", "defocus 4")
USUAL = gauss(0.8)
ASYMMETRIC: dict[str, tuple[Lens, Disturb | None]] = {
    "coma, 10 % at 1.5 px": (coma(0.1, 1.5), None),
    "coma, 20 % at 1.5 px": (coma(0.2, 1.5), None),
    "coma, 30 % at 2 px": (coma(0.3, 2.0), None),
    "light of 5, 5 px off": (USUAL, light_beside(5.0, 5.0)),
    "light of 15, 5 px off": (USUAL, light_beside(15.0, 5.0)),
    "light of 40, 5 px off": (USUAL, light_beside(40.0, 5.0)),
    "light of 15, 3 px off": (USUAL, light_beside(15.0, 3.0)),
    "step of 10, 3.5 px off": (USUAL, step_beside(10.0, 3.5)),
    "step of 30, 3.5 px off": (USUAL, step_beside(30.0, 3.5)),
}


@dataclass(frozen=True, slots=True)
class Result:
    """What one kind of spots gave: the bound, px; error over it; NEES over 2; spots that were not found."""

    bound: float
    ratio: float
    nees: float
    lost: int

    def cells(self) -> list[str]:
        """The figures as the table shows them."""
        return [f"{self.ratio:.2f}", f"{self.nees:.2f}"]


def measure(lens: Lens, radius: float, level: float, disturb: Disturb | None = None) -> Result:
    """Centre spots and compare."""
    centred, least = centre_spots(lens, radius, level, FRAMES, disturb), bound(lens, radius, level)
    return Result(least, centred.rms / least, float(np.mean(centred.nees)) / 2.0, centred.lost)


def table_of(title: str, rows: dict[str, list[Result]], columns: list[str]) -> Table:
    """A row for every lens, x and NEES for every brightness or radius."""
    table = Table(title=title, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("")
    for column in columns:
        table.add_column(f"{column} x", justify="right")
        table.add_column("NEES", justify="right")
    table.add_column("lost", justify="right")
    for name, results in rows.items():
        cells = [cell for result in results for cell in result.cells()]
        table.add_row(name, *cells, str(sum(result.lost for result in results)))
    return table


def plot(symmetric: dict[float, dict[str, list[Result]]], out: Path) -> None:
    """NEES against brightness, of all radii together, a line for every lens."""
    lines = {}
    for name in PLOTTED:
        nees = np.mean([[result.nees for result in rows[name]] for rows in symmetric.values()], axis=0)
        lines[name] = (LEVELS, nees.tolist())
    across = Axis("peak, grey levels above the background (clipped at 255)", LEVELS, (28.0, 520.0), log=True)
    up = Axis("squared error weighted by covariance,\nover what is expected", (0, 0.4, 0.8, 1.2, 1.6), (0.0, 1.6))
    draw_lines(lines, across, up, out, meant=(0.8, 1.2))


def main(out: Path | None, console: Console) -> list[Path]:
    """Measure, print, plot; the plots that were written."""
    symmetric: dict[float, dict[str, list[Result]]] = {}
    for radius in RADII:
        names = track(SYMMETRIC, description=f"radius {radius:g}", transient=True, disable=not console.is_terminal)
        symmetric[radius] = {name: [measure(SYMMETRIC[name], radius, level) for level in LEVELS] for name in names}
        console.print(table_of(f"radius {radius:g} px, peak", symmetric[radius], [f"{level:g}" for level in LEVELS]))
    rows = {
        f"{name}, peak {level:g}": [measure(lens, radius, level, disturb) for radius in RADII]
        for name, (lens, disturb) in ASYMMETRIC.items()
        for level in (60.0, 200.0)
    }
    console.print(table_of("not symmetric, radius px", rows, [f"{radius:g}" for radius in RADII]))
    if out is None:
        return []
    plot(symmetric, out)
    return [out]


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None, Console(width=140))
