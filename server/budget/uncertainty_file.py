"""Writing what calibrations know of a rig's uncertainties: `rig4.uncertainty.yaml` beside the `rig4.yaml` they write.

It begins as what held for the rig they started from, with comments, and with the numbers that a calibration knows
better put in their places. `uncertainty.yaml`, which a person wrote for a whole folder, is never changed.
"""

from collections.abc import Mapping
from pathlib import Path

from asterism.protocol.errors import InputError
from asterism.protocol.place_error import WORLD, PlaceError
from asterism.protocol.rig_files import UNCERTAINTY, file_of, own_path
from asterism.protocol.yaml_file import parse_yaml
from asterism.server.budget.uncertainty import LENS_KEYS, LedError
from asterism.server.calibration.result_file import check_result_file, set_aside, write_result_file
from asterism.server.calibration.rewrite import Value, rewrite, without

_TITLE = "# Uncertainties of "


def check_uncertainty_file(rig_out: Path, force: bool) -> None:
    """Refuse, before any work is done, to replace a file unasked. Raises InputError."""
    check_result_file(own_path(rig_out), force)


def write_uncertainty_file(
    rig: Path,
    rig_out: Path,
    robots: Mapping[str, LedError],
    force: bool,
    new_lens: bool = False,
    world: PlaceError | None = None,
) -> list[str]:
    """Write what holds for ``rig_out``, made from ``rig``, with what was measured of its ``robots`` and of where its
    camera is in the ``world``; ``new_lens``: its lens has a report of its own, and where its camera is was found with
    another. Returns what to tell.

    Raises InputError, WorldError as `write_result_file` does.
    """
    before, out = file_of(rig), own_path(rig_out)
    if not robots and not new_lens and world is None and (before is None or before == rig_out.parent / UNCERTAINTY):
        old = set_aside(out)
        return [f"{out} was of an older {rig_out.name}: kept as {old}"] if old else []
    text = before.read_text(encoding="utf-8") if before else ""
    text, dropped = _without_lens(text, str(before)) if new_lens else (text, [])
    if world is not None:
        text = _with_world(text, world, str(before or out))
    text = _titled(_with_robots(text, robots, str(before or out)), rig_out.name)
    kept = write_result_file(out, text, force)
    told = [f"written: {out}, what is not known exactly, for asterism report" + (f"; old: {kept}" if kept else "")]
    if dropped:
        told.append(f"{', '.join(dropped)} of {before} are left out there: the refitted lens has its own report")
    return told


def _without_lens(text: str, name: str) -> tuple[str, list[str]]:
    present = [key for key in (*LENS_KEYS, WORLD) if key in _keys(text, name)]
    for key in present:
        text = without(text, key)
    return text, present


def _with_world(text: str, world: PlaceError, name: str) -> str:
    if WORLD in _keys(text, name):
        text = without(text, WORLD)
    rows = "".join(f"    - [{', '.join(f'{value:.9g}' for value in row)}]\n" for row in world.covariance.tolist())
    return (
        text
        + "\n" * (text != "" and not text.endswith("\n"))
        + f"{WORLD}:\n  by: {world.by}\n  covariance:   # x, y, z m, rotation about x, y, z of the world rad\n{rows}"
    )


def _with_robots(text: str, robots: Mapping[str, LedError], name: str) -> str:
    for robot, known in robots.items():
        value: dict[str, Value] = {"led_position_m": _short(known.position_m)}
        for key in ("size_relative", "frame_m", "tilt_rad", "turn_rad"):
            if number := getattr(known, key):
                value[key] = _short(number)
        value["by"] = known.by
        if "robots" not in _keys(text, name):
            text = text + "\n" * (text != "" and not text.endswith("\n")) + f"robots:\n  {robot}: {{}}\n"
        text = rewrite(text, {("robots", robot): value}, name)
    return text


def _keys(text: str, name: str) -> set[str]:
    lines = [line.strip() for line in text.splitlines()]
    content = [line for line in lines if line and not line.startswith("#")]
    if content and content[0].startswith("{"):
        raise InputError(f"{name}: is written in braces, expected one key a line, so that a calibration can change it")
    return set(parse_yaml(text, name).values) if content else set()


def _titled(text: str, rig_name: str) -> str:
    if text.startswith(_TITLE):
        text = text.partition("\n")[2]
    return (
        f"{_TITLE}{rig_name}, one standard deviation each; asterism report reads it in place of {UNCERTAINTY}.\n{text}"
    )


def _short(value: float) -> float:
    return float(f"{value:.3g}")
