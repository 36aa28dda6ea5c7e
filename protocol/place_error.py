"""How well a camera's place in the world is known: the key `world` of a rig's file of uncertainties.

```yaml
world: {position_m: 0.0005, orientation_rad: 0.0003, by: a tape and a level}   # standard deviations per axis
world: {covariance: [[...], ... six rows of six], by: calibrate cameras}       # or whole, as of a pose
```

The covariance is that of T_world_camera: x, y, z in m, rotation about x, y, z of the world in rad.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.protocol.rig_files import uncertainty_of
from asterism.protocol.yaml_file import Section, parse_yaml

WORLD = "world"
_SYMMETRIC = 1e-6  # of the larger of two variances
_ROW = "x, y, z, rotation about x, y, z of the world; m^2, m rad, rad^2"


class PlaceError(NamedTuple):
    """``covariance`` (6, 6) of T_world_camera, m and rad about the world's axes; ``by`` says where it is from."""

    covariance: Floats
    by: str


def place_error_of(files: Mapping[str, str], where: str) -> PlaceError | None:
    """What the files of a rig (`Rig.files`) tell of its camera's place; None where they tell nothing.

    Raises InputError with file, key, what was found and what is accepted; ``where`` the files are.
    """
    named = uncertainty_of(files)
    if named is None:
        return None
    name, text = named
    section = parse_yaml(text, f"{where}: {name}")
    return read_place_error(section.section(WORLD)) if WORLD in section else None


def read_place_error(section: Section) -> PlaceError:
    """Of the section `world`. Raises InputError as `place_error_of` does."""
    section.only(("covariance", "position_m", "orientation_rad", "by"))
    by = section.text("by") if "by" in section else "given"
    if "covariance" not in section:
        sigmas = [section.number(key, least=0.0) for key in ("position_m", "orientation_rad")]
        return PlaceError(np.diag(np.repeat(np.square(sigmas), 3)), by)
    section.only(("covariance", "by"))
    rows = section.rows("covariance", 6, _ROW)
    if len(rows) != 6:
        raise section.error("covariance", f"{len(rows)} rows, expected 6 ({_ROW})")
    covariance = np.array(rows)
    spread = np.sqrt(np.abs(np.diag(covariance)))
    uneven = np.abs(covariance - covariance.T) > _SYMMETRIC * np.outer(spread, spread)
    covariance = 0.5 * (covariance + covariance.T)
    if uneven.any() or np.linalg.eigvalsh(_scaled(covariance, spread)).min() < -_SYMMETRIC:
        raise section.error(
            "covariance", f"is no covariance, expected six rows that are symmetric and positive ({_ROW})"
        )
    return PlaceError(covariance, by)


def _scaled(covariance: Floats, spread: Floats) -> Floats:
    """As correlations: m and rad are of unlike size."""
    scale = np.where(spread > 0, spread, 1.0)
    return np.asarray(covariance / np.outer(scale, scale), np.float64)
