"""What is not known exactly about a rig, as standard deviations: given in `uncertainty.yaml` beside it, or assumed.

```yaml
centre_px: 0.01              # noise of an LED's centre per axis, px, at any distance
bias_px: 0.002               # error of a centre that is not noise (shape of the spot, its phase in the pixels), px
led_position_m: 0.00005      # an LED's position in the robot, per axis, m
offset_m: 0.00005            # uncompensated shift of an LED's light seen at 45 degrees, m; grows with the sine's cube
focal_relative: 0.0005       # focal length, as a share of it
principal_point_px: 0.5      # principal point, per axis, px
distortion_relative: 0.01    # lens distortion, as a share of it
```

Every key may be left out; then focal length and principal point are as sure as the camera's calibration was, if its
report (`calibrate camera`) lies beside it, and of the rest what is assumed stands.
"""

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from asterism.protocol.camera import load_camera
from asterism.protocol.yaml_file import read_yaml
from asterism.server.calibration.lens.camera_file import report_path

FILE = "uncertainty.yaml"
# By estimator of centres, rounded up from tests/measure/centres.py: noise over the Cramer-Rao bound, bias px.
ESTIMATOR_NOISE = {"edge-model": 1.03, "grey-square": 1.5, "clip": 1.2, "zernike": 2.0}
ESTIMATOR_BIAS_PX = {"edge-model": 0.001, "grey-square": 0.003, "clip": 0.002, "zernike": 0.02}


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """Standard deviations of everything that a pose rests on; ``given`` names those that are not assumed,
    ``calibrated`` those that a calibration told.

    ``centre_px`` None: from the light that falls on the pixels (`centre_noise`). ``offset_m`` is the length of the
    apparent shift at 45 degrees, of all LEDs alike.
    """

    centre_px: float | None = None
    bias_px: float = ESTIMATOR_BIAS_PX["edge-model"]
    led_position_m: float = 5e-5
    offset_m: float = 5e-5
    focal_relative: float = 5e-4
    principal_point_px: float = 0.5
    distortion_relative: float = 0.01
    given: frozenset[str] = frozenset()
    calibrated: frozenset[str] = frozenset()


KEYS = tuple(field.name for field in fields(Uncertainty) if field.name not in ("given", "calibrated"))


def read_uncertainty(rig_path: Path, centre: str, camera_path: Path | None = None) -> Uncertainty:
    """What `uncertainty.yaml` beside a rig gives, or the report beside the camera's file tells, the rest assumed.

    ``centre`` is the rig's estimator of centres.

    Raises InputError with file, key, what was found and what is accepted.
    """
    assumed = replace(Uncertainty(bias_px=ESTIMATOR_BIAS_PX[centre]), **_calibrated(camera_path))
    path = rig_path.parent / FILE
    if not path.exists():
        return assumed
    section = read_yaml(path)
    section.only(KEYS)
    given = {key: section.number(key, least=0.0) for key in KEYS if key in section}
    return replace(assumed, **given, given=frozenset(given), calibrated=assumed.calibrated - frozenset(given))


def _calibrated(camera_path: Path | None) -> dict[str, Any]:
    """What the report of a camera's calibration tells; nothing where there is none."""
    if camera_path is None or not (path := report_path(camera_path)).exists():
        return {}
    sigmas, focal = read_yaml(path).section("sigmas"), load_camera(camera_path).focal_px
    told = {
        "focal_relative": 0.5 * (sigmas.number("fx", least=0.0) + sigmas.number("fy", least=0.0)) / focal,
        "principal_point_px": 0.5 * (sigmas.number("cx", least=0.0) + sigmas.number("cy", least=0.0)),
    }
    return {**told, "calibrated": frozenset(told)}
