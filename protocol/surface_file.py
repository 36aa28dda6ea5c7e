"""The key `surface` of a rig, and `stands` of its robots, read strictly.

```yaml
surface:                               # one of plane, quadric, heights, stl
  plane: {point: [0, 0, 0], normal: [0, 0, 1]}                      # the normal points out of the material
  quadric: {about: [0, 0, -1], terms: {one: -1, xx: 1, yy: 1, zz: 1}}   # 0 = their sum, which grows outwards
  heights: mould.csv                   # header x,y,z or x,y,z,sigma: the nodes of a grid, m
  stl: mould.stl                       # as a grid of heights, of what is seen from the frame's +z ...
  scale: 0.001                         # ... optional: of a file in mm
  frame: {position: [0, 0, 0], orientation: [0, 0, 0, 1]}   # optional T_world_surface; its z points out of the material
  sigma: 0.00005                       # optional: how well it is known along its normal, m, one sigma
  tilt_sigma_deg: 0.05                 # optional: and in its direction
  edge: [[-0.2, -0.2], [0.2, -0.2], [0.2, 0.2]]     # optional: x, y of its frame; beyond them there is no surface
robots:
  alpha:
    stands: {point: tool, sigma: 0.00005, tilt_sigma_deg: 0.1}      # optional `axis`, else led.axis; `radius` of the
                                                                    # tool about the point, m, for `coverage`
```
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from asterism.protocol import heights_file
from asterism.protocol.geometry import Floats, Pose, frozen_array
from asterism.protocol.heights_file import parse_heights
from asterism.protocol.rig_files import Named
from asterism.protocol.rig_hints import STANDS_WORDS, SURFACE_WORDS, refuse_millimetres
from asterism.protocol.rig_pose import read_pose
from asterism.protocol.surface import HEIGHTS, PLANE, QUADRIC, STL, TERMS, Heights, Quadric, Surface, crossing
from asterism.protocol.yaml_file import Section

KINDS = (PLANE, QUADRIC, HEIGHTS, STL)
SURFACE_KEYS = (*KINDS, "scale", "frame", "sigma", "tilt_sigma_deg", "edge")
STANDS_KEYS = ("point", "sigma", "tilt_sigma_deg", "axis", "radius")
LARGEST_SIGMA_M = 0.05
LARGEST_TILT_DEG = 45.0
LARGEST_RADIUS_M = 0.5  # of a tool


@dataclass(frozen=True, slots=True, eq=False)
class Stands:
    """How a robot stands on the surface: its named ``point`` lies on it within ``sigma_m`` along the normal, and its
    ``axis`` (3,), a unit vector of its own frame, is along the normal within ``tilt_sigma_rad`` about either axis
    across it, one sigma each; inf: its tilt is not told. ``radius_m`` is that of the tool, a disc about the point; 0:
    it is not told.
    """

    point: str
    axis: Floats
    sigma_m: float
    tilt_sigma_rad: float = math.inf
    radius_m: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "axis", frozen_array(self.axis, 3))


def read_surface(section: Section, named: Named) -> tuple[Surface, dict[str, str]]:
    """A surface from its section of a rig, and the texts of the files it names.

    Raises InputError with file, key, what was found and what is accepted.
    """
    section.only(SURFACE_KEYS, SURFACE_WORDS)
    given = [kind for kind in KINDS if kind in section]
    if len(given) != 1:
        found = " and ".join(given) or "none"
        raise section.error(None, f"has {found} of {', '.join(KINDS)}, expected one")
    if "scale" in section and given[0] != STL:
        raise section.error("scale", f"is of an `stl` only, expected none beside `{given[0]}`, whose lengths are m")
    texts: dict[str, str] = {}
    if given[0] == PLANE:
        shape = _plane(section.section(PLANE))
    elif given[0] == QUADRIC:
        shape = _quadric(section.section(QUADRIC))
    else:
        name = section.text(given[0])
        what = "an STL" if given[0] == STL else heights_file.WHAT
        texts[name], where = named(section, given[0], name, what)
        return _surface(section, parse_heights(texts[name], where)), texts
    return _surface(section, shape), texts


def _surface(section: Section, shape: Quadric | Heights) -> Surface:
    frame = Pose.identity()
    if "frame" in section:
        inner = section.section("frame")
        inner.only(("position", "orientation"))
        frame = read_pose(inner, "x, y, z of the surface's frame in the world, m")
    sigma = _sigma(section) if "sigma" in section else 0.0
    tilt = _tilt(section) if "tilt_sigma_deg" in section else 0.0
    edge = np.array(
        section.rows("edge", 2, "x, y of the surface's frame, m") if "edge" in section else np.zeros((0, 2))
    )
    if "edge" in section and len(edge) < 3:
        raise section.error("edge", f"{len(edge)} corners, expected three or more")
    surface = Surface(shape, frame, sigma, tilt, edge.reshape(-1, 2))
    _refuse_edge(section, surface)
    return surface


def _refuse_edge(section: Section, surface: Surface) -> None:
    """Refuse an edge in mm, one that crosses itself, and one within which there is no surface."""
    edge = surface.edge
    if not len(edge):
        if isinstance(surface.shape, Quadric) and not surface.ground(surface.shape.about[None, :2]).inside.any():
            near = np.concatenate([_around(half) for half in (0.2, 1.0, 5.0)])
            _refuse_unreal(section, surface, surface.shape.about[:2] + near)
        return
    refuse_millimetres(section, "edge", edge.ravel().tolist())
    if (crossed := crossing(edge)) is not None:
        raise section.error(
            "edge",
            f"its sides from corners {crossed[0] + 1} and {crossed[1] + 1} cross, expected corners in order around the "
            "surface",
        )
    low, high = edge.min(axis=0), edge.max(axis=0)
    _refuse_unreal(section, surface, 0.5 * (low + high) + _around(1.0) * (high - low) / 2.0)


def _around(half: float) -> Floats:
    places = np.linspace(-half, half, 66)[1:-1]
    return np.stack(np.meshgrid(places, places, indexing="ij"), axis=-1).reshape(-1, 2)


def _refuse_unreal(section: Section, surface: Surface, places: Floats) -> None:
    if surface.ground(places).inside.any():
        return
    shape = surface.shape
    if isinstance(shape, Heights):
        last = shape.origin + shape.step * (np.array(shape.values.shape) - 1)
        raise section.error(
            "edge",
            f"there is nothing of the grid within it, whose nodes are at x {shape.origin[0]:.4g} to {last[0]:.4g} and "
            f"y {shape.origin[1]:.4g} to {last[1]:.4g} m",
        )
    told = "expected a sum that is 0 on the surface and grows out of it, along z (are all signs the other way round?)"
    if len(surface.edge):
        raise section.error("edge", f"there is no surface within it, {told}")
    raise section.error(None, f"there is no surface within 5 m of `about`, {told}")


def _plane(section: Section) -> Quadric:
    section.only(("point", "normal"))
    point, normal = (np.array(section.numbers(key, 3, what)) for key, what in (
        ("point", "x, y, z of a point of the plane, m"), ("normal", "where the surface faces, out of the material"),
    ))  # fmt: skip
    refuse_millimetres(section, "point", point.tolist())
    length = float(np.linalg.norm(normal))
    if not normal[2] > 0.2 * length:
        raise section.error(
            "normal",
            f"{normal.tolist()}, expected one that points out of the material and along the z of the surface's frame "
            "within 78 degrees; for a wall turn `frame`",
        )
    return Quadric.plane(point, normal / length)


def _quadric(section: Section) -> Quadric:
    section.only(("about", "terms"))
    about = np.array(section.numbers("about", 3, "x, y, z that the terms are about, m")) if "about" in section else None
    terms = section.section("terms")
    terms.only(TERMS)
    values = np.array([terms.number(term) if term in terms else 0.0 for term in TERMS])
    if not np.abs(values[[3, 6, 8, 9]]).any():
        raise terms.error(None, "no z is among them, expected a sum that grows out of the material, for example z: 1")
    return Quadric(values, np.zeros(3) if about is None else about)


def _sigma(section: Section, above: float = 0.0) -> float:
    sigma = section.number("sigma", above=above) if above else section.number("sigma", least=0.0)
    if sigma > LARGEST_SIGMA_M:
        raise section.error(
            "sigma", f"{sigma:g}, expected m, at most {LARGEST_SIGMA_M:g}; is that mm? For example {sigma / 1e3:g}"
        )
    return sigma


def _tilt(section: Section) -> float:
    tilt = section.number("tilt_sigma_deg", least=0.0)
    if tilt > LARGEST_TILT_DEG:
        raise section.error("tilt_sigma_deg", f"{tilt:g}, expected degrees, at most {LARGEST_TILT_DEG:g}")
    return math.radians(tilt)


def read_stands(section: Section, points: Mapping[str, Floats], axis: Floats) -> Stands:
    """How a robot stands, from its section; ``points`` it carries by name, ``axis`` (3,) of its LEDs.

    Raises InputError with file, key, what was found and what is accepted.
    """
    section.only(STANDS_KEYS, STANDS_WORDS)
    point = section.text("point")
    if point not in points:
        has = ", ".join(points) or "none"
        raise section.error("point", f"'{point}' is none of the robot's `points` ({has}), expected one of them")
    sigma = _sigma(section)
    if sigma <= 0.0:
        raise section.error("sigma", f"{sigma:g}, expected a number above 0, m: how far the point may be off")
    if "axis" in section:
        axis = np.array(section.numbers("axis", 3, "what points along the surface's normal, in the robot's frame"))
        if float(np.linalg.norm(axis)) == 0.0:
            raise section.error("axis", "[0, 0, 0] has no direction, expected a vector of any length above 0")
    tilt = _tilt(section) if "tilt_sigma_deg" in section else math.inf
    if tilt <= 0.0:
        raise section.error("tilt_sigma_deg", "0, expected a number above 0, degrees; leave it out if it is not known")
    return Stands(point, axis / np.linalg.norm(axis), sigma, tilt, _radius(section) if "radius" in section else 0.0)


def _radius(section: Section) -> float:
    radius = section.number("radius", above=0.0)
    if radius > LARGEST_RADIUS_M:
        raise section.error("radius", f"{radius:g}, expected m, at most {LARGEST_RADIUS_M:g}; is that mm?")
    return radius
