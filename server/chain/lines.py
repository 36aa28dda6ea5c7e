"""What `locate` and `batch` write: a line of JSON for every frame, smoothed where that was asked for."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from asterism.protocol.geometry import Pose
from asterism.protocol.messages import Velocity
from asterism.protocol.rig import Rig
from asterism.protocol.standing import surface_as_json
from asterism.server.chain.frame import Frame, FrameResult
from asterism.server.chain.report import surface_report
from asterism.server.chain.smooth import Motions, SmoothedPose, smooth
from asterism.server.chain.smooth_both import smooth_both
from asterism.server.pose.solve import PoseEstimate

BOTH_WAYS = "both"  # of `--smooth`
NO_IMAGE = np.empty((0, 0), np.uint8)


def smoothed(
    located: Iterator[tuple[Frame, FrameResult]], rig: Rig, way: str | None
) -> Iterator[tuple[Frame, FrameResult]]:
    """Results with their poses joined to those before (``way`` forward), to those after as well (both), or as they are
    (None).
    """
    if way is None:
        yield from located
    elif way == BOTH_WAYS:
        # Frames wait for some seconds: without their images.
        light = ((replace(frame, image=NO_IMAGE), result) for frame, result in located)
        yield from smooth_both(light, rig)
    else:
        motions = Motions.none()
        for frame, result in located:
            joined, motions = smooth(result, motions, rig)
            yield frame, joined


def line(frame: Frame, result: FrameResult) -> dict[str, Any]:
    """One line of output: the frame, every located robot, every lost one with its reason."""
    robots, lost = [], {}
    for robot, answer in result.answers.items():
        if not isinstance(answer, PoseEstimate):
            lost[robot] = answer.reason
            continue
        alternative = None
        if answer.alternative is not None:
            alternative = {**_pose(answer.alternative.pose), "odds": answer.alternative.odds}
        told: dict[str, Any] = {
            "id": robot,
            "state": answer.state,
            **_pose(answer.pose),
            "covariance": answer.covariance.ravel().tolist(),
            "leds": len(answer.leds),
            "rms_px": answer.rms_px,
            "alternative": alternative,
        }
        if answer.smoothed_by:
            told |= {"smoothed": True, "filter": answer.smoothed_by}
        if isinstance(answer, SmoothedPose) and answer.velocity is not None:
            told["velocity"] = _velocity(answer.velocity)
        if answer.extrapolated:
            told["extrapolated"] = True
        if answer.surface is not None:
            told["surface"] = surface_as_json(surface_report(answer.surface))
        robots.append(told)
    return {"frame": frame.name, "exposed_ns": frame.exposed_ns, "robots": robots, "lost": lost}


def _pose(pose: Pose) -> dict[str, list[float]]:
    return {"position": pose.position.tolist(), "orientation": pose.orientation.tolist()}


def _velocity(velocity: Velocity) -> dict[str, list[float]]:
    """In the robot's own frame, m/s and rad/s."""
    return {
        "linear": velocity.linear.tolist(),
        "angular": velocity.angular.tolist(),
        "covariance": velocity.covariance.ravel().tolist(),
    }
