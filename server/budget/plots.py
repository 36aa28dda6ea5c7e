"""The plots of an error budget, as PNG."""

import io
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from asterism.protocol.geometry import Floats
from asterism.protocol.rig import Rig
from asterism.server.budget.budget import COMPONENTS, LEAST_TILT, SOURCES
from asterism.server.budget.truth import Bin, Compared
from asterism.server.budget.workspace import ALL_TILTS, Budget

# Okabe and Ito (2008): told apart by the colour-blind as well.
COLOURS = ("#0072B2", "#56B4E9", "#999999", "#D55E00", "#CC79A7", "#009E73", "#E69F00", "#B8A900")
MARKS = "ovs^DPX*"
UNITS = ("mm", "mm", "mm", "deg", "deg", "deg")
SCALES = np.array([1e3, 1e3, 1e3, *[180.0 / np.pi] * 3])  # from m and rad
DECADES = 4.0  # below the largest value: what is less is nothing
FLAT = 0.15  # colours span at least this share of the mean to either side
DPI = 100


@dataclass(frozen=True, slots=True)
class Plot:
    """A plot: the file's name, what it shows, and the bytes of the PNG."""

    name: str
    caption: str
    png: bytes


def plots_of(rig: Rig, budget: Budget, compared: Compared | None, bins: list[Bin]) -> list[Plot]:
    """All plots of a report."""
    near, far = budget.distances[0], budget.distances[-1]
    domain = f"RMS over tilts from {LEAST_TILT:g} to 60 degrees, their directions, and the robots"
    plots = [
        Plot(
            "distance.png",
            f"Error (one sigma) against distance from {near:.2f} to {far:.2f} m, each source alone and all together. "
            f"{domain}, and nine places in the image.",
            _png(_lines(budget.distances, budget.by_distance, "distance along the optical axis, m", True)),
        ),
        Plot(
            "shares.png",
            "Share of every source in the variance of each component, near, in the middle and far.",
            _png(_shares(budget)),
        ),
        Plot(
            "place.png",
            f"Error (one sigma) of all sources together against the place in the image, at {budget.middle:.2f} m. "
            f"{domain}.",
            _png(_places(rig, budget)),
        ),
        Plot(
            "tilt.png",
            f"Error (one sigma) against the plate's tilt to the line of sight, at {budget.middle:.2f} m. Grey: below "
            f"{LEAST_TILT:g} degrees, where rx and ry depend on the spots to second order: first order says too much.",
            _png(_lines(np.array(ALL_TILTS), budget.by_tilt, "tilt, degrees", False)),
        ),
    ]
    if compared is not None:
        plots.append(
            Plot(
                "measured.png",
                "Measured errors beside the budget at the same poses: every sighting (dots), their RMS by distance "
                "with its statistical uncertainty (points), and the predicted one sigma (line).",
                _png(_measured(compared, bins)),
            )
        )
    return plots


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI)
    return buffer.getvalue()


def _panels(width: float = 12.0, height: float = 7.2, sharex: bool = True) -> tuple[Figure, list[Axes]]:
    """A figure of six panels, one a component."""
    figure = Figure(figsize=(width, height), layout="constrained")
    panels = figure.subplots(2, 3, sharex=sharex)
    return figure, list(panels.ravel())


def _lines(places: Floats, variances: Floats, along: str, log: bool) -> Figure:
    figure, panels = _panels()
    sigmas = np.sqrt(variances) * SCALES
    together = np.sqrt(variances.sum(axis=1)) * SCALES
    for k, panel in enumerate(panels):
        if not log:
            panel.axvspan(places.min() - 2.0, LEAST_TILT, color="0.9", linewidth=0)
            panel.set_xlim(places.min() - 2.0, places.max() + 2.0)
        least = together[:, k].max() * 10.0**-DECADES
        for source, (name, colour, mark) in enumerate(zip(SOURCES, COLOURS, MARKS, strict=True)):
            shown = np.where(sigmas[:, source, k] > least, sigmas[:, source, k], np.nan)
            panel.plot(places, shown, color=colour, marker=mark, markersize=5, linewidth=1.4, label=name)
        panel.plot(places, together[:, k], "k", linewidth=2.8, label="all together")
        panel.set_yscale("log")
        if log:
            panel.set_xscale("log")
            ticks = [t for t in MaxNLocator(6).tick_values(*places[[0, -1]]) if places[0] <= t <= places[-1]]
            panel.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
            panel.xaxis.set_minor_formatter(NullFormatter())
        _finish(panel, k, f"{COMPONENTS[k]}, {UNITS[k]}", along)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=5, frameon=False)
    return figure


def _finish(panel: Axes, k: int, across: str, along: str) -> None:
    panel.set_ylabel(across)
    panel.set_title(COMPONENTS[k], loc="left", fontweight="bold")
    if k >= 3:
        panel.set_xlabel(along)
    if panel.get_yscale() == "log":
        panel.yaxis.set_major_locator(LogLocator(numticks=8))
        panel.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        panel.yaxis.set_minor_formatter(NullFormatter())
    panel.grid(visible=True, which="major", alpha=0.35)
    panel.grid(visible=True, which="minor", alpha=0.12)


def _shares(budget: Budget) -> Figure:
    figure = Figure(figsize=(12.0, 4.2), layout="constrained")
    panels = figure.subplots(1, 3, sharey=True)
    for panel, row in zip(panels, (0, len(budget.distances) // 2, -1), strict=True):
        variances = budget.by_distance[row]
        shares = 100.0 * variances / np.maximum(variances.sum(axis=0), 1e-300)
        before = np.zeros(len(COMPONENTS))
        for source, (name, colour) in enumerate(zip(SOURCES, COLOURS, strict=True)):
            panel.barh(
                range(len(COMPONENTS)),
                shares[source],
                left=before,
                color=colour,
                label=name,
                edgecolor="w",
                linewidth=0.5,
            )
            for k in range(len(COMPONENTS)):
                if shares[source, k] > 9.0:
                    panel.text(
                        before[k] + 0.5 * shares[source, k], k, f"{shares[source, k]:.0f}", ha="center", va="center"
                    )
            before += shares[source]
        together = np.sqrt(variances.sum(axis=0)) * SCALES
        panel.set_yticks(range(len(COMPONENTS)), COMPONENTS)
        for k, unit in enumerate(UNITS):
            panel.text(102, k, f"{together[k]:.3g} {unit}", va="center", fontsize=9)
        panel.set(xlim=(0, 100), xlabel="share of the variance, %")
        panel.set_title(f"{budget.distances[row]:.2f} m", loc="left", fontweight="bold")
        for side in ("top", "right"):
            panel.spines[side].set_visible(False)
    panels[0].invert_yaxis()
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    return figure


def _places(rig: Rig, budget: Budget) -> Figure:
    figure, panels = _panels(13.0, 7.6)
    together = np.sqrt(budget.by_place.sum(axis=2)) * SCALES
    for k, panel in enumerate(panels):
        # What hardly changes shall not look as if it did.
        mean = np.nanmean(together[..., k])
        limits = {
            "vmin": min(np.nanmin(together[..., k]), (1.0 - FLAT) * mean),
            "vmax": max(np.nanmax(together[..., k]), (1.0 + FLAT) * mean),
        }
        image = panel.pcolormesh(budget.across, budget.down, together[..., k], shading="nearest", **limits)
        figure.colorbar(image, ax=panel, label=f"{COMPONENTS[k]}, {UNITS[k]}", shrink=0.85)
        panel.set(xlim=(-0.5, rig.camera.width - 0.5), ylim=(rig.camera.height - 0.5, -0.5), aspect="equal")
        panel.set_title(COMPONENTS[k], loc="left", fontweight="bold")
        if k >= 3:
            panel.set_xlabel("column, px")
        if k % 3 == 0:
            panel.set_ylabel("row, px")
    return figure


def _measured(compared: Compared, bins: list[Bin]) -> Figure:
    figure, panels = _panels(12.0, 7.2)
    middles = np.array([part.distance for part in bins])
    counts = np.array([part.count for part in bins])
    for k, panel in enumerate(panels):
        measured = np.array([part.measured[k] for part in bins]) * SCALES[k]
        predicted = np.array([part.predicted[k] for part in bins]) * SCALES[k]
        errors = np.abs(compared.errors[:, k]) * SCALES[k]
        panel.plot(compared.distances, errors, ".", color="0.75", markersize=3, label="every sighting", zorder=1)
        panel.plot(middles, predicted, "k", marker="_", markersize=12, linewidth=2.2, label="predicted, one sigma")
        panel.errorbar(
            middles,
            measured,
            yerr=measured / np.sqrt(2.0 * counts),
            fmt="o",
            color=COLOURS[3],
            capsize=3,
            label="measured, RMS",
            zorder=3,
        )
        panel.set_yscale("log")
        panel.set_ylim(bottom=0.02 * min(measured.min(), predicted.min()))
        _finish(panel, k, f"|{COMPONENTS[k]} error|, {UNITS[k]}", "distance along the optical axis, m")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    return figure
