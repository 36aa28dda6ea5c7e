"""Where a drawing may lie, found from nothing: every place and turn of it under the contacts is tried, coarsely.

The robots' axes say where its z points, roughly. For every turn about that and every place the contacts' heights over
the drawing are compared, and what a small tilt and height explain is taken off.
"""

import math
from typing import NamedTuple

import numpy as np

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.surface import Heights
from asterism.server.calibration.surface.contacts import Contacts
from asterism.server.calibration.surface.register_left import extent_of, thinned

MOST_POINTS = 160  # that places are judged by
STEPS = 24  # places along the drawing's longer side
TURN_STEPS_DEG = (3.0, 15.0)
STEADY = 1e-6  # of the contacts' count, so that a place with few of them over the drawing does no harm


class Tried(NamedTuple):
    """Places that were tried: the drawing's ``poses`` (T_world_drawing), best first, and what contacts were off there,
    ``costs`` m^2.
    """

    poses: list[Pose]
    costs: Floats


def starts(drawing: Heights, contacts: Contacts, most: int) -> Tried:
    """The best places that are not beside a better one, ``most`` of them at most."""
    few = thinned(contacts, MOST_POINTS)
    middle = few.points.mean(axis=0)
    upright = _upright(_up_of(drawing), few.axes.mean(axis=0))  # world from drawing, but for a turn about its up
    about = (few.points - middle) @ upright
    radius = max(float(np.sqrt((about[:, :2] ** 2).sum(axis=1).mean())), 1e-6)
    places, step = _places(drawing)
    turn_step = np.clip(math.degrees(step / radius), *TURN_STEPS_DEG)
    count = math.ceil(360.0 / turn_step)
    angles = 2.0 * math.pi * np.arange(count) / count
    found = [_costs(drawing, about @ _about_z(angle), places) for angle in angles]
    costs, planes = np.array([one[0] for one in found]), np.array([one[1] for one in found])
    kept = _apart(costs, places, 1.5 * step, most)
    return Tried(
        [_pose(middle, upright @ _about_z(angles[k]), places[j], planes[k, j]) for k, j in kept],
        np.array([costs[k, j] for k, j in kept]),
    )


def _up_of(drawing: Heights) -> Floats:
    """The mean normal (3,) of a drawing."""
    by_x, by_y = (np.diff(drawing.values, axis=k) / drawing.step[k] for k in (0, 1))
    up = np.array([-np.nanmean(by_x), -np.nanmean(by_y), 1.0])
    return np.asarray(up / np.linalg.norm(up), np.float64)


def _upright(up: Floats, onto: Floats) -> Floats:
    """The least rotation (3, 3) that brings one direction onto another."""
    onto = onto / np.linalg.norm(onto)
    cosine = float(up @ onto)
    if cosine < -1.0 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    x, y, z = np.cross(up, onto)
    hat = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turn: Floats = np.eye(3) + hat + hat @ hat / (1.0 + cosine)
    return turn


def _about_z(angle: float) -> Floats:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _places(drawing: Heights) -> tuple[Floats, float]:
    """Places (k, 2) m of the drawing at which the contacts' middle may be, and their step."""
    there = np.isfinite(drawing.values)
    low, high = extent_of(drawing)
    step = float((high - low).max()) / STEPS
    axes = [np.linspace(a, b, max(2, math.ceil((b - a) / step) + 1)) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    node = np.rint((grid - drawing.origin) / drawing.step).astype(np.int64)
    return grid[there[tuple(np.clip(node, 0, np.array(there.shape) - 1).T)]], step


def _costs(drawing: Heights, about: Floats, places: Floats) -> tuple[Floats, Floats]:
    """For contacts (m, 3) about their middle put at places (k, 2): the mean square (k,) of what height and tilt leave,
    and those (k, 3). Nothing counts more than if the drawing explained nothing, or were not there.
    """
    basis = np.column_stack([np.ones(len(about)), about[:, :2]])
    _, nothing, *_ = np.linalg.lstsq(basis, about[:, 2], rcond=None)
    most = float(nothing[0]) / len(about) + 1e-12 if len(nothing) else 1e-12
    heights = _heights(drawing, about[:, :2] + places[:, None])
    inside = np.isfinite(heights)
    above = np.where(inside, about[:, 2] - np.nan_to_num(heights), 0.0)
    weights = inside.astype(np.float64)
    for _ in range(3):  # the second and third without what is far off: robots that were lifted
        normal = np.einsum("km,mi,mj->kij", weights, basis, basis) + STEADY * len(about) * np.eye(3)
        plane = np.linalg.solve(normal, np.einsum("km,mi->ki", weights * above, basis)[..., None])[..., 0]
        left = np.where(inside, (above - plane @ basis.T) ** 2, most)
        weights = inside / (1.0 + left / most) ** 2
    return np.minimum(left, most).mean(axis=1), plane


def _heights(drawing: Heights, xy: Floats) -> Floats:
    """Straight between the nodes, (k, m) m at (k, m, 2); nan where there is none."""
    place = (xy - drawing.origin) / drawing.step
    last = np.array(drawing.values.shape) - 1
    cell = np.clip(np.floor(place).astype(np.int64), 0, np.maximum(last - 1, 0))
    a, b = np.moveaxis(place - cell, -1, 0)
    i, j = np.moveaxis(cell, -1, 0)
    v = drawing.values
    found = (1 - a) * ((1 - b) * v[i, j] + b * v[i, j + 1]) + a * ((1 - b) * v[i + 1, j] + b * v[i + 1, j + 1])
    return np.where((a >= 0) & (a <= 1) & (b >= 0) & (b <= 1), found, np.nan)


def _apart(costs: Floats, places: Floats, nearest_m: float, most: int) -> list[tuple[int, int]]:
    """Turns and places, best first, of which none is beside a better one: in the same or the next turn, and near."""
    kept: list[tuple[int, int]] = []
    count = len(costs)
    for flat in np.argsort(costs, axis=None):
        k, j = divmod(int(flat), costs.shape[1])
        beside = [
            min((k - a) % count, (a - k) % count) <= 1 and float(np.hypot(*(places[j] - places[b]))) < nearest_m
            for a, b in kept
        ]
        if not any(beside):
            kept.append((k, j))
            if len(kept) == most:
                break
    return kept


def _pose(middle: Floats, turn: Floats, place: Floats, plane: Floats) -> Pose:
    """Where the drawing lies when the contacts' middle is over a place of it, `plane` above it."""
    height, by_x, by_y = plane.tolist()
    # The drawing's own height at the place is in `plane`: contacts are plane + drawing.
    tilt = _upright(np.array([0.0, 0.0, 1.0]), np.array([-by_x, -by_y, 1.0]))
    turned = turn @ tilt
    return Pose.from_matrix(turned, middle + turn @ np.array([0.0, 0.0, height]) - turned @ np.array([*place, 0.0]))
