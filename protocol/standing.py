"""How a robot stands on the surface, as lines of JSON have it: of `locate`, `fuse` and `watch --json` the same."""

import math
from typing import Any

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.messages import Standing


def surface_as_json(told: "pb.OnSurface") -> dict[str, Any]:
    """Numbers are None where there is no surface to measure from; `without` is None where the surface was not used."""
    without = None
    if told.HasField("without"):
        other = told.without_alternative if told.HasField("without_alternative") else None
        without = {
            **_pose(told.without),
            "covariance": list(told.without_covariance),
            "alternative": None if other is None else {**_pose(other.pose), "odds": other.odds},
        }
    return {
        "standing": standing_name(told.standing),
        "off_m": _number(told.off_m),
        "off_sigma_m": _number(told.off_sigma_m),
        "tilt_off_rad": _number(told.tilt_off_rad),
        "tilt_off_sigma_rad": _number(told.tilt_off_sigma_rad),
        "reason": told.reason,
        "without": without,
    }


def standing_name(standing: int) -> str:
    """Its name; the number of one that a later version may have added."""
    return Standing.Name(standing) if standing in Standing.values() else str(standing)


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _pose(pose: "pb.Pose") -> dict[str, list[float]]:
    p, q = pose.position, pose.orientation
    return {"position": [p.x, p.y, p.z], "orientation": [q.x, q.y, q.z, q.w]}
