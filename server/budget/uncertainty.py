"""What is not known exactly about a rig, as standard deviations: given or measured in a file beside it, or assumed.

The file is `rig4.uncertainty.yaml` for `rig4.yaml`, which calibrations write beside the rig they write, and where there
is none `uncertainty.yaml`, a person's, for all rigs of the folder. Only one of them is read.

```yaml
centre_px: 0.01              # noise of an LED's centre per axis, px, at any distance
bias_px: 0.002               # error of a centre that is not noise (shape of the spot, its phase in the pixels), px
led_position_m: 0.00005      # an LED's position in the robot, per axis, m
offset_m: 0.00005            # uncompensated shift of an LED's light seen at 45 degrees, m; grows with the sine's cube
focal_relative: 0.0005       # focal length, as a share of it
principal_point_px: 0.5      # principal point, per axis, px
distortion_relative: 0.01    # lens distortion, as a share of it
robots:                      # of single robots, by the calibration that measured them; the others have led_position_m
  # among one another; the size of all six, as a share; for `calibrate world` the frame against the plate, m and rad
  alpha: {led_position_m: 3e-6, size_relative: 1e-3, frame_m: 1e-4, tilt_rad: 1e-3, turn_rad: 5e-3, by: calibrate leds}
world: {position_m: 0.0005, orientation_rad: 0.0003, by: a tape}   # where the camera is (`protocol.place_error`)
```

Every key may be left out; then the lens is as sure as its calibration was, if its report (`calibrate camera`,
`calibrate z`) lies beside the camera's file, and of the rest what is assumed stands.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from asterism.protocol.camera import Camera, load_camera
from asterism.protocol.place_error import WORLD, read_place_error
from asterism.protocol.rig_files import file_of
from asterism.protocol.yaml_file import Section, read_yaml
from asterism.server.calibration.lens.lens_error import LensError, assumed_lens_error, read_lens_error, shares_of

# By estimator of centres, rounded up from tests/measure/centres.py: noise over the Cramer-Rao bound, bias px.
ESTIMATOR_NOISE = {"edge-model": 1.03, "grey-square": 1.5, "clip": 1.2, "zernike": 2.0}
ESTIMATOR_BIAS_PX = {"edge-model": 0.001, "grey-square": 0.003, "clip": 0.002, "zernike": 0.02}


@dataclass(frozen=True, slots=True)
class LedError:
    """Of one robot's LEDs, standard deviations: ``position_m`` of each per axis among one another, m; ``size_relative``
    of the whole constellation's size, as a share; ``frame_m``, ``tilt_rad``, ``turn_rad`` of where the robot's frame is
    against the plate: m, rad of tilt, rad about the plate's normal; ``by`` says where that is from.
    """

    position_m: float
    size_relative: float
    by: str
    frame_m: float = 0.0
    tilt_rad: float = 0.0
    turn_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """Standard deviations of everything that a pose rests on; ``given`` names those that a person wrote, ``measured``
    those that a calibration told, and which one; the others are assumed. ``file`` is where they stand, if anywhere.

    ``centre_px`` None: from the light that falls on the pixels (`centre_noise`). ``offset_m`` is the length of the
    apparent shift at 45 degrees, of all LEDs alike. ``robots``: what is known of single ones' LEDs.
    """

    centre_px: float | None = None
    bias_px: float = ESTIMATOR_BIAS_PX["edge-model"]
    led_position_m: float = 5e-5
    offset_m: float = 5e-5
    focal_relative: float = 5e-4
    principal_point_px: float = 0.5
    distortion_relative: float = 0.01
    given: frozenset[str] = frozenset()
    measured: Mapping[str, str] = field(default_factory=dict)
    robots: Mapping[str, LedError] = field(default_factory=dict)
    file: Path | None = None

    def leds_of(self, robot_id: str) -> LedError:
        """What is known of a robot's LEDs."""
        known = self.robots.get(robot_id)
        return known or LedError(self.led_position_m, 0.0, self.origin("led_position_m"))

    def origin(self, key: str) -> str:
        """Where a number comes from, in words."""
        if key in self.measured:
            return f"measured: {self.measured[key]}"
        return "given" if key in self.given else "assumed"


_NO_KEYS = ("given", "measured", "robots", "file")
KEYS = tuple(each.name for each in fields(Uncertainty) if each.name not in _NO_KEYS)
LENS_KEYS = ("focal_relative", "principal_point_px", "distortion_relative")


def read_uncertainty(rig_path: Path, centre: str, camera_path: Path | None = None) -> Uncertainty:
    """What the file of a rig gives, or the report beside the camera's file tells, the rest assumed.

    ``centre`` is the rig's estimator of centres.

    Raises InputError with file, key, what was found and what is accepted.
    """
    assumed = replace(Uncertainty(bias_px=ESTIMATOR_BIAS_PX[centre]), **_calibrated(camera_path))
    path = file_of(rig_path)
    if path is None:
        return assumed
    section = read_yaml(path)
    section.only((*KEYS, "robots", WORLD))
    if WORLD in section:
        read_place_error(section.section(WORLD))  # of poses in the camera's frame, which a budget is of, it is no part
    given = {key: section.number(key, least=0.0) for key in KEYS if key in section}
    measured = {key: by for key, by in assumed.measured.items() if key not in given}
    robots = section.section("robots").sections() if "robots" in section else {}
    return replace(
        assumed,
        **given,
        given=frozenset(given),
        measured=measured,
        robots={robot: _led_error(part) for robot, part in robots.items()},
        file=path,
    )


def lens_error_of(camera: Camera, camera_path: Path, uncertainty: Uncertainty) -> LensError:
    """How wrong the lens may be: whole, as its calibration says, or by what a person gives or is assumed."""
    given = uncertainty.given.intersection(LENS_KEYS)
    told = read_lens_error(camera_path, camera)
    if told is not None and not given:
        return told
    numbers = (uncertainty.focal_relative, uncertainty.principal_point_px, uncertainty.distortion_relative)
    told_by = f"{uncertainty.file}" if given else "assumed"
    return assumed_lens_error(camera, *numbers, told_by)


def _led_error(part: Section) -> LedError:
    shares = ("size_relative", "frame_m", "tilt_rad", "turn_rad")
    part.only(("led_position_m", *shares, "by"))
    size, *frame = (part.number(key, least=0.0) if key in part else 0.0 for key in shares)
    return LedError(part.number("led_position_m", least=0.0), size, f"measured: {part.text('by')}", *frame)


def _calibrated(camera_path: Path | None) -> dict[str, Any]:
    """What the report of a camera's calibration tells; nothing where there is none."""
    if camera_path is None or not camera_path.exists():
        return {}
    camera = load_camera(camera_path)
    error = read_lens_error(camera_path, camera)
    if error is None:
        return {}
    told = shares_of(error, camera)
    return {**told, "measured": dict.fromkeys(told, error.told_by)}
