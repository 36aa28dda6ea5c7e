"""asterism calibrate surface: the surface that robots drive on, from their poses."""

import argparse
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats
from asterism.protocol.heights_file import heights_text
from asterism.protocol.rig import Rig, Robot, load_rig, parse_rig
from asterism.protocol.surface import Heights
from asterism.protocol.yaml_file import parse_yaml
from asterism.recordings.export.lines import SUFFIX
from asterism.recordings.reader import Recording
from asterism.server.budget.budget import Poses
from asterism.server.budget.common_causes import common_causes, led_shapes
from asterism.server.budget.uncertainty import Uncertainty, lens_error_of, read_uncertainty
from asterism.server.budget.uncertainty_file import check_uncertainty_file, write_uncertainty_file
from asterism.server.calibration.leds.observations import observe
from asterism.server.calibration.lens.lens_error import LensError
from asterism.server.calibration.result_file import check_result_file, write_result_file
from asterism.server.calibration.rig_texts import RigTexts, check_rig_files, told_of
from asterism.server.calibration.surface.calibration import calibrate_surface
from asterism.server.calibration.surface.located import Located, Sight
from asterism.server.calibration.surface.pictures import drawing_png, surface_png
from asterism.server.calibration.surface.reported import check_camera, sights_of_lines, sights_of_recording
from asterism.server.calibration.surface.residual_map import table_text
from asterism.server.calibration.surface.surface_fit import SurfaceFit
from asterism.server.calibration.surface.touching import Standing, contacts_of, pose_by_spots
from asterism.server.calibration.surface.written import stands_changes, with_surface
from asterism.server.chain.warm_up import localizing, warm_up
from asterism.server.command import registered_surface
from asterism.server.command.calibrate import add_source_and_out
from asterism.server.command.calibrated_surface import comments, shared_text, tell
from asterism.server.command.fitted_rig import open_fitting
from asterism.server.command.number_arguments import positive
from asterism.server.command.progress import progress, working
from asterism.server.command.registered_surface import read_drawing, registered
from asterism.server.output import new_file
from asterism.server.service.say import say
from asterism.server.sources.open_source import refuse_endless

EXAMPLES = (
    "asterism calibrate surface rig.yaml film/ -o rig2.yaml\n"
    "asterism calibrate surface rig.yaml recordings/drive -o rig2.yaml\n"
    "asterism calibrate surface rig.yaml poses.jsonl --point wheel -o rig2.yaml\n"
    "asterism calibrate surface rig.yaml film/ --stl mould.stl --scale 0.001 -o rig2.yaml\n"
)

BESIDE = ("surface.csv", "surface.png", "differs.csv")  # of a rig, what is written with it
TOOL = "tool"  # by which robots stand, unless it is told otherwise
SAMPLE = 200  # poses that tell what the lens adds


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add_source_and_out(part, "rig.yaml")
    part.add_argument(
        "--point",
        metavar="NAME",
        help=f"by which of its `points` a robot stands that has no `stands` in the rig (default: {TOOL})",
    )
    part.add_argument(
        "--stl", metavar="FILE", type=Path, help="a drawing of the surface: where it lies, and how the mould differs"
    )
    part.add_argument("--scale", metavar="FACTOR", type=positive, help="of the drawing: 0.001 for one in mm")
    part.add_argument(
        "--as-drawn", action="store_true", help="the rig takes the drawing itself, without what the mould differs"
    )


def run(options: argparse.Namespace) -> int:
    """Fit, write the rig with its surface, say what it is worth."""
    table, picture, differs = (options.out.with_name(f"{options.out.stem}.{end}") for end in BESIDE)
    if options.stl is None and (options.scale is not None or options.as_drawn):
        raise InputError(f"{'--as-drawn' if options.as_drawn else '--scale'}: is of a drawing, expected --stl FILE too")
    for path in (options.out, table, picture, *([differs] if options.stl else [])):
        check_result_file(path, options.force)
    check_uncertainty_file(options.out, options.force)
    refuse_endless(options.source, "calibrate surface")
    rig = load_rig(options.rig)
    check_rig_files(rig, options.out, options.force)
    names = standing_points(rig, options.point, options.rig)
    camera_path = Path(options.rig).parent / parse_yaml(rig.rig_text, options.rig).text("camera")
    uncertainty = read_uncertainty(Path(options.rig), rig.centre, camera_path)
    lens = lens_error_of(rig.camera, camera_path, uncertainty)
    triangles = read_drawing(options.stl, options.scale or 1.0) if options.stl else None
    rig, sights = read_sights(options, rig)
    fit = fitted_to(rig, sights, names, uncertainty, options.source)
    shared = shared_sigma(rig, sights, uncertainty, lens)
    if triangles is not None:
        with working("registering the drawing"):
            laid = registered(fit, triangles, options.stl, rig, options.as_drawn)
            picture_png, table_of = drawing_png(laid.fit, laid.differs), table_text(laid.differs)
        written = write_surface(options, rig, laid.fit, table, registered_surface.comments(laid))
        written.append(_written(differs, table_of.encode(), options.force))
        registered_surface.tell(laid)
        print(shared_text(shared, lens.told_by))
    else:
        picture_png = surface_png(fit)
        written = write_surface(options, rig, fit, table, comments(fit))
        tell(fit, shared, lens.told_by)
    for line in (*written, _written(picture, picture_png, options.force)):
        print(line)
    return 0


def _written(path: Path, data: bytes, force: bool) -> str:
    """A sentence about a file that was written beside the rig."""
    with new_file(path, force) as output:
        output.path.write_bytes(data)
    return f"written: {path}" + (f"; the old one is kept as {output.kept}" if output.kept else "")


def standing_points(rig: Rig, point: str | None, path: str) -> dict[str, str]:
    """By which point every robot stands: of those that have one.

    Raises InputError for a rig without a world, and where no robot has such a point.
    """
    if rig.T_world_camera is None:
        raise InputError(
            f"{path}: has no `world`, the pose of the camera in the world, which a surface is in; asterism calibrate "
            "world finds it"
        )
    movable = [robot for robot in rig.robots if robot.T_world_fixed is None]
    if point is not None and all(robot.stands is not None for robot in movable):
        raise InputError(f"--point {point}: every robot of {path} has `stands` already, whose point counts")
    name = point or TOOL
    names = {robot.id: robot.stands.point if robot.stands is not None else name for robot in movable}
    found = {robot.id: names[robot.id] for robot in movable if names[robot.id] in robot.points}
    if not found:
        has = sorted({each for robot in movable for each in robot.points})
        raise InputError(
            f"{path}: no robot has a point '{name}' by which it stands, expected --point with one of "
            f"{', '.join(has)}" if has else f"{path}: no robot has `points`, expected the one by which it stands, such "
            f"as points: {{{TOOL}: [0.0, 0.0, -0.03]}}; asterism calibrate point measures it"
        )  # fmt: skip
    return found


def read_sights(options: argparse.Namespace, rig: Rig) -> tuple[Rig, list[Sight]]:
    """The rig for the source's images, and where robots were in it, by light alone. Raises InputError."""
    path = Path(options.source)
    if path.suffix == SUFFIX and path.is_file():
        return rig, list(sights_of_lines(path, rig))
    if path.is_dir() and any(path.glob("poses-*.mcap")):
        recording = Recording(path)
        check_camera(recording, rig)
        if not recording.count_frames():
            with working("reading the recording"):
                return rig, list(sights_of_recording(recording, rig))
    fitting, source = open_fitting(options.source, rig, say, options.topic)
    light = by_light(fitting)
    warm_up(*localizing(light))
    return fitting, list(_seen(progress(observe(source.frames(), light), source.length, "localizing"), fitting))


def by_light(rig: Rig) -> Rig:
    """The rig without a surface, and nobody who stands on it."""
    return replace(rig, surface=None, robots=tuple(replace(robot, stands=None) for robot in rig.robots))


def _seen(observed: Iterator, rig: Rig) -> Iterator[Sight]:  # type: ignore[type-arg]
    place = rig.T_world_camera
    assert place is not None
    turn = np.kron(np.eye(2), place.rotation)
    for frame, sightings in observed:
        for one in sightings:
            other = None if one.alternative is None else place @ one.alternative
            yield Sight(one.robot, frame.exposed_ns * 1e-9, place @ one.pose, turn @ one.covariance @ turn.T, other)


def fitted_to(
    rig: Rig, sights: list[Sight], names: Mapping[str, str], uncertainty: Uncertainty, source: str
) -> SurfaceFit:
    """The surface by robots that stand by points of those ``names``. Raises InputError."""
    seen = {sight.robot for sight in sights}
    ids = tuple(robot.id for robot in rig.robots if robot.id in names and robot.id in seen)
    if not ids:
        raise InputError(f"{source}: none of {', '.join(names)} was located in it, expected robots that drive")
    standing = {each: Standing(names[each], led_shapes(rig.robot(each), uncertainty.leds_of(each))) for each in ids}
    with working("fitting the surface"):
        contacts = contacts_of(rig, Located.of(ids, sights), standing)
        return calibrate_surface(contacts, [_axis(rig.robot(each)) for each in ids], source)


def _axis(robot: Robot) -> Floats:
    return robot.axis if robot.stands is None else robot.stands.axis


def shared_sigma(rig: Rig, sights: list[Sight], uncertainty: Uncertainty, lens: LensError) -> float:
    """One sigma, m, of how far what all poses share (the lens, how LEDs shine) moves robots along the line of sight."""
    assert rig.T_world_camera is not None
    squared = []
    for sight in sights[:: max(len(sights) // SAMPLE, 1)]:
        robot = rig.robot(sight.robot)
        rotation, t = sight.pose.rotation[None], sight.pose.position[None]
        seen = rig.T_world_camera.inverse() @ sight.pose
        causes = common_causes(
            rig, robot, Poses(seen.rotation[None], seen.position[None]), uncertainty, lens.covariance
        )
        moved = (pose_by_spots(rig, robot, rotation, t)[0] @ causes)[0, :3]
        squared.append(float(((rig.T_world_camera.rotation[:, 2] @ moved) ** 2).sum()))
    return float(np.sqrt(np.mean(squared)))


def write_surface(
    options: argparse.Namespace, rig: Rig, fit: SurfaceFit, table: Path, said: list[str]
) -> list[str]:  # fmt: skip
    """Write the rig with what is ``said`` above its surface, and its heights beside it; sentences about that."""
    texts = RigTexts.of(rig, options.rig).rewritten(stands_changes(fit, rig))
    name = relative(table, Path(options.rig).parent)
    texts = replace(texts, text=with_surface(texts.text, fit.surface, name, said))
    heights = heights_text(fit.map)
    files = {**rig.files, **({rig.robots_name: texts.robots} if rig.robots_name else {}), name: heights}
    parse_rig(texts.text, rig.camera_text, str(options.out), rig.offset_texts, files)
    lines = []
    if isinstance(fit.surface.shape, Heights):
        old = write_result_file(table, heights, options.force)
        lines.append(f"written: {table}" + (f"; the old one is kept as {old}" if old else ""))
    lines += told_of(texts.write(options.out, options.force), rig)
    return lines + write_uncertainty_file(Path(options.rig), options.out, {}, options.force)


def relative(path: Path, folder: Path) -> str:
    """The path of a file from a folder, as rigs have it."""
    import os

    return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()
