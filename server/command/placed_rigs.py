"""What `asterism calibrate cameras` writes: every rig again in one folder, and how well its camera's place is known."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from asterism.protocol.camera import parse_camera
from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Pose
from asterism.protocol.place_error import PlaceError
from asterism.protocol.rig_files import report_path
from asterism.server.budget.uncertainty_file import check_uncertainty_file, write_uncertainty_file
from asterism.server.calibration.lens.camera_file import refit_report_text
from asterism.server.calibration.result_file import check_result_file, write_result_file
from asterism.server.calibration.rewrite import Value
from asterism.server.calibration.rig_texts import RigTexts, told_of
from asterism.server.output import check_folder_of_many

if TYPE_CHECKING:
    from asterism.server.calibration.cameras.calibration import CamerasFit, Placed
    from asterism.server.calibration.cameras.recorded import Pair


def check_placed(pairs: "Sequence[Pair]", folder: Path, lens: bool, force: bool) -> None:
    """Refuse, before any work is done, to replace anything unasked. Raises InputError."""
    check_folder_of_many(folder)
    for pair in pairs if folder.exists() else ():
        out = _out(pairs, pair, folder)
        check_result_file(out, force)
        check_uncertainty_file(out, force)
        if lens:
            check_result_file(_camera_out(out), force)
            check_result_file(report_path(_camera_out(out)), force)


def write_placed(
    pairs: "Sequence[Pair]", fit: "CamerasFit", places: Sequence[tuple[Pose, PlaceError]], folder: Path, force: bool
) -> list[str]:
    """Write every rig with its camera's place, what is known of that, and its lens where it was fitted; returns what to
    tell.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror})") from None
    lines = []
    for pair, placed, (place, known) in zip(pairs, fit.cameras, places, strict=True):
        out = _out(pairs, pair, folder)
        world: dict[str, Value] = {
            "position": (place.position.round(7) + 0.0).tolist(),
            "orientation": (place.orientation.round(9) + 0.0).tolist(),
        }
        changes: dict[tuple[str, ...], Value] = {("world",): world}
        if pair.rig.follows_world:  # which stays
            changes = {("world", key): value for key, value in world.items()}
        texts = RigTexts.of(pair.rig, pair.path).rewritten(changes)
        camera_text = _camera_text(pair, placed)
        texts.check(camera_text, out)
        camera = _write_lens(pair, placed, camera_text, out, force) if placed.lens is not None else None
        lines += told_of(texts.write(out, force, camera), pair.rig)
        lines += write_uncertainty_file(pair.path, out, {}, force, new_lens=camera is not None, world=known)
    return lines


def _out(pairs: "Sequence[Pair]", pair: "Pair", folder: Path) -> Path:
    """Where a rig goes: under its own name, where all have names of their own, else under its camera's."""
    names = [each.path.name for each in pairs]
    return folder / (pair.path.name if len(set(names)) == len(names) else f"{pair.rig.camera.name}.yaml")


def _camera_out(out: Path) -> Path:
    return out.with_name(f"{out.stem}-camera.yaml")


def _camera_text(pair: "Pair", placed: "Placed") -> str:
    from dataclasses import replace

    from asterism.server.command.calibrate_z import refitted_text

    if placed.lens is None:
        return pair.rig.camera_text
    return refitted_text(pair.rig, replace(pair.rig, camera=placed.lens))


def _write_lens(pair: "Pair", placed: "Placed", text: str, out: Path, force: bool) -> Path:
    """The fitted lens and its report beside the new rig; returns where the lens is."""
    assert placed.lens_covariance is not None
    camera = _camera_out(out)
    # Of a part of the sensor to all of it: as much larger as its pixels are.
    larger = np.concatenate([np.full(4, pair.rig.capture.binning or 1), np.ones(len(placed.lens_covariance) - 4)])
    covariance = placed.lens_covariance * np.outer(larger, larger)
    written = parse_camera(text, str(camera))
    report = refit_report_text(written, covariance, str(pair.recording.path), placed.frames, "calibrate cameras")
    write_result_file(camera, text, force)
    write_result_file(report_path(camera), report, force)
    return camera
