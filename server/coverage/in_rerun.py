"""A map in rerun: the surface itself, coloured by what tools did there."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.recordings.shades import shades
from asterism.recordings.surface_mesh import Mesh, mesh_of
from asterism.server.coverage.regions import Regions
from asterism.server.coverage.summary import Summary, area, when
from asterism.server.coverage.visits import Visits

QUANTITIES = {"dwell": "dwell", "passes": "passes", "speed": "mean speed", "last": "last visit"}
NOBODY = np.array([110, 114, 122], np.uint8)
GAP, MUCH = (235, 120, 40), (230, 80, 150)
_LABEL_M = 0.004  # above the surface


def write_rrd(told: Summary, out: Path) -> None:
    """Write a rerun file: `<what>/mesh`, for dwell, passes, speed and last, with the regions beside; of each robot
    `robots/<id>/<what>/mesh`. Raises ModuleNotFoundError where rerun is not installed.
    """
    import rerun as rr
    import rerun.blueprint as rrb

    from asterism.recordings.entities import part

    stream = rr.RecordingStream("asterism", recording_id=f"coverage-{told.camera}")
    names = [part(robot) for robot in told.covered.robots]
    seen_from, middle = _eye(told)
    eye = rrb.EyeControls3D(position=seen_from, look_target=middle, eye_up=[0.0, 0.0, 1.0])
    before = ["", *(f"robots/{name}/" for name in names)]
    tabs = [
        rrb.Grid(
            *(
                rrb.Spatial3DView(
                    origin=f"/{path}{what}", name=f"{words}: blue little, yellow much, grey never", eye_controls=eye
                )
                for what, words in QUANTITIES.items()
            ),
            name=title,
        )
        for path, title in zip(before, ["all robots", *told.covered.robots], strict=True)
    ]
    panels = rrb.TimePanel(state="hidden"), rrb.SelectionPanel(state="hidden"), rrb.BlueprintPanel(state="hidden")
    stream.save(out, default_blueprint=rrb.Blueprint(rrb.Tabs(*tabs), *panels))
    stream.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    mesh = mesh_of(told.covered.grid.surface, _box(told)) if told.covered.grid.box.patches else None
    for path, visits in zip(before, [told.whole, *told.covered.robots.values()], strict=True):
        for what, colours in _coloured(told, visits).items():
            if mesh is not None and len(mesh.triangles):
                texture = rr.Mesh3D(
                    vertex_positions=mesh.points,
                    vertex_normals=mesh.normals,
                    vertex_texcoords=_on_the_grid(told, mesh),
                    triangle_indices=mesh.triangles,
                    albedo_texture=colours,
                )
                stream.log(f"{path}{what}/mesh", texture, static=True)
    for kind, regions, colour in (("gaps", told.gaps, GAP), ("overworked", told.overworked, MUCH)):
        if regions.found:
            labels, places = _labels(told, kind, regions)
            points = rr.Points3D(places, labels=labels, colors=colour, radii=rr.Radius.ui_points(4.0))
            stream.log(f"dwell/{kind}", points, static=True)
    stream.flush()
    stream.disconnect()


def _box(told: Summary) -> tuple[Floats, Floats]:
    """Least and greatest x, y m of the patches."""
    grid = told.covered.grid
    return grid.pitch_m * np.array(grid.box[:2]), grid.pitch_m * np.array(grid.box[2:])


def _eye(told: Summary) -> tuple[Floats, Floats]:
    """From where the surface's middle is looked at, and that, (3,) m in the world: from its front, well above it."""
    least, greatest = _box(told)
    middle = 0.5 * (least + greatest)
    place, size = told.covered.grid.surface.T_world_surface, max(float(np.linalg.norm(greatest - least)), 0.1)
    height = np.nan_to_num(told.covered.grid.surface.ground(middle).heights[0])
    target = np.append(middle, height)
    return place.map(target + size * np.array([0.0, -0.55, 0.75])), place.map(target)


def _on_the_grid(told: Summary, mesh: Mesh) -> Floats:
    """Where the mesh's points (n, 2) are in the grid of patches, from 0 to 1 along columns and rows."""
    least, greatest = _box(told)
    xy = told.covered.grid.surface.T_world_surface.inverse().map(mesh.points)[:, :2]
    places: Floats = (xy - least) / (greatest - least)
    return places


def _coloured(told: Summary, visits: Visits) -> dict[str, NDArray[np.uint8]]:
    """Colours (rows, columns, 3) of the patches by each quantity; of each robot on the scale of all together."""
    whole = told.whole
    there = whole.visited
    limit = told.overworked.limit_s
    most = float(whole.dwell_s.max(initial=0.0))
    speeds = whole.speed[there]
    since = int(whole.last_ns[there].min()) if there.any() else 0
    scales = {
        "dwell": (visits.dwell_s, min(limit, most)),
        "passes": (visits.passes, float(whole.passes.max(initial=0))),
        "speed": (visits.speed, float(np.percentile(speeds, 99)) if len(speeds) else 0.0),
        "last": ((visits.last_ns - since) * 1e-9, float(whole.last_ns.max(initial=since) - since) * 1e-9),
    }
    colours = {}
    for what, (values, end) in scales.items():
        shares = np.nan_to_num(np.where(visits.visited, values, 0.0)) / (end or 1.0)
        colours[what] = np.where(visits.visited[..., None], shades(shares), NOBODY)
    return colours


def _labels(told: Summary, kind: str, regions: Regions) -> tuple[list[str], Floats]:
    up = told.covered.grid.surface.T_world_surface.rotation[:, 2] * _LABEL_M
    word = kind.removesuffix("s")
    labels = [f"{word} {each.number}: {area(each.area_m2)}, last {when(each.last_ns)}" for each in regions.found]
    return labels, np.array([each.place + up for each in regions.found])
