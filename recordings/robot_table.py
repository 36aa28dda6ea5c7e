"""The robots of one frame as a table to read: where each is, how it stands, how sure that is."""

from collections.abc import Iterable

import numpy as np

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.geometry import Floats, Pose
from asterism.recordings.states import state_of

_HEAD = (
    "| robot | state | x, mm | y, mm | z, mm | roll, ° | pitch, ° | yaw, ° | LEDs | rms, px |",
    "|---|---|---:|---:|---:|---:|---:|---:|---:|---:|",
)
_CAMERAS = (" by |", "---|")  # only where several are joined


def robot_table(robots: Iterable[tuple["pb.RobotReport", Pose | None, Floats | None]]) -> str:
    """Markdown. For every robot its report, its pose and its roll, pitch, yaw in degrees, None where it has no pose."""
    listed = list(robots)
    reasons = [f"**{report.id}**: {report.reason}\n" for report, _, _ in listed if report.reason]
    reasons += [f"**{report.id}**: {report.surface.reason}\n" for report, _, _ in listed if report.surface.reason]
    reasons += [
        f"**{report.id}**: without {camera}: {why}\n"
        for report, _, _ in listed
        for camera, why in sorted(report.left_out.items())
    ]
    joined = any(report.cameras for report, _, _ in listed)
    head = "".join(f"{line}{column}\n" for line, column in zip(_HEAD, _CAMERAS if joined else ("", ""), strict=True))
    return "\n".join([head + "".join(_row(*robot) for robot in listed), *reasons])


def _row(report: "pb.RobotReport", pose: Pose | None, angles: Floats | None) -> str:
    cameras = f" {', '.join(report.cameras)} |" if report.cameras else ""
    state = state_of(report).replace("_", " ")
    if pose is None or angles is None:
        return f"| **{report.id}** | **{state}** |{' |' * 8}\n"
    numbers = [f"{value:.1f}" for value in np.concatenate([1e3 * pose.position, angles]) + 0.0]
    return f"| **{report.id}** | {state} | {' | '.join(numbers)} | {report.leds} | {report.rms_px:.3f} |{cameras}\n"
