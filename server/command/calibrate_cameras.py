"""asterism calibrate cameras: where several cameras stand in one world, from robots that two or more of them see."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.place_error import PlaceError
from asterism.protocol.rig import Rig, load_rig
from asterism.protocol.yaml_file import parse_yaml
from asterism.recordings.reader import Recording
from asterism.server.command.shared_arguments import add_out

if TYPE_CHECKING:  # what fits imports compiled code, which the other commands would wait for
    from asterism.server.calibration.cameras.calibration import CamerasFit
    from asterism.server.calibration.cameras.recorded import Pair

EXAMPLES = (
    "asterism calibrate cameras left.yaml right.yaml recordings/left recordings/right -o placed/\n"
    "asterism calibrate cameras left.yaml right.yaml third.yaml recordings/* --lens -o placed/\n"
)

BY = "calibrate cameras"
NEXT = (
    "recordings keep the rig they were made with: for poses by the new ones let every server read its own (asterism "
    "reload), or take its film again (asterism locate RIG FILM --record DIR)"
)
CLEARLY_OFF = 5.0  # sigmas of a clock's offset, from which on it is said how to take it off,
OFF_S = 5e-5  # and s
LED_OFF_M = 5e-6  # of a robot's LEDs, from which on it is said


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    part.add_argument(
        "sources",
        metavar="RIG|RECORDING",
        nargs="+",
        type=Path,
        help="the rig.yaml of every camera, the first one's world holds, and a recording's folder of each",
    )
    part.add_argument("--lens", action="store_true", help="fit the cameras' lenses too, from what is known of them")
    add_out(part, "DIR", "a folder for the rigs with their new `world`, and how well that is known")


def run(options: argparse.Namespace) -> int:
    """Fit, say what was found, write every rig."""
    from asterism.server.budget.uncertainty import lens_error_of, read_uncertainty
    from asterism.server.calibration.cameras.calibration import calibrate_cameras
    from asterism.server.calibration.cameras.origin import origin_of
    from asterism.server.calibration.cameras.recorded import paired, read_all, robots_of
    from asterism.server.command.placed_rigs import check_placed, write_placed
    from asterism.server.command.progress import working

    pairs = paired(*_rigs_and_recordings(options.sources))
    rigs = [pair.rig for pair in pairs]
    _refuse_alone(pairs)
    _refuse_unlike(rigs)
    check_placed(pairs, options.out, options.lens, options.force)
    lenses = []
    for pair in pairs:
        camera = camera_path(pair.path, pair.rig)
        lenses.append(lens_error_of(pair.rig.camera, camera, read_uncertainty(pair.path, pair.rig.centre, camera)))
    with working("reading the recordings"):
        seen = read_all(pairs)
    with working("fitting the cameras' places"):
        fit = calibrate_cameras(seen, robots_of(rigs), [lens.covariance for lens in lenses], options.lens)
        origin = origin_of(rigs, fit.robot_poses)
    places = [origin.T_world_first @ placed.T_first_camera for placed in fit.cameras]
    _table(fit, rigs, places)
    print(f"the world is {origin.told}; standard deviations are against camera {fit.cameras[0].camera}")
    for line in [*_clock_lines(fit, rigs), *_led_lines(fit), *_lens_lines(fit, [lens.told_by for lens in lenses])]:
        print(line)
    turn = np.kron(np.eye(2), origin.T_world_first.rotation)
    by = f"{BY}, against camera {fit.cameras[0].camera}"
    known = [PlaceError(turn @ placed.covariance @ turn.T, by) for placed in fit.cameras]
    for line in write_placed(pairs, fit, list(zip(places, known, strict=True)), options.out, options.force):
        print(line)
    print(NEXT)
    return 0


def camera_path(path: Path, rig: Rig) -> Path:
    """The camera's file that a rig at ``path`` names."""
    return path.parent / parse_yaml(rig.rig_text, str(path)).text("camera")


def _rigs_and_recordings(sources: Sequence[Path]) -> tuple[list[tuple[Path, Rig]], list[Recording]]:
    """What is a file's name ending in .yaml is a rig, all else a recording."""
    rigs = [path for path in sources if path.suffix in (".yaml", ".yml")]
    recordings = [path for path in sources if path not in rigs]
    return [(path, load_rig(path)) for path in rigs], [Recording(path) for path in recordings]


def _refuse_alone(pairs: "Sequence[Pair]") -> None:
    if len(pairs) < 2:
        raise InputError(
            f"{len(pairs)} camera, expected two or more: the rig.yaml of each, and a recording of each, made at the "
            "same time"
        )


def _refuse_unlike(rigs: Sequence[Rig]) -> None:
    from asterism.server.fusing.fitting import unlike

    for k, rig in enumerate(rigs):
        for other in rigs[:k]:
            theirs = {robot.id: robot for robot in other.robots}
            for robot in rig.robots:
                if robot.id in theirs and (told := unlike(robot, theirs[robot.id])):
                    raise InputError(
                        f"robot '{robot.id}' is another one in the rig of camera '{rig.camera.name}' than in that of "
                        f"'{other.camera.name}': {told}; expected the same in both, such as one file of robots that "
                        "both rigs name (robots: robots.yaml)"
                    )


def _table(fit: "CamerasFit", rigs: Sequence[Rig], places: Sequence[Pose]) -> None:
    """A row for every camera."""
    from rich.console import Console
    from rich.table import Table

    from asterism.server.pose.place import apart

    console = Console()
    if not console.is_terminal:
        console = Console(width=160)
    table = Table(box=None, header_style="bold", padding=(0, 1, 0, 0))
    columns = ("camera", "sigma\nmm", "\ndeg", "residual\npx", "held\nout px", "\nframes", "\nrobots", "moved\nmm",
               "\ndeg")  # fmt: skip
    for name in columns:
        table.add_column(name, justify="left" if name == "camera" else "right", no_wrap=True)
    for placed, rig, place in zip(fit.cameras, rigs, places, strict=True):
        sigmas = np.sqrt(np.diag(placed.covariance))
        away = None if rig.T_world_camera is None else apart(rig.T_world_camera, place)
        first = placed is fit.cameras[0]
        table.add_row(
            placed.camera,
            *(("-", "-") if first else (f"{1e3 * sigmas[:3].max():.3f}", f"{np.degrees(sigmas[3:].max()):.4f}")),
            f"{placed.rms_px:.3f}",
            f"{placed.held_out_px:.3f}",
            str(placed.frames),
            str(len(placed.robots)),
            *(("-", "-") if away is None else (_mm(away[:3]), f"{np.degrees(np.linalg.norm(away[3:])):.4f}")),
        )
    console.print(table)
    console.print(
        f"{fit.moments} moments of up to three frames; {fit.left_out} spots left out; residuals "
        f"{fit.noise:.2f} times the spots' noise; sigma: of the worst axis",
        highlight=False,
    )


def _mm(away: Floats) -> str:
    return f"{1e3 * np.linalg.norm(away):.3f}"


def _clock_lines(fit: "CamerasFit", rigs: Sequence[Rig]) -> list[str]:
    """How the clocks go, a line for every camera but the first."""
    first, lines = fit.cameras[0].camera, []
    for placed, rig in list(zip(fit.cameras, rigs, strict=True))[1:]:
        clock = placed.clock
        if not clock.told:
            lines.append(
                f"{placed.camera}'s clock against {first}'s cannot be told, since no robot moved enough where both see "
                "it; they were taken to go alike"
            )
            continue
        ahead = f"{1e3 * abs(clock.offset_s):.3f} +- {1e3 * clock.offset_sigma_s:.3f} ms"
        line = f"{placed.camera}'s clock is {ahead} {'behind' if clock.offset_s < 0 else 'ahead of'} {first}'s"
        line += f", drifting by {1e6 * clock.drift:.1f} +- {1e6 * clock.drift_sigma:.1f} ppm"
        if abs(clock.offset_s) > max(CLEARLY_OFF * clock.offset_sigma_s, OFF_S):
            delay = rig.capture.delay_us + 1e6 * clock.offset_s
            line += f"; capture: {{delay_us: {delay:.0f}}} in its rig takes that off"
        lines.append(line)
    return lines


def _led_lines(fit: "CamerasFit") -> list[str]:
    """Robots whose LEDs are not where the rigs have them: the cameras' distances rest on them."""
    off = {robot: sigma for robot, sigma in fit.misfits_m.items() if sigma > LED_OFF_M}
    if not off:
        return []
    told = ", ".join(f"{robot}: {1e3 * sigma:.3f} mm" for robot, sigma in off.items())
    return [
        f"LEDs are off where the rigs have them (one sigma; {told}), and the cameras' distances from each other, whose "
        "scale they give, by as much of themselves; asterism calibrate leds measures them"
    ]


def _lens_lines(fit: "CamerasFit", told_by: Sequence[str]) -> list[str]:
    """What the lenses' own errors add."""
    lines = []
    for placed, by in zip(fit.cameras, told_by, strict=True):
        who = "ASSUMED" if by == "assumed" else f"by {by}"
        if placed.lens is not None and placed.lens_covariance is not None:
            sigmas = np.sqrt(np.diag(placed.lens_covariance))
            m = placed.lens.matrix
            lines.append(
                f"{placed.camera}'s lens: f {m[0, 0]:.3f} +- {sigmas[0]:.3f}, {m[1, 1]:.3f} +- {sigmas[1]:.3f}, centre "
                f"{m[0, 2]:.3f} +- {sigmas[2]:.3f}, {m[1, 2]:.3f} +- {sigmas[3]:.3f} px"
            )
            continue
        sigmas = np.sqrt(np.diag(placed.lens_share))
        if sigmas.any():
            lines.append(
                f"{placed.camera}: what the lenses may be off adds {1e3 * sigmas[:3].max():.3f} mm and "
                f"{np.degrees(sigmas[3:].max()):.4f} degrees, {who}; it is in no file, since the rays "
                "through them share it"
            )
    return lines
