"""What of a rig's surface its camera sees, and sentences on what is odd of a surface."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.protocol.grid_holes import holes_of
from asterism.protocol.rig import Rig
from asterism.protocol.surface import Heights, Surface

_PLACES = 64  # along x and y
_REACH = 2.0  # of the camera's height above a surface without an end: so far around its foot it is looked at


class Sight(NamedTuple):
    """Of the places that a surface was tried at: ``share`` that the camera sees, from outside the material (what is in
    between is not looked at); how far those are along the camera's z, ``near_m`` to ``far_m``; ``in_range``, the share
    of them within the rig's `range` (1 without one); ``ends``, whether the surface has an end (else share is of what
    is around the camera).
    """

    share: float
    near_m: float
    far_m: float
    in_range: float
    ends: bool


def sight_of(rig: Rig) -> Sight | None:
    """What the rig's camera sees of its surface; None where the rig has none."""
    if rig.surface is None or rig.T_world_camera is None:
        return None
    surface = rig.surface
    eye = surface.T_world_surface.inverse().map(rig.T_world_camera.position)
    xy, ends = _places(surface, eye)
    ground = surface.ground(xy)
    on = np.column_stack([xy, ground.heights])[ground.inside]
    if not len(on):
        return Sight(0.0, math.nan, math.nan, 0.0, ends)
    faces = ((eye - on) * ground.normals[ground.inside]).sum(axis=1) > 0.0
    in_camera = (rig.T_world_camera.inverse() @ surface.T_world_surface).map(on)
    seen = faces & _in_image(rig, in_camera)
    share, depths = float(seen.mean()), in_camera[seen, 2]
    if not seen.any():
        return Sight(0.0, math.nan, math.nan, 0.0, ends)
    near, far = rig.range_m or (0.0, math.inf)
    in_range = float(((depths >= near) & (depths <= far)).mean())
    return Sight(share, float(depths.min()), float(depths.max()), in_range, ends)


def sight_sentence(sight: Sight) -> str:
    """What the camera sees of the surface, for a person."""
    if sight.share == 0.0:
        return UNSEEN
    whole = "the surface" if sight.ends else f"the surface within {_REACH:g} times its distance"
    outside = f"; {1.0 - sight.in_range:.0%} of that is outside the rig's `range`" if sight.in_range < 0.995 else ""
    return f"the camera sees {sight.share:.0%} of {whole}, {sight.near_m:.3g} to {sight.far_m:.3g} m away{outside}"


def _places(surface: Surface, eye: Floats) -> tuple[Floats, bool]:
    """Places (n, 2) all over a surface, and whether it ends."""
    if len(surface.edge):
        low, high, ends = surface.edge.min(axis=0), surface.edge.max(axis=0), True
    elif isinstance(surface.shape, Heights):
        last = np.array(surface.shape.values.shape) - 1
        low, high, ends = surface.shape.origin, surface.shape.origin + last * surface.shape.step, True
    else:
        reach = _REACH * max(abs(float(eye[2])), 0.1)
        low, high, ends = eye[:2] - reach, eye[:2] + reach, False
    middles = (np.arange(_PLACES) + 0.5) / _PLACES
    x, y = np.meshgrid(*(low[k] + middles * (high[k] - low[k]) for k in range(2)), indexing="ij")
    return np.column_stack([x.ravel(), y.ravel()]), ends


def _in_image(rig: Rig, points: Floats) -> NDArray[np.bool_]:
    """Which points (n, 3) of the camera's frame its image shows."""
    camera = rig.camera
    size = np.array([camera.width, camera.height])
    ahead = points[:, 2] > 0.0
    safe = np.where(ahead[:, None], points, [0.0, 0.0, 1.0])
    with np.errstate(all="ignore"):
        pixels = camera.project(safe)
        # Far outside the image a lens's polynomial turns back into it.
        slant = np.hypot(*(safe[:, :2] / safe[:, 2:]).T)
    fisheye = camera.model == "equidistant"
    sensible = fisheye | (slant < 1.5 * float(np.linalg.norm(size)) / camera.focal_px)
    shown: NDArray[np.bool_] = ahead & sensible & ((pixels >= -0.5) & (pixels <= size - 0.5)).all(axis=1)
    return shown


def surface_warnings(rig: Rig) -> list[str]:
    """A sentence for everything of a rig's surface that is allowed, but hardly meant."""
    if rig.surface is None:
        return []
    said = []
    if not any(robot.stands is not None for robot in rig.robots):
        said.append("the rig has a surface, but no robot of it `stands` on it: it changes no pose")
    if isinstance(rig.surface.shape, Heights):
        said += holes_of(rig.surface.shape)
    sight = sight_of(rig)
    if sight is not None and sight.share == 0.0:
        said.append(f"{UNSEEN}: are `world` and `surface.frame` right, and does its z point out of the material?")
    elif sight is not None and sight.in_range == 0.0:
        said.append(
            f"all of the surface that the camera sees, {sight.near_m:.3g} to {sight.far_m:.3g} m away, is outside the "
            "rig's `range`: is one of them wrong?"
        )
    return said


UNSEEN = "the camera sees nothing of the surface"
