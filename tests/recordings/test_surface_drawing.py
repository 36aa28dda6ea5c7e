"""The surface in the viewer: where it is and where it ends, and how robots stand on it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rerun as rr

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import set_report_pose
from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.protocol.rig import Rig
from asterism.protocol.surface import Heights, Quadric, Surface
from asterism.recordings.drawing import Drawing
from asterism.recordings.entities import by_itself
from asterism.recordings.layout import blueprint
from asterism.recordings.shades import shades
from asterism.recordings.surface_mesh import Mesh, box_of, mesh_of, surface_mesh
from tests.on_surface import BENT, TOOL, height, rig_on, stood
from tests.recordings.test_drawing import contents

EDGE = np.array([[-0.4, -0.3], [0.45, -0.2], [0.3, 0.3], [0.0, 0.05], [-0.35, 0.25]])  # with a notch
OFF = np.array([0.0, 0.0, 0.0012])  # m, of what light alone says
PLACE = Pose.from_matrix(exp_rotation(np.array([0.2, -0.1, 0.5])), np.array([0.02, -0.03, 0.05]))


def meshed(surface: Surface) -> Mesh:
    mesh = surface_mesh(replace(rig_on(), surface=surface))
    assert mesh is not None
    return mesh


def areas(mesh: Mesh) -> Floats:
    """(m, 3) m^2 along the triangles' normals, by the order of their corners."""
    a, b, c = (mesh.points[mesh.triangles[:, k]] for k in range(3))
    return 0.5 * np.cross(b - a, c - a)


def test_the_mesh_has_the_surface_s_heights_and_faces_out_of_the_material() -> None:
    surface = replace(BENT, edge=EDGE, T_world_surface=PLACE)
    mesh = meshed(surface)
    x, y, z = PLACE.inverse().map(mesh.points).T
    for k in range(0, len(x), 199):
        assert z[k] == pytest.approx(height(surface, x[k], y[k]), abs=1e-9)
    assert ((areas(mesh) * mesh.normals[mesh.triangles[:, 0]]).sum(axis=1) >= -1e-12).all()


def test_the_mesh_ends_where_the_surface_does() -> None:
    """Its area in the plan is the polygon's, and the sides that only one triangle has lie on the polygon."""
    mesh = meshed(replace(BENT, edge=EDGE))
    x, y = EDGE.T
    polygon = 0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)
    assert areas(mesh)[:, 2].sum() == pytest.approx(polygon, rel=1e-3)  # corners are cut off
    length = np.linalg.norm(np.diff(mesh.edge[..., :2], axis=1), axis=-1).sum()
    assert length == pytest.approx(np.linalg.norm(np.roll(EDGE, -1, axis=0) - EDGE, axis=1).sum(), rel=0.01)


def test_a_hole_of_a_grid_is_left_open() -> None:
    values = np.zeros((41, 31))
    values[18:23, 10:20] = np.nan
    mesh = meshed(Surface(Heights(np.array([-0.2, -0.15]), np.array([0.01, 0.01]), values, np.zeros((41, 31)))))
    # Of 40 x 30 squares those around the missing nodes are missing: 6 x 11.
    assert areas(mesh)[:, 2].sum() == pytest.approx((40 * 30 - 6 * 11) * 1e-4, rel=1e-3)
    middle = mesh.points[mesh.triangles].mean(axis=1)[:, :2]
    assert not ((np.abs(middle[:, 0]) < 0.029) & (np.abs(middle[:, 1] + 0.005) < 0.054)).any()


def test_a_surface_without_an_end_is_drawn_as_far_as_the_camera_sees_it() -> None:
    rig = replace(rig_on(), surface=Surface(Quadric.plane(np.zeros(3), np.array([0.0, 0.0, 1.0]))))
    assert rig.surface is not None
    assert rig.T_world_camera is not None
    mesh = mesh_of(rig.surface, box_of(rig.surface, rig))
    pixels = rig.camera.project(rig.T_world_camera.inverse().map(mesh.points))
    size = np.array([rig.camera.width, rig.camera.height])
    assert (pixels.min(axis=0) < 0).all()  # all that is in the image ...
    assert (pixels.max(axis=0) > size).all()
    assert (np.ptp(mesh.points, axis=0)[:2] < 2.5).all()  # ... of 0.9 m x 1.2 m, turned, and little more
    assert meshed(rig.surface).edge.shape == (0, 2, 3)


def test_a_surface_that_its_edge_leaves_nothing_of_is_not_drawn(tmp_path: Path) -> None:
    far = np.array([[5.0, 5.0], [5.1, 5.0], [5.0, 5.1]])
    grid = Heights(np.zeros(2), np.array([0.1, 0.1]), np.zeros((3, 3)), np.zeros((3, 3)))
    rig = replace(rig_on(), surface=Surface(grid, edge=far))
    assert surface_mesh(rig) is None
    assert not any("surface" in entity for entity in drawn(rig, [], tmp_path / "x.rrd"))
    blueprint(rig)


def drawn(
    rig: Rig, reports: list["pb.FrameReport"], out: Path
) -> dict[str, dict[str, list[tuple[int | None, object]]]]:
    stream = rr.RecordingStream("asterism-test")
    stream.save(out)
    drawing = Drawing(stream, rig)
    for report in reports:
        drawing.report(report)
    stream.flush()
    stream.disconnect()
    return contents(out)


def told(sequence: int, pose: Pose, standing: "pb.Standing", reason: str = "") -> "pb.FrameReport":
    report = pb.FrameReport(sequence=sequence, exposed_ns=10**18 + sequence)
    entry = report.robots.add(id="r00", state=pb.TRACKED)
    set_report_pose(entry.pose, pose)
    entry.surface.standing, entry.surface.reason, entry.surface.off_m = standing, reason, 0.0012
    if standing == pb.ON_SURFACE:
        set_report_pose(entry.surface.without, Pose(pose.position + OFF, pose.orientation))
    return report


def test_surface_and_standing_are_seen(tmp_path: Path) -> None:
    rig = replace(rig_on(robots=1), surface=replace(BENT, edge=EDGE, sigma_m=5e-5))
    poses = [stood(BENT, 0.01 * k, 0.02, 0.3) for k in range(10)]
    reports = [
        told(k, pose, pb.LIFTED if k in (4, 5) else pb.ON_SURFACE, "lifted by 1.2 mm" if k in (4, 5) else "")
        for k, pose in enumerate(poses)
    ]
    entities = drawn(rig, reports, tmp_path / "x.rrd")
    mesh = surface_mesh(rig)
    assert mesh is not None
    logged = entities["/world/surface"]
    np.testing.assert_allclose(logged["Mesh3D:vertex_positions"][0][1], mesh.points, atol=1e-6)  # float32
    np.testing.assert_array_equal(logged["Mesh3D:triangle_indices"][0][1], mesh.triangles)
    assert entities["/world/surface/name"]["Points3D:labels"] == [(None, ["surface, known to 0.05 mm"])]
    assert len(entities["/world/camera/image/surface"]["LineStrips2D:strips"][0][1]) > 100  # where it ends

    states = [(frame, state) for frame, (state,) in entities["/states/r00"]["StateChange:state"]]
    assert states == [(0, "TRACKED"), (4, "TRACKED, LIFTED"), (6, "TRACKED")]
    names = [label for _, (label,) in entities["/world/robots/r00/name"]["Points3D:labels"]]
    assert names == ["r00", "r00: LIFTED", "r00"]
    tables = {frame: text for frame, (text,) in entities["/robots"]["TextDocument:text"]}
    assert "| **r00** | TRACKED, LIFTED |" in tables[4]
    assert "**r00**: lifted by 1.2 mm" in tables[4]
    assert "LIFTED" not in tables[6]

    without = entities["/world/without/r00"]
    assert [frame for frame, _ in without["LineStrips3D:strips"]] == [0, 1, 2, 3, 6, 7, 8, 9]
    origin = without["LineStrips3D:strips"][0][1][0][0]
    np.testing.assert_allclose(origin, poses[0].position + OFF, atol=1e-6)
    assert [frame for frame, _ in without["Clear:is_recursive"]] == [4]

    # The tool's way on the surface, interrupted while it is lifted.
    (frame, pieces) = entities["/world/paths/r00"]["LineStrips3D:strips"][-1]
    assert frame == 9
    assert [len(piece) for piece in pieces] == [4, 4]
    np.testing.assert_allclose(pieces[1][0], poses[6].map(TOOL), atol=1e-6)


def test_a_surface_is_coloured_by_how_well_it_is_known(tmp_path: Path) -> None:
    x, _ = np.meshgrid(np.linspace(0.0, 1.0, 21), np.linspace(0.0, 1.0, 11), indexing="ij")
    grid = Heights(np.array([-0.2, -0.1]), np.array([0.02, 0.02]), np.zeros((21, 11)), 2e-5 + 1e-4 * x)
    rig = replace(rig_on(), surface=Surface(grid))
    entities = drawn(rig, [], tmp_path / "x.rrd")
    points = np.array(entities["/world/surface"]["Mesh3D:vertex_positions"][0][1])
    colours = np.array(entities["/world/surface"]["Mesh3D:vertex_colors"][0][1], np.uint32)
    rgb = np.stack([colours >> 24, colours >> 16 & 255, colours >> 8 & 255], axis=-1)
    assert np.abs(rgb.astype(int) - shades((points[:, 0] + 0.2) / 0.4)).max() <= 1
    label = entities["/world/surface/name"]["Points3D:labels"][0][1]
    assert label == ["surface, known to 0.02 mm (blue) to 0.12 mm (yellow)"]


def test_of_several_cameras_the_surface_is_drawn_once(tmp_path: Path) -> None:
    rig = replace(rig_on(), surface=replace(BENT, edge=EDGE))
    stream = rr.RecordingStream("asterism-test")
    stream.save(tmp_path / "x.rrd")
    for storey, name in enumerate(("left", "right")):
        Drawing(stream, rig, by_itself(name, storey))
    stream.flush()
    stream.disconnect()
    surfaces = {entity for entity in contents(tmp_path / "x.rrd") if entity.endswith("/surface")}
    images = {f"/world/cameras/{name}/image/surface" for name in ("left", "right")}
    assert surfaces == {"/world/surface", *images}
