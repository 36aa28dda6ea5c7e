"""rig.yaml: one camera and its robots, read strictly into values that never change."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath

import numpy as np

from asterism.protocol.camera import Camera, load_camera, parse_camera
from asterism.protocol.capture import Capture, read_capture
from asterism.protocol.constellation import LEDS, Confusion, confusions, extent, plane_of
from asterism.protocol.geometry import Floats, Pose, frozen_array
from asterism.protocol.keys import FUSED, key_problem
from asterism.protocol.led_offset import LedOffset, parse_offset
from asterism.protocol.led_positions import read_leds
from asterism.protocol.rig_files import Named, beside, kept, on_disk
from asterism.protocol.rig_hints import (
    FARTHEST_POINT,
    LED_WORDS,
    NORMAL_WORDS,
    RIG_WORDS,
    ROBOT_WORDS,
    WORLD_WORDS,
    in_metres,
    refuse_millimetres,
)
from asterism.protocol.rig_pose import read_pose
from asterism.protocol.sensor_part import captured
from asterism.protocol.surface import Surface
from asterism.protocol.surface_file import Stands, read_stands, read_surface
from asterism.protocol.text_file import read_text
from asterism.protocol.yaml_file import Section, describe, parse_yaml, read_yaml
from asterism.protocol.z_correction import ZCorrection, read_correction

RIG_KEYS = ("camera", "range", "masks", "centre", "capture", "world", "surface", "z_correction", "robots")
ESTIMATORS = ("edge-model", "grey-square", "clip", "zernike")  # the first is the default
SEPARATION = 0.02  # of the extent: constellations nearer than this cannot be told apart


@dataclass(frozen=True, slots=True, eq=False)
class NormalPrior:
    """Where the LEDs' axis points: within ``within_rad`` of ``world`` (3,), a unit vector in the world frame."""

    world: Floats
    within_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class Robot:
    """A robot and its constellation. Lengths in m, in the robot's frame unless another is named."""

    id: str
    leds: Floats  # (6, 3)
    axis: Floats = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))  # (3,) unit: where the LEDs shine
    led_radius: float | None = None
    points: dict[str, Floats] = field(default_factory=dict)  # name -> (3,)
    normal: NormalPrior | None = None
    led_offset: LedOffset | None = None
    T_world_fixed: Pose | None = None  # T_world_robot of a constellation that does not move: a reference
    stands: Stands | None = None  # on the rig's surface
    T_robot_plane: Pose = field(init=False)
    leds_plane: Floats = field(init=False)  # (6, 3); third column: distance from the common plane

    def __post_init__(self) -> None:
        object.__setattr__(self, "leds", frozen_array(self.leds, LEDS, 3))
        object.__setattr__(self, "axis", frozen_array(self.axis, 3))
        T_robot_plane, leds_plane = plane_of(self.leds, self.axis)
        object.__setattr__(self, "T_robot_plane", T_robot_plane)
        object.__setattr__(self, "leds_plane", frozen_array(leds_plane, LEDS, 3))

    @property
    def extent(self) -> float:
        """The largest distance between two LEDs, m."""
        return extent(self.leds)


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """One camera and its robots, with the texts of the files they came from."""

    camera: Camera  # as its images show it: where `capture` bins, or is a region, a part of what `camera_text` tells
    robots: tuple[Robot, ...]
    range_m: tuple[float, float] | None = None
    masks: tuple[tuple[int, int, int, int], ...] = ()  # x0, y0, x1, y1 px, both ends included
    centre: str = ESTIMATORS[0]
    capture: Capture = field(default_factory=Capture)
    T_world_camera: Pose | None = None
    follows_world: bool = False  # T_world_camera is taken anew from the constellations that do not move
    z_correction: ZCorrection | None = None
    surface: Surface | None = None  # that robots work on, in the world
    rig_text: str = ""
    camera_text: str = ""
    offset_texts: Mapping[str, str] = field(default_factory=dict)  # by the path from the rig that led.offset gives
    robots_name: str = ""  # of the file that its `robots` names; empty: they stand in the rig itself
    files: Mapping[str, str] = field(default_factory=dict)  # the texts of all others that it rests on (`rig_files`)

    @property
    def parent_frame(self) -> str:
        """The frame that poses are given in: `world`, or the camera's name where the rig places no camera."""
        return self.camera.name if self.T_world_camera is None else "world"

    def robot(self, robot_id: str) -> Robot:
        """The robot of that id. Raises KeyError."""
        for robot in self.robots:
            if robot.id == robot_id:
                return robot
        raise KeyError(robot_id)


def load_rig(path: str | Path) -> Rig:
    """Read a rig.yaml and the files it names: camera, robots, LED offsets; and those beside them that say how wrong
    they may be.

    Raises InputError with file, key, what was found and what is accepted.
    """
    path = Path(path)
    section = read_yaml(path)
    section.only(RIG_KEYS, RIG_WORDS)
    name = section.text("camera")
    camera_path = path.parent / name
    if not camera_path.exists():
        raise section.error("camera", f"there is no file {camera_path}, expected a camera_info calibration file")
    camera = load_camera(camera_path)
    if camera.name == FUSED:  # not where texts are parsed: a recording of what was joined has a rig of that name
        raise section.error(
            "camera",
            f"{camera_path} has camera_name '{FUSED}', which names what asterism fuse publishes; give it another value",
        )
    texts = read_text(path, "a rig"), read_text(camera_path, "a camera_info calibration file")
    rig = _rig(section, camera, *texts, on_disk(path.parent))
    return replace(rig, files={**rig.files, **beside(path, name)})


def parse_rig(
    rig_text: str,
    camera_text: str,
    name: str,
    offset_texts: Mapping[str, str] | None = None,
    files: Mapping[str, str] | None = None,
) -> Rig:
    """A rig from the texts of its files, as a recording and a server's reply keep them. Raises InputError as `load_rig`
    does.
    """
    section = parse_yaml(rig_text, f"{name}: rig.yaml")
    camera = parse_camera(camera_text, f"{name}: camera.yaml")
    named = kept({**(files or {}), **(offset_texts or {})}, name)
    return replace(_rig(section, camera, rig_text, camera_text, named), files=dict(files or {}))


def _rig(section: Section, camera: Camera, rig_text: str, camera_text: str, named: Named) -> Rig:
    section.only(RIG_KEYS, RIG_WORDS)
    section.text("camera")
    T_world_camera, follows = _world(section.section("world")) if "world" in section else (None, False)
    if T_world_camera is not None and camera.name == "world":
        raise section.error("world", "the camera's name is 'world' too; give camera_name another value")
    inner, robots_name, files = _robots_of(section, named)
    if not inner.values:
        raise inner.error(None, "is empty, expected at least one robot")
    capture = read_capture(section.section("capture")) if "capture" in section else Capture()
    try:
        camera = captured(camera, capture)
    except ValueError as problem:
        raise section.error("capture", str(problem)) from None
    offset_texts: dict[str, str] = {}

    def offset_of(led: Section, name: str) -> LedOffset:
        path = str(PurePosixPath(robots_name).parent / name) if robots_name else name
        offset_texts[path], where = named(led, "offset", path, "one that asterism calibrate offset wrote")
        return parse_offset(offset_texts[path], where)

    robots = tuple(_robot(name, part, T_world_camera, offset_of) for name, part in inner.sections().items())
    if follows and not any(robot.T_world_fixed is not None for robot in robots):
        raise section.section("world").error(
            "follow",
            "true, but no robot of the rig is `fixed`, expected one at least: where the camera is, is told by "
            "constellations that do not move",
        )
    _refuse_lookalikes(inner, robots)
    surface = None
    if "surface" in section:
        if T_world_camera is None:
            raise section.error("surface", "needs the rig's `world`, the pose of the camera in the world")
        surface, texts = read_surface(section.section("surface"), named)
        files = {**files, **texts}
    _refuse_standing(inner, robots, surface)
    return Rig(
        camera=camera,
        robots=robots,
        range_m=_range(section) if "range" in section else None,
        masks=_masks(section, camera) if "masks" in section else (),
        centre=section.text("centre", ESTIMATORS) if "centre" in section else ESTIMATORS[0],
        capture=capture,
        T_world_camera=T_world_camera,
        follows_world=follows,
        z_correction=read_correction(section.section("z_correction")) if "z_correction" in section else None,
        surface=surface,
        rig_text=rig_text,
        camera_text=camera_text,
        offset_texts=offset_texts,
        robots_name=robots_name,
        files=files,
    )


def _refuse_standing(inner: Section, robots: tuple[Robot, ...], surface: Surface | None) -> None:
    for robot in robots:
        if robot.stands is None:
            continue
        if surface is None:
            raise inner.error(
                f"{robot.id}.stands", "there is nothing to stand on, expected the rig's `surface` (or no `stands`)"
            )
        if robot.T_world_fixed is not None:
            raise inner.error(
                f"{robot.id}.stands", "it does not move (`fixed`), expected only one of both: what is fixed is known"
            )


def _robots_of(section: Section, named: Named) -> tuple[Section, str, dict[str, str]]:
    """The robots, and the file that they are in: its name, empty where they stand in the rig itself, and its text."""
    if not isinstance(section.values.get("robots"), str):
        return section.section("robots"), "", {}
    name = section.text("robots")
    text, where = named(section, "robots", name, "a file of robots that several rigs share")
    inner = parse_yaml(text, where)
    if set(inner.values) == {"robots"}:
        raise inner.error(
            "robots", "expected the robots' ids at the left margin (alpha: {leds: ...}), without this key"
        )
    return inner, name, {name: text}


def _range(section: Section) -> tuple[float, float]:
    near, far = section.numbers("range", 2, "nearest and farthest working distance, m")
    if not 0 < near < far:
        raise section.error("range", f"[{near:g}, {far:g}], expected 0 < nearest < farthest, m")
    refuse_millimetres(section, "range", (near, far))
    return near, far


def _masks(section: Section, camera: Camera) -> tuple[tuple[int, int, int, int], ...]:
    masks = []
    for index, row in enumerate(section.rows("masks", 4, "x0, y0, x1, y1 px")):
        x0, y0, x1, y1 = (int(value) for value in row)
        if [x0, y0, x1, y1] != row or not (0 <= x0 < x1 < camera.width and 0 <= y0 < y1 < camera.height):
            raise section.error(
                f"masks[{index}]",
                f"{row}, expected whole numbers x0 < x1 <= {camera.width - 1} and y0 < y1 <= {camera.height - 1}",
            )
        masks.append((x0, y0, x1, y1))
    return tuple(masks)


def _world(section: Section) -> tuple[Pose, bool]:
    section.only(("position", "orientation", "follow"), WORLD_WORDS)
    follows = section.boolean("follow") if "follow" in section else False
    return read_pose(section, "x, y, z of the camera in the world, m"), follows


def _fixed(section: Section, T_world_camera: Pose | None) -> Pose:
    if T_world_camera is None:
        raise section.error(
            None,
            "needs the rig's `world`, the pose of the camera in the world; roughly will do until asterism calibrate "
            "world --fixed (one camera) or calibrate cameras (several) has found it",
        )
    section.only(("position", "orientation"), WORLD_WORDS)
    return read_pose(section, "x, y, z of the constellation in the world, m")


def _robot(
    name: str, section: Section, T_world_camera: Pose | None, offset_of: Callable[[Section, str], LedOffset]
) -> Robot:
    if problem := key_problem(name):
        raise section.error(None, f"the robot's id {describe(name)} {problem}; it becomes part of a zenoh key")
    section.only(("leds", "led", "points", "normal", "fixed", "stands"), ROBOT_WORDS)
    leds = read_leds(section)
    axis, radius, offset = np.array([0.0, 0.0, 1.0]), None, None
    if "led" in section:
        led = section.section("led")
        led.only(("radius", "axis", "offset"), LED_WORDS)
        if "axis" in led:
            axis = _direction(led, "axis", "the emission axis in the robot's frame")
        if "radius" in led:
            radius = led.number("radius", above=0)
            if radius > extent(leds) / 4:
                raise led.error(
                    "radius",
                    f"{radius:g}, expected m, at most a quarter of the LEDs' extent ({extent(leds) / 4:.3g} m); is "
                    f"that mm? For example {radius / 1e3:g}",
                )
        if "offset" in led:
            offset = offset_of(led, led.text("offset"))
    normal = plane_of(leds, axis)[0].rotation[:, 2]
    if normal @ axis < 0.2:
        key = "led.axis" if "led" in section and "axis" in section.section("led") else "leds"
        raise section.error(
            key,
            f"the LEDs shine along {axis.round(3).tolist()}, within their own plane (normal "
            f"{normal.round(3).tolist()}), expected led.axis to point out of it",
        )
    points: dict[str, Floats] = {}
    if "points" in section:
        inner = section.section("points")
        for key in inner.values:
            if problem := key_problem(key):
                raise inner.error(None, f"the point's name {describe(key)} {problem}")
            points[key] = _point(inner, key, leds)
    prior = None
    if "normal" in section:
        inner = section.section("normal")
        inner.only(("world", "within_deg"), NORMAL_WORDS)
        if T_world_camera is None:
            raise section.error("normal", "needs the rig's `world`, the pose of the camera in the world")
        direction = _direction(inner, "world", "where led.axis points, in the world's frame")
        within = inner.number("within_deg", above=0)
        if within > 180:
            raise inner.error("within_deg", f"{within:g}, expected at most 180")
        prior = NormalPrior(frozen_array(direction, 3), float(np.radians(within)))
    fixed = _fixed(section.section("fixed"), T_world_camera) if "fixed" in section else None
    stands = read_stands(section.section("stands"), points, axis) if "stands" in section else None
    return Robot(name, leds, axis, radius, points, prior, offset, fixed, stands)


def _point(section: Section, key: str, leds: Floats) -> Floats:
    point = section.numbers(key, 3, "x, y, z in the robot's frame, m")
    away, farthest = float(np.linalg.norm(point - leds.mean(axis=0))), FARTHEST_POINT * extent(leds)
    if away > farthest:
        raise section.error(
            key,
            f"{away:g} m from the LEDs, expected at most {FARTHEST_POINT:g} times their extent ({farthest:g} m); "
            f"{in_metres(point)}",
        )
    return frozen_array(point, 3)


def _direction(section: Section, key: str, what: str) -> Floats:
    vector = np.array(section.numbers(key, 3, what))
    length = float(np.linalg.norm(vector))
    if length == 0.0:
        raise section.error(key, "[0, 0, 0] has no direction, expected a vector of any length above 0")
    unit: Floats = vector / length
    return unit


def _refuse_lookalikes(section: Section, robots: tuple[Robot, ...]) -> None:
    for confusion in confusions([robot.leds_plane[:, :2] for robot in robots]):
        seen, taken = robots[confusion.seen], robots[confusion.taken]
        limit = SEPARATION * min(seen.extent, taken.extent)
        if confusion.separation >= limit:
            continue
        if confusion.seen == confusion.taken:
            raise section.error(
                f"{seen.id}.leds",
                f"the constellation looks the same turned (LEDs {list(confusion.seen_leds)} as "
                f"{list(confusion.taken_leds)}, separation {confusion.separation * 1e3:.2g} mm), expected at least "
                f"{limit * 1e3:.2g} mm, {SEPARATION:.0%} of its extent",
            )
        raise section.error(
            None,
            f"{seen.id} and {taken.id} have equal constellations (separation {confusion.separation * 1e3:.2g} mm), "
            f"expected at least {limit * 1e3:.2g} mm, {SEPARATION:.0%} of their extent",
        )


def hidden_led_warnings(rig: Rig) -> list[str]:
    """A sentence for every pair of robots that become alike, or robot that becomes symmetric, with one LED hidden."""
    nearest: dict[tuple[int, int], Confusion] = {}
    for confusion in confusions([robot.leds_plane[:, :2] for robot in rig.robots], hidden=1):
        seen, taken = rig.robots[confusion.seen], rig.robots[confusion.taken]
        pair = (min(confusion.seen, confusion.taken), max(confusion.seen, confusion.taken))
        near = confusion.separation < SEPARATION * min(seen.extent, taken.extent)
        if near and (pair not in nearest or confusion.separation < nearest[pair].separation):
            nearest[pair] = confusion
    sentences = []
    for (first, second), confusion in sorted(nearest.items()):
        who = (
            f"{rig.robots[first].id} looks the same turned"
            if first == second
            else f"{rig.robots[first].id} and {rig.robots[second].id} look alike"
        )
        sentences.append(f"with one LED hidden {who} (separation {confusion.separation * 1e3:.2g} mm)")
    return sentences
