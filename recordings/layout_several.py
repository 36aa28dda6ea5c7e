"""Where things stand in the viewer when several cameras are looked at: their images above, space and numbers below."""

from collections.abc import Sequence

import numpy as np
import rerun.blueprint as rrb
from rerun.encodings import Plane3D

from asterism.protocol.geometry import Floats
from asterism.protocol.rig import Rig
from asterism.recordings.entities import Entities, part
from asterism.recordings.layout import BACKGROUND, GRID_M, MOST_ROWS
from asterism.recordings.scene import working_range

MOST_IN_A_ROW = 4  # images
OVERLAYS = ("spots", "plates", "names", "residuals", "surface")  # which belong to the images
DIRECTIONS = -np.pi / 2 + np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)  # in which one may stand, in the plan
RAISED = 0.4  # of one's distance, above what one looks at
BACK = 1.75  # times the farthest camera's distance, so that all are in sight
LOOK_UP = 0.45  # of the way from what the cameras look at to themselves


def several_blueprint(cameras: Sequence[tuple[Rig, Entities]]) -> rrb.Blueprint:
    """Of cameras with their rigs that were in force last; one without a place of its own is what all of them see."""
    telling = [(rig, entities) for rig, entities in cameras if entities.told is not None]
    robots = list(dict.fromkeys(robot.id for rig, _ in telling for robot in rig.robots))
    rows = min(len(robots), MOST_ROWS)
    seeing = [(rig, entities) for rig, entities in cameras if entities.camera]
    images = [_image_view(rig, entities) for rig, entities in seeing]
    below = rrb.Horizontal(
        _space_view([rig for rig, _ in seeing] or [rig for rig, _ in cameras], bool(seeing)),
        rrb.Vertical(
            _tabs(
                [
                    rrb.TextDocumentView(origin=f"{each.told}robots", name=_named("robots now", each))
                    for _, each in telling
                ]
            ),
            _tabs(
                [rrb.StateTimelineView(origin=f"{each.told}states", name=_named("states", each)) for _, each in telling]
            ),
            rrb.Tabs(
                *(_robot_plots(robot, [entities for _, entities in telling]) for robot in robots),
                rrb.TextLogView(origin="events", name="events"),
            ),
            row_shares=[84 + 25 * rows, 84 + 34 * rows, 230],
        ),
        column_shares=[1, 1],
    )
    return rrb.Blueprint(
        rrb.Vertical(_rows_of(images), below, row_shares=[3, 5]) if images else below,
        rrb.TimePanel(state="collapsed", timeline="exposed"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
    )


def _named(what: str, entities: Entities) -> str:
    return f"{what}, {entities.by}" if entities.by else what


def _tabs(views: Sequence[rrb.View]) -> rrb.View | rrb.Container:
    return views[0] if len(views) == 1 else rrb.Tabs(*views)


def _rows_of(views: Sequence[rrb.View]) -> rrb.Container:
    if len(views) <= MOST_IN_A_ROW:
        return rrb.Horizontal(*views)
    return rrb.Grid(*views, grid_columns=MOST_IN_A_ROW)


def _image_view(rig: Rig, entities: Entities) -> rrb.Spatial2DView:
    return rrb.Spatial2DView(origin=entities.image, contents=f"{entities.image}/**", name=rig.camera.name)


def _space_view(rigs: Sequence[Rig], cameras: bool) -> rrb.Spatial3DView:
    """Cameras and robots where they stand; the overlays belong to the images."""
    overlays = [f"- world/cameras/{part(rig.camera.name)}/image/{what}" for rig in rigs for what in OVERLAYS]
    return rrb.Spatial3DView(
        origin="world",
        contents=["+ world/**", *(overlays if cameras else [])],
        name=f"space: grid of {GRID_M:g} m",
        background=BACKGROUND,
        line_grid=rrb.LineGrid3D(visible=True, spacing=GRID_M, plane=Plane3D.XY, color=[150, 160, 175, 90]),
        eye_controls=_eye(rigs, cameras),
    )


def _eye(rigs: Sequence[Rig], cameras: bool) -> rrb.EyeControls3D:
    """From the side and above, far enough away that every camera is in sight."""
    if not cameras:
        return rrb.EyeControls3D(position=[0.7, -1.7, 0.8], look_target=[0.0, 0.0, 0.0], eye_up=[0.0, 0.0, 1.0])
    placed = [
        (rig.T_world_camera, float(np.mean(working_range(rig)))) for rig in rigs if rig.T_world_camera is not None
    ]
    eyes = np.array([place.position for place, _ in placed])
    target: Floats = np.mean([place.map(np.array([0.0, 0.0, away])) for place, away in placed], axis=0)
    target = (1.0 - LOOK_UP) * target + LOOK_UP * eyes.mean(axis=0)
    away = BACK * float(np.linalg.norm(eyes - target, axis=1).max())
    # Between the cameras, where none of them is in the way.
    bearings = np.arctan2(eyes[:, 1] - target[1], eyes[:, 0] - target[0])
    free = np.abs(np.angle(np.exp(1j * (DIRECTIONS[:, None] - bearings)))).min(axis=1).round(6)
    angle = DIRECTIONS[int(np.argmax(free))]
    seen_from = np.array([np.cos(angle), np.sin(angle), RAISED])
    return rrb.EyeControls3D(position=target + away * seen_from, look_target=target, eye_up=[0.0, 0.0, 1.0])


def _robot_plots(robot: str, telling: Sequence[Entities]) -> rrb.Grid:
    """A line for each camera that tells of the robot, or one of all of them together."""

    def plot(path: str, name: str, legend: bool = False) -> rrb.TimeSeriesView:
        contents = [f"+ {each.told}plots/{path}" for each in telling]
        return rrb.TimeSeriesView(origin="/", contents=contents, name=name, plot_legend=rrb.PlotLegend(visible=legend))

    own = part(robot)
    return rrb.Grid(
        *(plot(f"position/{own}/{axis}", f"{axis}, m", axis == "x" and len(telling) > 1) for axis in "xyz"),
        *(plot(f"angles/{own}/{angle}", f"{angle}, deg") for angle in ("roll", "pitch", "yaw")),
        grid_columns=3,
        name=robot,
    )
