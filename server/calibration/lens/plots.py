"""Plots of a camera's calibration, as PNG: what the views cover, and what they leave."""

import io

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from asterism.server.calibration.lens.coverage import COLUMNS, LEAST_IN_CELL, ROWS, points_by_cell, tilts_deg
from asterism.server.calibration.lens.fit import CameraFit

DPI = 100


def coverage_png(fit: CameraFit) -> bytes:
    """Where the points were in the image, and how the board was tilted and how far it was."""
    camera = fit.camera
    figure = Figure(figsize=(12, 5), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.5, 1))
    counts = points_by_cell(fit.views, camera.width, camera.height)
    x = np.linspace(-0.5, camera.width - 0.5, COLUMNS + 1)
    y = np.linspace(-0.5, camera.height - 0.5, ROWS + 1)
    few = np.ma.masked_where(counts >= LEAST_IN_CELL, counts)
    left.pcolormesh(x, y, few, cmap=ListedColormap(["#f7c4bd"]), vmin=0, vmax=LEAST_IN_CELL)
    for view in fit.views:
        left.plot(*view.seen.pixels.T, ".", markersize=3, color="#0072B2", alpha=0.5)
    for row in range(ROWS):
        for column in range(COLUMNS):
            left.text(x[column] + 8, y[row] + 8, str(counts[row, column]), va="top", fontsize=8, color="#444444")
    total = sum(len(view.seen.points) for view in fit.views)
    left.set(
        xlim=(x[0], x[-1]), ylim=(y[-1], y[0]), aspect="equal", xlabel="x, px", ylabel="y, px",
        title=f"{total} points of {len(fit.views)} views; red: fewer than {LEAST_IN_CELL}",
    )  # fmt: skip
    tilts = tilts_deg(fit)
    drawn = right.scatter(tilts[:, 0], tilts[:, 1], c=fit.ts[:, 2], cmap="viridis", edgecolors="#444444")
    figure.colorbar(drawn, ax=right, label="distance, m")
    reach = max(40.0, 1.1 * float(np.abs(tilts).max()))
    right.set(
        xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal", title="tilt of the board",
        xlabel="about the image's x axis, deg", ylabel="about the image's y axis, deg",
    )  # fmt: skip
    right.grid(alpha=0.3)
    return _png(figure)


def residuals_png(fit: CameraFit) -> bytes:
    """Residuals over the image, all together, and view by view."""
    camera = fit.camera
    pixels = np.concatenate([view.seen.pixels for view in fit.views])
    off = np.concatenate(fit.residuals)
    figure = Figure(figsize=(15, 5), layout="constrained")
    left, middle, right = figure.subplots(1, 3, width_ratios=(1.5, 1, 1.2))
    longest = float(np.percentile(np.hypot(*off.T), 95))
    scale = 0.04 * camera.width / max(longest, 1e-9)
    left.quiver(*pixels.T, *(scale * off.T), angles="xy", scale_units="xy", scale=1.0, width=0.0015, color="#0072B2")
    left.set(
        xlim=(-0.5, camera.width - 0.5), ylim=(camera.height - 0.5, -0.5), aspect="equal", xlabel="x, px",
        ylabel="y, px", title=f"observed - predicted, {scale:.0f} times as long",
    )  # fmt: skip
    middle.plot(*off.T, ".", markersize=3, color="#0072B2", alpha=0.5)
    reach = 1.1 * float(np.abs(off).max())
    middle.set(
        xlim=(-reach, reach), ylim=(reach, -reach), aspect="equal", xlabel="x, px", ylabel="y, px",
        title=f"RMS {fit.total_rms_px:.3f} px",
    )  # fmt: skip
    middle.grid(alpha=0.3)
    place = np.arange(len(fit.views))
    right.bar(place, fit.rms_px, color="#0072B2", label="fitted")
    right.plot(place, fit.held_out_px, "o", color="#D55E00", label="held out")
    few = len(place) <= 30
    right.set_xticks(place[:: 1 if few else len(place) // 15])
    right.set_xticklabels(
        [view.frame for view in fit.views][:: 1 if few else len(place) // 15], rotation=90, fontsize=7
    )
    right.set(ylabel="RMS, px", title="view by view")
    figure.legend(*right.get_legend_handles_labels(), loc="outside lower right", ncols=2, frameon=False)
    return _png(figure)


def _png(figure: Figure) -> bytes:
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=DPI)
    return out.getvalue()
