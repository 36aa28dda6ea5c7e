"""What is drawn over the camera's image: spots with their fates, the robots' plates and names, residuals."""

from collections.abc import Mapping

import numpy as np
import rerun as rr

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.geometry import Floats

RESIDUAL_SCALE = 500.0  # a residual of 0.02 px is drawn 10 px long
HALF = 0.5  # px: rerun's image begins at the corner of the top-left pixel, ours at its centre
NAME_ABOVE = 0.075  # of the image's height: a name stands that far above its plate
_FATE_COLOURS = {pb.LED: (60, 255, 90), pb.UNEXPLAINED: (255, 210, 40)}
_REJECTED = (255, 70, 70)
_CIRCLE = np.array([[np.cos(angle), np.sin(angle)] for angle in np.linspace(0, 2 * np.pi, 17)])  # (17, 2)


def spots(report: "pb.FrameReport") -> rr.LineStrips2D | rr.Clear:
    """A ring around every spot, in the colour of its fate; what it is shows where the mouse rests."""
    if not report.spots.x:
        return rr.Clear(recursive=False)
    seen = report.spots
    names = [
        f"{report.robots[robot].id} {led}" if robot >= 0 else pb.Fate.Name(fate).lower().replace("_", " ")
        for robot, led, fate in zip(seen.robot, seen.led, seen.fate, strict=True)
    ]
    rings = (_centres(report) + HALF)[:, None] + _CIRCLE * (np.array(seen.radius) + 5.0)[:, None, None]
    colours = [_FATE_COLOURS.get(fate, _REJECTED) for fate in seen.fate]
    return rr.LineStrips2D(rings, radii=rr.Radius.ui_points(0.7), colors=colours, labels=names, show_labels=False)


def plates(outlines: Mapping[str, Floats], colours: Mapping[str, tuple[int, int, int]]) -> rr.LineStrips2D | rr.Clear:
    """The edge (n, 2) px of every robot's plate where its pose puts it, in the robot's colour."""
    if not outlines:
        return rr.Clear(recursive=False)
    closed = [np.vstack([edge, edge[:1]]) + HALF for edge in outlines.values()]
    tints = [colours[robot] for robot in outlines]
    return rr.LineStrips2D(
        closed, radii=rr.Radius.ui_points(1.0), colors=tints, labels=list(outlines), show_labels=False
    )


def names(
    outlines: Mapping[str, Floats], texts: Mapping[str, str], colours: Mapping[str, tuple[int, int, int]], height: int
) -> rr.Points2D | rr.Clear:
    """The name of every robot above its plate; ``height`` is the image's, px."""
    if not outlines:
        return rr.Clear(recursive=False)
    places = [[edge[:, 0].mean(), edge[:, 1].min() - NAME_ABOVE * height] for edge in outlines.values()]
    return rr.Points2D(
        places,
        radii=rr.Radius.ui_points(0.5),
        colors=[colours[robot] for robot in outlines],
        labels=[texts[robot] for robot in outlines],
        show_labels=True,
    )


def residuals(report: "pb.FrameReport") -> rr.Arrows2D | rr.Clear:
    """Observed minus predicted of every LED, RESIDUAL_SCALE times as long."""
    found = [robot for robot in report.robots if robot.HasField("pose") and robot.spot]
    if not found:
        return rr.Clear(recursive=False)
    centres = _centres(report)
    origins = np.concatenate([centres[list(robot.spot)] for robot in found]) + HALF
    vectors = np.concatenate([np.column_stack([robot.residual_x, robot.residual_y]) for robot in found])
    return rr.Arrows2D(
        vectors=RESIDUAL_SCALE * vectors, origins=origins, colors=[255, 255, 255], radii=rr.Radius.ui_points(0.7)
    )


def _centres(report: "pb.FrameReport") -> Floats:
    return np.column_stack([report.spots.x, report.spots.y])
