"""The surface of a rig as a plot: heights, and how well each place is known."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from asterism.protocol.geometry import Floats
from asterism.protocol.surface import Heights, Surface

NODES = 200  # along the longer side
CAPTION = (
    "The surface in its own frame: heights with contours, and one sigma along its normal. White: there is none. The "
    "budget above is of the sigma by and large."
)


def surface_grid(surface: Surface | None) -> tuple[Floats, Floats, Floats, Floats] | None:
    """Of a surface that ends somewhere: x (n,), y (m,) m, heights and sigmas (n, m) m, nan where it is not. None for a
    plane or quadric without an edge, which goes on for ever.
    """
    if surface is None or not (isinstance(surface.shape, Heights) or len(surface.edge)):
        return None
    if isinstance(surface.shape, Heights):
        low = surface.shape.origin
        high = low + surface.shape.step * (np.array(surface.shape.values.shape) - 1)
    else:
        low, high = surface.edge.min(axis=0), surface.edge.max(axis=0)
    counts = np.maximum(np.ceil(NODES * (high - low) / (high - low).max()).astype(np.int64), 2)
    x, y = (np.linspace(a, b, n) for a, b, n in zip(low, high, counts, strict=True))
    ground = surface.ground(np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2))
    shape = (len(x), len(y))
    heights, sigmas = (np.where(ground.inside, part, np.nan).reshape(shape) for part in (ground.heights, ground.sigmas))
    return (x, y, heights, sigmas) if ground.inside.any() else None


def draw_surface(figure: Figure, panels: list[Axes], grid: tuple[Floats, Floats, Floats, Floats]) -> None:
    """Heights and sigmas on two panels."""
    x, y, heights, sigmas = grid
    parts = ((heights, "cividis", "height, mm"), (sigmas, "viridis", "one sigma, mm"))
    for panel, (values, colours, name) in zip(panels, parts, strict=True):
        mm = 1e3 * values.T
        least, most = (0.0, None) if values is sigmas else (None, None)
        drawn = panel.pcolormesh(x, y, mm, cmap=colours, vmin=least, vmax=most, shading="nearest", rasterized=True)
        figure.colorbar(drawn, ax=panel, label=name, shrink=0.85)
        panel.set(aspect="equal", xlabel="x, m", ylabel="y, m")
        panel.set_title(name.partition(",")[0], loc="left", fontweight="bold")
    if np.nanmax(heights) - np.nanmin(heights) > 1e-6:
        panels[0].contour(x, y, 1e3 * heights.T, levels=8, colors="white", linewidths=0.6, linestyles="solid")
