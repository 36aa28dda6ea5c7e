"""The plots of an error budget, as PNG."""

import io
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from asterism.protocol.geometry import Floats
from asterism.protocol.rig import Rig
from asterism.server.budget.budget import COMPONENTS, LEAST_TILT
from asterism.server.budget.surface_plot import CAPTION, draw_surface, surface_grid
from asterism.server.budget.truth import Bin, Compared
from asterism.server.budget.workspace import ALL_TILTS, Budget

# Okabe and Ito (2008): told apart by the colour-blind as well.
COLOURS = ("#0072B2", "#56B4E9", "#999999", "#D55E00", "#CC79A7", "#009E73", "#E69F00", "#B8A900", "#000080", "#8B4513")
SURFACE = "surface.png"
MARKS = "ovs^DPX*h<"
UNITS = ("mm", "mm", "mm", "deg", "deg", "deg")
SCALES = np.array([1e3, 1e3, 1e3, *[180.0 / np.pi] * 3])  # from m and rad
DECADES = 4.0  # below the largest value: what is less is nothing
LEGEND = 1.0  # inches of height for what stands under the panels
FLAT = 0.15  # colours span at least this share of the mean to either side


class Sheet(NamedTuple):
    """What panels are laid out on: how many side by side, the sheet's width and a panel's height in inches."""

    columns: int
    width: float
    panel: float
    dpi: int


WIDE = Sheet(3, 12.0, 3.5, 100)
NARROW = Sheet(1, 4.2, 2.6, 160)  # as wide as a phone's page, letters as large


@dataclass(frozen=True, slots=True)
class Plot:
    """A plot: the file's name, what it shows, and the bytes of the PNG; ``narrow``: the same for a phone."""

    name: str
    caption: str
    png: bytes
    narrow: bytes


def plots_of(rig: Rig, budget: Budget, compared: Compared | None, bins: list[Bin]) -> list[Plot]:
    """All plots of a report."""
    near, far = budget.distances[0], budget.distances[-1]
    domain = f"RMS over tilts from {LEAST_TILT:g} to 60 degrees, their directions, and the robots"
    plots = [
        _plot(
            "distance.png",
            f"Error (one sigma) against distance from {near:.2f} to {far:.2f} m, each source alone and all together. "
            f"{domain}, and nine places in the image.",
            lambda sheet: _lines(
                sheet, budget, budget.distances, budget.by_distance, "distance along the optical axis, m"
            ),
        ),
        _plot(
            "shares.png",
            "Share of every source in the variance of each component, near, in the middle and far.",
            lambda sheet: _shares(sheet, budget),
        ),
        _plot(
            "place.png",
            f"Error (one sigma) of all sources together against the place in the image, at {budget.middle:.2f} m. "
            f"{domain}.",
            lambda sheet: _places(sheet, rig, budget),
        ),
        _plot(
            "tilt.png",
            f"Error (one sigma) against the plate's tilt to the line of sight, at {budget.middle:.2f} m. Grey: below "
            f"{LEAST_TILT:g} degrees, where rx and ry depend on the spots to second order: first order says too much.",
            lambda sheet: _lines(sheet, budget, np.array(ALL_TILTS), budget.by_tilt, "tilt, degrees"),
        ),
    ]
    if compared is not None:
        plots.append(
            _plot(
                "measured.png",
                "Measured errors beside the budget at the same poses: every sighting (dots), their RMS by distance "
                "with its statistical uncertainty (points), and the predicted one sigma (line).",
                lambda sheet: _measured(sheet, compared, bins),
            )
        )
    if (grid := surface_grid(rig.surface)) is not None:
        plots.append(_plot(SURFACE, CAPTION, lambda sheet: _surface(sheet, grid)))
    return plots


def _surface(sheet: Sheet, grid: tuple[Floats, Floats, Floats, Floats]) -> Figure:
    """Heights and sigmas, side by side or one over the other."""
    columns = min(sheet.columns, 2)
    size = (sheet.width, 2 // columns * 0.75 * sheet.width / columns)
    figure = Figure(figsize=size, layout="constrained")
    draw_surface(figure, list(np.ravel(figure.subplots(2 // columns, columns))), grid)
    return figure


def _plot(name: str, caption: str, draw: Callable[[Sheet], Figure]) -> Plot:
    return Plot(name, caption, _png(draw(WIDE), WIDE), _png(draw(NARROW), NARROW))


def _png(figure: Figure, sheet: Sheet) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=sheet.dpi)
    return buffer.getvalue()


def _panels(sheet: Sheet, count: int, panel: float | None = None) -> tuple[Figure, list[Axes]]:
    """A figure of panels one abscissa is enough for; ``panel``: another height, inches."""
    rows = count // sheet.columns
    height = rows * (panel or sheet.panel) + LEGEND
    figure = Figure(figsize=(sheet.width, height), layout="constrained")
    return figure, list(np.ravel(figure.subplots(rows, sheet.columns, sharex=True)))


def _legend(figure: Figure, panel: Axes, sheet: Sheet, wide: int) -> None:
    """Under the panels, where it covers nothing; ``wide``: its columns on a wide sheet."""
    columns = wide if sheet.columns > 1 else 2
    figure.legend(*panel.get_legend_handles_labels(), loc="outside lower center", ncols=columns, frameon=False)


def _lines(sheet: Sheet, budget: Budget, places: Floats, variances: Floats, along: str) -> Figure:
    log = variances is budget.by_distance
    figure, panels = _panels(sheet, len(COMPONENTS))
    sigmas = np.sqrt(variances) * SCALES
    together = np.sqrt(variances.sum(axis=1)) * SCALES
    for k, panel in enumerate(panels):
        if not log:
            panel.axvspan(places.min() - 2.0, LEAST_TILT, color="0.9", linewidth=0)
            panel.set_xlim(places.min() - 2.0, places.max() + 2.0)
        least = together[:, k].max() * 10.0**-DECADES
        for source, (name, colour, mark) in enumerate(zip(budget.sources, COLOURS, MARKS, strict=False)):
            shown = np.where(sigmas[:, source, k] > least, sigmas[:, source, k], np.nan)
            panel.plot(places, shown, color=colour, marker=mark, markersize=5, linewidth=1.4, label=name)
        panel.plot(places, together[:, k], "k", linewidth=2.8, label="all together")
        if log and budget.alone is not None:
            alone = np.sqrt(budget.alone[:, k]) * SCALES[k]
            panel.plot(places, alone, "k--", linewidth=1.6, label="all, without the surface")
        panel.set_yscale("log")
        if log:
            panel.set_xscale("log")
            ticks = [t for t in MaxNLocator(6).tick_values(*places[[0, -1]]) if places[0] <= t <= places[-1]]
            panel.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
            panel.xaxis.set_minor_formatter(NullFormatter())
        _finish(panel, k, f"{COMPONENTS[k]}, {UNITS[k]}")
    _name_abscissae(panels, sheet, along)
    _legend(figure, panels[0], sheet, wide=5)
    return figure


def _name_abscissae(panels: list[Axes], sheet: Sheet, along: str) -> None:
    for panel in panels[-sheet.columns :]:
        panel.set_xlabel(along)


def _finish(panel: Axes, k: int, across: str) -> None:
    panel.set_ylabel(across)
    panel.set_title(COMPONENTS[k], loc="left", fontweight="bold")
    if panel.get_yscale() == "log":
        panel.yaxis.set_major_locator(LogLocator(numticks=8))
        panel.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        panel.yaxis.set_minor_formatter(NullFormatter())
    panel.grid(visible=True, which="major", alpha=0.35)
    panel.grid(visible=True, which="minor", alpha=0.12)


def _shares(sheet: Sheet, budget: Budget) -> Figure:
    figure, panels = _panels(sheet, 3)
    for panel, row in zip(panels, (0, len(budget.distances) // 2, -1), strict=True):
        variances = budget.by_distance[row]
        shares = 100.0 * variances / np.maximum(variances.sum(axis=0), 1e-300)
        before = np.zeros(len(COMPONENTS))
        for source, (name, colour) in enumerate(zip(budget.sources, COLOURS, strict=False)):
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
        panel.set(xlim=(0, 100))
        panel.invert_yaxis()
        panel.set_title(f"{budget.distances[row]:.2f} m", loc="left", fontweight="bold")
        for side in ("top", "right"):
            panel.spines[side].set_visible(False)
    _name_abscissae(panels, sheet, "share of the variance, %")
    _legend(figure, panels[0], sheet, wide=4)
    return figure


def _places(sheet: Sheet, rig: Rig, budget: Budget) -> Figure:
    # As high as the image is in what the colour bars leave of the width.
    high = 0.7 * sheet.width / sheet.columns * rig.camera.height / rig.camera.width + 0.5
    figure, panels = _panels(sheet, len(COMPONENTS), high)
    together = np.sqrt(budget.by_place.sum(axis=2)) * SCALES
    for k, panel in enumerate(panels):
        # What hardly changes shall not look as if it did.
        mean = np.nanmean(together[..., k])
        limits = {
            "vmin": min(np.nanmin(together[..., k]), (1.0 - FLAT) * mean),
            "vmax": max(np.nanmax(together[..., k]), (1.0 + FLAT) * mean),
        }
        image = panel.pcolormesh(budget.across, budget.down, together[..., k], shading="nearest", **limits)
        bar = panel.inset_axes((1.04, 0.0, 0.05, 1.0))
        figure.colorbar(image, cax=bar, label=f"{COMPONENTS[k]}, {UNITS[k]}")
        panel.set(xlim=(-0.5, rig.camera.width - 0.5), ylim=(rig.camera.height - 0.5, -0.5), aspect="equal")
        panel.set_title(COMPONENTS[k], loc="left", fontweight="bold")
        if k % sheet.columns == 0:
            panel.set_ylabel("row, px")
    _name_abscissae(panels, sheet, "column, px")
    return figure


def _measured(sheet: Sheet, compared: Compared, bins: list[Bin]) -> Figure:
    figure, panels = _panels(sheet, len(COMPONENTS))
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
        _finish(panel, k, f"|{COMPONENTS[k]} error|, {UNITS[k]}")
    _name_abscissae(panels, sheet, "distance along the optical axis, m")
    _legend(figure, panels[0], sheet, wide=3)
    return figure
