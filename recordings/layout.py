"""Where things stand in the viewer: camera above space, the robots' numbers and plots beside them."""

import numpy as np
import rerun.blueprint as rrb
from rerun.encodings import Plane3D

from asterism.protocol.geometry import Pose
from asterism.protocol.rig import Rig
from asterism.recordings.entities import part
from asterism.recordings.scene import working_range
from asterism.recordings.surface_mesh import surface_mesh

GRID_M = 0.1
TOWARDS_THE_CAMERA = np.array([0.0, 0.0, -1.0])
LOOK_FROM, LOOK_NODES = 0.8, 16  # of a surface's size: from how far it is looked at
MOST_ROWS = 8  # of robots, before table and states scroll
BACKGROUND = rrb.Background(color=[38, 42, 50], kind=rrb.BackgroundKind.SolidColor)


def review_blueprint(rig: Rig) -> rrb.Blueprint:
    """As for a running server, and a tab of events."""
    return blueprint(rig, rrb.TextLogView(origin="events", name="events"))


def blueprint(rig: Rig, *more: rrb.View) -> rrb.Blueprint:
    """Camera and space above; below them the robots in numbers, their states, a tab of plots for each, and ``more``."""
    rows = min(len(rig.robots), MOST_ROWS)
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(camera_view(), space_view(rig), column_shares=[4, 5]),
            rrb.Horizontal(
                rrb.Vertical(
                    rrb.TextDocumentView(origin="robots", name="robots now"),
                    rrb.StateTimelineView(origin="states", name="states"),
                    row_shares=[75 + 23 * rows, 75 + 28 * rows],
                ),
                rrb.Tabs(
                    *(_robot_plots(robot.id) for robot in rig.robots),
                    *more,
                ),
                column_shares=[4, 7],
            ),
            row_shares=[1, 1],
        ),
        rrb.TimePanel(state="collapsed", timeline="exposed"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
    )


def camera_view() -> rrb.Spatial2DView:
    """The image with what was found in it."""
    return rrb.Spatial2DView(
        origin="world/camera/image",
        contents="world/camera/image/**",
        name="camera: plates, spots, residuals 500 times as long",
    )


def space_view(rig: Rig) -> rrb.Spatial3DView:
    """Camera and robots where they stand; the image lies at the farthest working distance."""
    floor = rrb.LineGrid3D(
        visible=rig.T_world_camera is not None, spacing=GRID_M, plane=Plane3D.XY, color=[150, 160, 175, 90]
    )
    return rrb.Spatial3DView(
        origin="world",
        contents=["+ world/**", "- world/camera/image/**", "+ world/camera/image"],
        name=f"space: grid of {GRID_M:g} m" if rig.T_world_camera is not None else "space",
        background=BACKGROUND,
        line_grid=floor,
        eye_controls=_eye(rig),
    )


def _robot_plots(robot: str) -> rrb.Grid:
    """Plots of one line each, so that there is no legend to cover anything; two lines where their title names them."""
    position, angles = f"plots/position/{part(robot)}", f"plots/angles/{part(robot)}"
    return rrb.Grid(
        *(_plot(f"{position}/{axis}", f"{axis}, m") for axis in "xyz"),
        _plot(f"plots/residual/{part(robot)}", "rms, px"),
        *(_plot(f"{angles}/{angle}", f"{angle}, deg") for angle in ("roll", "pitch", "yaw")),
        _plot("plots/latency", "latency, ms"),
        grid_columns=4,
        name=robot,
    )


def _plot(origin: str, name: str) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(origin=origin, name=name, plot_legend=rrb.PlotLegend(visible=False))


def _eye(rig: Rig) -> rrb.EyeControls3D:
    """Look from the image's lower side, a little from above and from the right, at robots and camera alike; where the
    rig has a surface, at that.
    """
    T_parent_camera = rig.T_world_camera or Pose.identity()
    distance = float(np.mean(working_range(rig)))
    target, away = np.array([0.0, 0.0, 0.8 * distance]), distance
    if (whole := surface_mesh(rig, LOOK_NODES)) is not None:
        points = T_parent_camera.inverse().map(whole.points)
        size = float(np.linalg.norm(np.ptp(points, axis=0)))
        target, away = points.mean(axis=0), min(max(LOOK_FROM * size, 0.3 * distance), distance)
    eye = target + away * np.array([0.25, 0.88, -0.65])
    return rrb.EyeControls3D(
        position=T_parent_camera.map(eye),
        look_target=T_parent_camera.map(target),
        eye_up=T_parent_camera.rotation @ TOWARDS_THE_CAMERA,
    )
