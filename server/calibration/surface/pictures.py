"""Pictures of a surface that was calibrated, as PNG: heights, how well they are known, where robots were."""

import io
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.protocol.surface import Heights
from asterism.server.calibration.surface.residual_map import ResidualMap
from asterism.server.calibration.surface.surface_fit import SurfaceFit

DPI = 110
WIDE = 16.0  # inches
# Okabe and Ito (2008): told apart by the colour-blind as well.
COLOURS = ("#D55E00", "#56B4E9", "#CC79A7", "#E69F00", "#000000", "#F0E442")
NEVER = "#dddddd"
HEIGHT_MAP, SIGMA_MAP, OFF_MAP = "cividis", "viridis", "RdBu_r"
MOST_ROBOTS = len(COLOURS)
CELLS = 60  # of touches' residuals, along the longer side
FEW = 2000  # dots of tracks


def surface_png(fit: SurfaceFit) -> bytes:
    """Heights with tracks, their sigma, and what touches are off."""
    figure, panels = _sheet(fit.map, 3)
    _heights(figure, panels[0], fit.map, fit)
    _sigmas(figure, panels[1], fit.map, np.isfinite(fit.map.values))
    _touches(figure, panels[2], fit)
    return _png(figure)


def drawing_png(fit: SurfaceFit, differs: ResidualMap) -> bytes:
    """The same of a registered drawing, and how the mould differs from it."""
    figure, panels = _sheet(fit.map, 4)
    _heights(figure, panels[0], fit.map, fit)
    grid = Heights(differs.origin, differs.step, differs.values, differs.totals)
    _sigmas(figure, panels[1], grid, differs.visited)
    _differs(figure, panels[2], differs)
    _touches(figure, panels[3], fit)
    return _png(figure)


def _sheet(grid: Heights, count: int) -> tuple[Figure, list[Axes]]:
    """Three panels in a row, or four in pairs."""
    x, y = grid.step * (np.array(grid.values.shape) - 1)
    columns = 2 if count == 4 else count
    rows = -(-count // columns)
    width = WIDE / columns
    figure = Figure(figsize=(WIDE, rows * (width * 0.78 * min(max(y / x, 0.35), 1.6) + 1.0)), layout="constrained")
    panels = list(np.ravel(figure.subplots(rows, columns, squeeze=False)))
    return figure, panels


def _heights(figure: Figure, panel: Axes, grid: Heights, fit: SurfaceFit) -> None:
    x, y = _axes(grid)
    mm = 1e3 * grid.values.T
    drawn = panel.pcolormesh(x, y, mm, cmap=HEIGHT_MAP, shading="nearest", rasterized=True)
    figure.colorbar(drawn, ax=panel, shrink=0.85, label="height, mm")
    if np.nanmax(mm) - np.nanmin(mm) > 1e-3:
        lines = panel.contour(x, y, mm, levels=8, colors="white", linewidths=0.6, linestyles="solid")
        panel.clabel(lines, fontsize=7, fmt="%g")
    used = np.flatnonzero(fit.used)
    xy = fit.surface.T_world_surface.inverse().map(fit.contacts.points)[:, :2]
    for robot, name in enumerate(fit.contacts.ids):
        mine = used[fit.contacts.robots[used] == robot]
        mine = mine[:: max(len(mine) * len(fit.contacts.ids) // FEW, 1)]
        colour = COLOURS[robot % MOST_ROBOTS]
        panel.plot(*xy[mine].T, ".", markersize=2, color=colour, label=name if robot < MOST_ROBOTS else None)
    columns = min(len(fit.contacts.ids), MOST_ROBOTS)
    figure.legend(loc="outside lower left", ncols=columns, frameon=False, fontsize=9, markerscale=5)
    _finish(panel, grid, "heights, and where robots stood")


def _sigmas(figure: Figure, panel: Axes, grid: Heights, visited: NDArray[np.bool_]) -> None:
    x, y = _axes(grid)
    told = 1e3 * np.where(np.isfinite(grid.values), grid.sigmas, np.nan)
    here = told[visited & np.isfinite(told)]
    low, high = (0.0, 1.0) if not len(here) else (0.0, float(np.percentile(here, 99.0)) * 1.05 + 1e-9)
    drawn = panel.pcolormesh(x, y, told.T, cmap=SIGMA_MAP, vmin=low, vmax=high, shading="nearest", rasterized=True)
    figure.colorbar(drawn, ax=panel, shrink=0.85, label="one sigma along the normal, mm", extend="max")
    _never(panel, grid, visited)
    hatched = "; hatched: never visited" if (np.isfinite(grid.values) & ~visited).any() else ""
    _finish(panel, grid, f"how well it is known{hatched}")


def _differs(figure: Figure, panel: Axes, differs: ResidualMap) -> None:
    grid = Heights(differs.origin, differs.step, differs.values, differs.sigmas)
    x, y = _axes(grid)
    seen = np.where(differs.visited, 1e3 * differs.values, np.nan)
    reach = max(float(np.nanmax(np.abs(seen))) if differs.visited.any() else 0.0, 1e-3)
    drawn = panel.pcolormesh(x, y, seen.T, cmap=OFF_MAP, vmin=-reach, vmax=reach, shading="nearest", rasterized=True)
    figure.colorbar(drawn, ax=panel, shrink=0.85, label="mould above its drawing, mm")
    if differs.real.any():
        panel.contour(x, y, differs.real.T.astype(np.float64), levels=[0.5], colors="black", linewidths=1.2)
    _never(panel, grid, differs.visited)
    _finish(panel, grid, f"mould and drawing; framed: differ by more than chance ({differs.chance:.1f} sigmas)")


def _touches(figure: Figure, panel: Axes, fit: SurfaceFit) -> None:
    """What touches are off the surface, on average in cells."""
    xy = fit.surface.T_world_surface.inverse().map(fit.contacts.points)[fit.used, :2]
    low, high = xy.min(axis=0), xy.max(axis=0)
    side = max(float((high - low).max()) / CELLS, 1e-6)
    cells = np.floor((xy - low) / side).astype(np.int64)
    shape = cells.max(axis=0) + 1
    cell, size = cells @ [shape[1], 1], int(shape.prod())
    count = np.bincount(cell, minlength=size)
    total = np.bincount(cell, 1e3 * fit.distances[fit.used], size)
    mean = np.where(count > 0, total / np.maximum(count, 1), np.nan).reshape(shape)
    edges = [start + side * np.arange(n + 1) for start, n in zip(low, shape, strict=True)]
    reach = max(float(np.nanpercentile(np.abs(mean), 98.0)), 1e-3)
    drawn = panel.pcolormesh(edges[0], edges[1], mean.T, cmap=OFF_MAP, vmin=-reach, vmax=reach, rasterized=True)
    figure.colorbar(drawn, ax=panel, shrink=0.85, label="touches above the surface, mm", extend="both")
    _finish(panel, fit.map, f"touches, mean in {1e3 * side:.2g} mm; each: {1e3 * fit.rms_m:.3f} mm RMS")


def _never(panel: Axes, grid: Heights, visited: NDArray[np.bool_]) -> None:
    """Hatch where there is a surface and nobody was."""
    never = np.isfinite(grid.values) & ~visited
    if never.any():
        x, y = _axes(grid)
        grey: Any = ListedColormap([NEVER])
        panel.pcolormesh(x, y, np.where(never, 1.0, np.nan).T, cmap=grey, shading="nearest", alpha=0.55)
        panel.contourf(x, y, never.T.astype(np.float64), levels=[0.5, 1.5], colors="none", hatches=["////"])


def _axes(grid: Heights) -> tuple[Floats, Floats]:
    x, y = (grid.origin[k] + grid.step[k] * np.arange(n) for k, n in enumerate(grid.values.shape))
    return x, y


def _finish(panel: Axes, grid: Heights, title: str) -> None:
    x, y = _axes(grid)
    pad = 0.02 * max(x[-1] - x[0], y[-1] - y[0])
    panel.set(
        xlim=(x[0] - pad, x[-1] + pad), ylim=(y[0] - pad, y[-1] + pad), aspect="equal", xlabel="x, m", ylabel="y, m"
    )
    panel.set_title(title, loc="left", fontsize=10)


def _png(figure: Figure) -> bytes:
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=DPI)
    return out.getvalue()
