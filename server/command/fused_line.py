"""One line of `asterism fuse`'s output, and what all of them come to in the end."""

from collections import Counter, defaultdict
from typing import Any

from asterism.protocol.geometry import Pose
from asterism.server.fusing.fused import Fused, FusedPose
from asterism.server.fusing.offline import Exposure

MOST_REASONS = 2  # told of a robot that was lost


def fused_line(exposure: Exposure) -> dict[str, Any]:
    """As a line of locate, with the cameras that each pose rests on, and those that were left out; its frame is the
    number of each camera's frame.
    """
    fused = exposure.fused
    located = {robot: answer for robot, answer in fused.answers.items() if isinstance(answer, FusedPose)}
    told: dict[str, Any] = {
        "frame": ", ".join(f"{camera} {number}" for camera, number in exposure.frames.items()),
        "exposed_ns": fused.exposed_ns,
        "robots": [_robot(robot, answer) for robot, answer in located.items()],
        "lost": {robot: answer.reason for robot, answer in fused.answers.items() if not isinstance(answer, FusedPose)},
    }
    if left_out := left_out_of(fused):
        told["left_out"] = left_out
    return told


def left_out_of(fused: Fused) -> dict[str, str]:
    """Why each camera is left out that is, with the robots that it is left out for."""
    whys: dict[str, list[str]] = defaultdict(list)
    for robot, answer in fused.answers.items():
        if isinstance(answer, FusedPose):
            for camera, why in answer.left_out.items():
                whys[camera].append(f"{robot}: {why}")
    return {camera: "; ".join(whys[camera]) for camera in sorted(whys)}


def _robot(robot: str, answer: FusedPose) -> dict[str, Any]:
    alternative = answer.alternative
    return {
        "id": robot,
        "state": answer.state,
        **_pose(answer.pose),
        "covariance": answer.covariance.ravel().tolist(),
        "leds": answer.leds,
        "rms_px": answer.rms_px,
        "alternative": None if alternative is None else {**_pose(alternative.pose), "odds": alternative.odds},
        "cameras": list(answer.cameras),
    }


def _pose(pose: Pose) -> dict[str, list[float]]:
    return {"position": pose.position.tolist(), "orientation": pose.orientation.tolist()}


class FusedTally:
    """Counts, robot by robot: states, the cameras that poses rest on, those left out."""

    def __init__(self) -> None:
        self.exposures = 0
        self._states: dict[str, Counter[str]] = {}
        self._cameras: dict[str, Counter[tuple[str, ...]]] = defaultdict(Counter)
        self._reasons: dict[str, Counter[str]] = defaultdict(Counter)
        self._left_out: dict[tuple[str, str], tuple[int, str]] = {}

    @property
    def located(self) -> bool:
        """Whether any robot was."""
        return any(self._cameras.values())

    def add(self, fused: Fused) -> None:
        """Count one exposure."""
        self.exposures += 1
        for robot, answer in fused.answers.items():
            self._states.setdefault(robot, Counter())[answer.state] += 1
            if not isinstance(answer, FusedPose):
                self._reasons[robot][answer.reason] += 1
                continue
            self._cameras[robot][answer.cameras] += 1
            for camera, why in answer.left_out.items():
                count, _ = self._left_out.get((robot, camera), (0, ""))
                self._left_out[robot, camera] = count + 1, why

    def summary(self) -> list[str]:
        """A line for each robot, and one for each camera that was left out."""
        width = max(map(len, self._states), default=0)
        lines = []
        for robot, states in self._states.items():
            told = ", ".join(f"{count} {state}" for state, count in sorted(states.items(), reverse=True))
            lines.append(f"{robot:<{width}}  {told}{self._resting_on(robot)}{self._lost(robot)}")
        return lines + [
            f"left out: {camera} for {robot} in {count} exposures, in the last because: {why}"
            for (robot, camera), (count, why) in sorted(self._left_out.items())
        ]

    def _resting_on(self, robot: str) -> str:
        told = [f"{count} by {' + '.join(cameras)}" for cameras, count in self._cameras[robot].most_common()]
        return f"; {', '.join(told)}" if told else ""

    def _lost(self, robot: str) -> str:
        told = [f"{count} times: {reason}" for reason, count in self._reasons[robot].most_common(MOST_REASONS)]
        return f"; {'; '.join(told)}" if told else ""
