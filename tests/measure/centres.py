"""Every centre estimator beside the least error that physics allows: `python -m tests.measure.centres [OUT.png]`.

Discs of aspect 0.85 at random sub-pixel phases and angles, segmented and centred as the chain does it. Errors are root
mean squares of one coordinate, px; "x" is how many times the Cramer-Rao bound that is, the bound being the root of the
mean variance over some of the same phases and angles; NEES is the squared error weighted by the covariance, 2 where
that is honest, near 0 where `zernike` fell back to the moments' centre. "lost": spots that were rejected or split,
counted once per estimator. OUT.png receives a plot.

At a radius of 1 px size and point spread look alike, and the rendering's own errors pass for the difference: the bound
of tests/centres/bounds.py is up to 1.4 times too high there, and left out.
"""

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

from asterism.protocol.geometry import Floats
from asterism.protocol.rig import ESTIMATORS
from tests.centres.bounds import GAIN, READ, centre_bound
from tests.centres.rendering import Canvas
from tests.segmentation.test_segmentation import blobs_of

TRIALS, BOUNDS, PHASES = 400, 8, 100  # images a row, bounds a row, images a row without noise
SIZE, LARGEST_PX = 64, 20.0
ASPECT = 0.85
LEAST_BOUND_PX = 1.5  # the radius from which on the bound is one


@dataclass(frozen=True, slots=True)
class Look:
    """How a disc is seen: px, grey levels, grey levels per px."""

    radius: float = 2.5
    level: float = 170.0
    read: float = READ
    slope: float = 0.0
    noisy: bool = True

    def scenes(self, count: int) -> Iterator[tuple[float, float, float]]:
        """Centre x, y and angle of every trial: the same for every look."""
        draws = np.random.default_rng(7).uniform((-0.5, -0.5, 0.0), (0.5, 0.5, np.pi), (count, 3))
        for x, y, angle in draws.tolist():
            yield SIZE / 2 + x, SIZE / 2 + y, angle

    def bound(self) -> float:
        """The least error that any estimator can have, px."""
        variances = []
        for x, y, angle in self.scenes(BOUNDS):
            covariance = centre_bound(
                self.radius, ASPECT * self.radius, angle, self.level, x=x - SIZE / 2, y=y - SIZE / 2, read=self.read,
                slope=(self.slope, 0.0),
            )  # fmt: skip
            variances.append(np.trace(covariance) / 2)
        return float(np.sqrt(np.mean(variances)))


@dataclass(frozen=True, slots=True)
class Result:
    """What all estimators make of one look; arrays (estimators,)."""

    label: str
    look: Look
    bound: float
    errors: Floats
    nees: Floats
    lost: int


@dataclass(frozen=True, slots=True)
class Series:
    """One thing that varies."""

    title: str
    unit: str
    rows: tuple[tuple[str, float, Look], ...]  # label, place on the plot's axis, look


USUAL = Look()
LARGE = replace(USUAL, radius=4.0)
SERIES = (
    Series("radius", "px", tuple((f"{r:g}", r, replace(USUAL, radius=r)) for r in (1.0, 1.5, 2.0, 3.0, 4.0, 6.0))),
    Series(
        "brightness, radius 2.5 px", "grey levels",
        tuple((f"{v:g}", v, replace(USUAL, level=v)) for v in (35.0, 60.0, 100.0, 150.0, 220.0)),
    ),
    Series(
        "saturation, radius 4 px", "times the sensor's range",
        tuple((f"{v:g}", v, replace(LARGE, level=247.0 * v)) for v in (1.0, 1.5, 2.0, 4.0)),
    ),
    Series(
        "read noise, radius 2.5 px", "grey levels",
        tuple((f"{v:g}", v, replace(USUAL, read=v)) for v in (0.6, 1.2, 2.4, 4.8)),
    ),
    Series(
        "background gradient, radius 4 px", "grey levels per px",
        tuple((f"{v:g}", v, replace(LARGE, slope=v)) for v in (0.0, 0.25, 0.5)),
    ),
    Series(
        "no noise: sub-pixel phase and rounding", "radius, px",
        tuple((f"{r:g}", r, replace(USUAL, radius=r, noisy=False)) for r in (1.0, 1.5, 2.0, 3.0, 4.0, 6.0)),
    ),
)  # fmt: skip
PLOTTED = SERIES[:3]


def measure(label: str, look: Look) -> Result:
    """Errors of every estimator on the same images."""
    rng = np.random.default_rng(11)
    squares: list[list[float]] = [[] for _ in ESTIMATORS]
    weighted: list[list[float]] = [[] for _ in ESTIMATORS]
    lost = 0
    for x, y, angle in look.scenes(TRIALS if look.noisy else PHASES):
        canvas = Canvas.of(SIZE, SIZE, slope=(look.slope, 0.0))
        canvas.ellipse(x, y, look.radius, ASPECT * look.radius, angle, level=look.level)
        image = canvas.expose(rng if look.noisy else None, read=look.read, gain=GAIN)
        for k, estimator in enumerate(ESTIMATORS):
            blobs = blobs_of(image, LARGEST_PX, estimator=estimator)
            near = [row for row in blobs.kept if np.hypot(*(blobs.centres_px[row] - [x, y])) < 2.0]
            if len(near) != 1:
                lost += 1
                continue
            error = blobs.centres_px[near[0]] - [x, y]
            xx, xy, yy = blobs.covariances_px2[near[0]]
            squares[k].append(error @ error / 2)
            weighted[k].append(error @ np.linalg.solve([[xx, xy], [xy, yy]], error))
    bound = look.bound() if look.noisy and look.radius >= LEAST_BOUND_PX else np.nan
    errors = np.sqrt([np.mean(values) if values else np.nan for values in squares])
    return Result(label, look, bound, errors, np.array([np.mean(v) if v else np.nan for v in weighted]), lost)


def table_of(series: Series, results: list[Result]) -> Table:
    """The figures of one series."""
    noisy = results[0].look.noisy
    table = Table(title=f"{series.title} ({series.unit})", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("")
    if noisy:
        table.add_column("bound", justify="right")
    for estimator in ESTIMATORS:
        table.add_column(estimator, justify="right", no_wrap=True)
        if noisy:
            table.add_column("x", justify="right")
            table.add_column("NEES", justify="right")
    table.add_column("lost", justify="right")
    for result in results:
        known = bool(np.isfinite(result.bound))
        cells = [result.label, *([f"{result.bound:.4f}" if known else ""] if noisy else [])]
        for error, nees in zip(result.errors, result.nees, strict=True):
            cells.append(f"{error:.4f}")
            if noisy:
                cells += [f"{error / result.bound:.2f}" if known else "", f"{nees:.1f}"]
        table.add_row(*cells, str(result.lost))
    return table


def plot(measured: dict[str, list[Result]], out: Path) -> None:
    """Error of every estimator, and the bound, against radius, brightness and saturation."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, panels = plt.subplots(1, len(PLOTTED), figsize=(15, 5.2), sharey=True, layout="constrained")
    for panel, series in zip(panels, PLOTTED, strict=True):
        places, results = [place for _, place, _ in series.rows], measured[series.title]
        for k, (estimator, mark) in enumerate(zip(ESTIMATORS, "os^D", strict=True)):
            panel.plot(places, [result.errors[k] for result in results], marker=mark, label=estimator)
        panel.plot(places, [result.bound for result in results], "k--", linewidth=2, label="Cramer-Rao bound")
        panel.set(title=series.title, xlabel=f"{series.title.split(',')[0]}, {series.unit}", yscale="log")
        panel.set_xticks(places, [label for label, _, _ in series.rows])
        panel.grid(visible=True, which="both", alpha=0.25)
    ticks = (0.003, 0.005, 0.01, 0.02, 0.05)
    panels[0].set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    panels[0].minorticks_off()
    panels[0].set_ylabel("RMS error of a coordinate, px")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(ESTIMATORS) + 1)
    figure.savefig(out, dpi=110)


def main(out: Path | None, console: Console) -> list[Path]:
    """Measure, print, plot; the plots that were written."""
    measured: dict[str, list[Result]] = {}
    for series in SERIES:
        rows = track(series.rows, description=series.title, transient=True, disable=not console.is_terminal)
        measured[series.title] = [measure(label, look) for label, _, look in rows]
        console.print(table_of(series, measured[series.title]))
    if out is None:
        return []
    plot(measured, out)
    return [out]


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None, Console(width=120))
