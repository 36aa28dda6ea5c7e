"""The surface that robots work on, drawn once: where it is, where it ends, how well it is known."""

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.protocol.rig import Rig
from asterism.recordings.entities import Entities
from asterism.recordings.overlay import HALF
from asterism.recordings.shades import shades
from asterism.recordings.surface_mesh import Mesh, surface_mesh

SURFACE = "world/surface"  # of all cameras of a world the same
ALPHA = 150  # so that what is behind it is seen
PLAIN = (90, 104, 126)  # where it is known everywhere as well
EDGE = (225, 230, 240)
DIFFERS = 1.05  # the largest sigma of the least, before a surface is coloured by it


def place_surface(stream: rr.RecordingStream, rig: Rig, entities: Entities) -> None:
    """Log the rig's surface, if it has one, and over the camera's image where it ends."""
    if (mesh := surface_mesh(rig)) is None:
        return
    if entities.told is not None:
        _place_mesh(stream, mesh)
    if entities.camera and len(mesh.edge):
        seen = _in_the_image(rig, mesh)
        edge = rr.LineStrips2D(seen + HALF, radii=rr.Radius.ui_points(0.7), colors=[*EDGE, 160])
        stream.log(f"{entities.image}/surface", edge, static=True)


def _place_mesh(stream: rr.RecordingStream, mesh: Mesh) -> None:
    colours, words = _colours(mesh.sigmas)
    stream.log(
        SURFACE,
        rr.Mesh3D(
            vertex_positions=mesh.points,
            vertex_normals=mesh.normals,
            vertex_colors=colours,
            triangle_indices=mesh.triangles,
        ),
        static=True,
    )
    if len(mesh.edge):
        lines = rr.LineStrips3D(mesh.edge, radii=rr.Radius.ui_points(1.0), colors=EDGE)
        stream.log(f"{SURFACE}/edge", lines, static=True)
    corner = mesh.points[np.argmin(mesh.points[:, 0] + mesh.points[:, 1])]
    name = rr.Points3D(corner, radii=rr.Radius.ui_points(0.5), colors=EDGE, labels=[words], show_labels=True)
    stream.log(f"{SURFACE}/name", name, static=True)


def _colours(sigmas: Floats) -> tuple[NDArray[np.uint8], str]:
    """A colour (n, 4) for every point, and what it says: how well the height there is known."""
    least, most = float(sigmas.min()), float(sigmas.max())
    if most <= DIFFERS * least:
        known = f", known to {most * 1e3:.3g} mm" if most else ""
        return np.tile(np.array([*PLAIN, ALPHA], np.uint8), (len(sigmas), 1)), f"surface{known}"
    colours = shades((sigmas - least) / (most - least))
    words = f"surface, known to {least * 1e3:.3g} mm (blue) to {most * 1e3:.3g} mm (yellow)"
    return np.column_stack([colours, np.full(len(sigmas), ALPHA, np.uint8)]), words


def _in_the_image(rig: Rig, mesh: Mesh) -> Floats:
    """The edge (k, 2, 2) px, as far as it is before the camera and near its image."""
    assert rig.T_world_camera is not None
    at = rig.T_world_camera.inverse().map(mesh.edge)
    at = at[(at[..., 2] > 0.0).all(axis=1)]
    size = np.array([rig.camera.width, rig.camera.height])
    straight = at[..., :2] / at[..., 2:] * rig.camera.focal_px + rig.camera.matrix[:2, 2]
    near = ((straight > -0.5 * size) & (straight < 1.5 * size)).all(axis=(1, 2))
    pixels: Floats = rig.camera.project(at[near])
    return pixels
