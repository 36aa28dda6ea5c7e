"""What the chain says of frames with truth, and how wrong it is: the sample frames and those of `asterism simulate`."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from asterism.protocol.geometry import Floats, Pose, angle_between, log_rotation
from asterism.protocol.rig import Rig, load_rig
from asterism.server import Frame, PoseEstimate, Tracks, localize

FAR_OFF_M = 0.02
TILTED_RAD = np.radians(5.0)


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """One robot in one frame."""

    where: str
    visible: int  # LEDs that are lit, 0 for a robot that is not in the frame
    answer: PoseEstimate | None
    true: Pose | None

    @property
    def error(self) -> Floats:
        """(6,) error of position (m) and rotation vector (rad), parent frame."""
        assert self.answer is not None
        assert self.true is not None
        turned = log_rotation(self.answer.pose.rotation @ self.true.rotation.T)
        return np.concatenate([self.answer.position - self.true.position, turned])

    @property
    def wrong(self) -> bool:
        """A pose of a robot that is not there, or of one that is elsewhere, where its other tilt would be as well."""
        if self.answer is None:
            return False
        if self.true is None:
            return True
        told = [self.answer.position]
        if self.answer.alternative is not None:
            told.append(self.answer.alternative.position)
        return all(bool(np.linalg.norm(position - self.true.position) > FAR_OFF_M) for position in told)

    @property
    def tilted(self) -> bool:
        """The rotation is far off."""
        return self.answer is not None and self.true is not None and bool(np.linalg.norm(self.error[3:]) > TILTED_RAD)

    @property
    def silent_tilt(self) -> bool:
        """The rotation is far off, and neither the alternative nor the covariance says so."""
        if not self.tilted:
            return False
        assert self.answer is not None
        assert self.true is not None
        other = self.answer.alternative
        if other is not None and angle_between(other.pose.rotation, self.true.rotation) < TILTED_RAD:
            return False
        sigma = np.sqrt(np.linalg.eigvalsh(self.answer.covariance[3:, 3:])[-1])
        return bool(np.linalg.norm(self.error[3:]) > 3 * sigma)

    @property
    def nees(self) -> float:
        """Squared error weighted by the covariance: 6 on average where covariances are honest."""
        assert self.answer is not None
        return float(self.error @ np.linalg.solve(self.answer.covariance, self.error))


def truth_of(folder: Path) -> list[dict[str, Any]]:
    """The frames of a folder with their robots: `truth.json` of the samples, `truth.jsonl` of `asterism simulate`."""
    lines = folder / "truth.jsonl"
    if lines.exists():
        return [json.loads(line) for line in lines.read_text().splitlines()]
    listed: list[dict[str, Any]] = json.loads((folder / "truth.json").read_text())
    return listed


def judge(folder: Path, rig: Rig | None = None) -> Iterator[Judged]:
    """Locate every frame of the folder alone, and yield every robot of the rig and every one in view."""
    rig = rig or load_rig(folder / "rig.yaml")
    for entry in truth_of(folder):
        image = cv2.imread(str(folder / "frames" / entry["frame"]), cv2.IMREAD_GRAYSCALE)
        assert image is not None, entry["frame"]
        result, _ = localize(Frame(np.asarray(image, np.uint8), exposed_ns=1, index=0), rig, Tracks.none())
        truth = {robot["id"]: robot for robot in entry["robots"]}
        for robot, answer in result.answers.items():
            seen = truth.get(robot)
            yield Judged(
                f"{folder.name}/{entry['frame']} {robot}",
                seen["visible"] if seen else 0,
                answer if isinstance(answer, PoseEstimate) else None,
                Pose(np.array(seen["position"]), np.array(seen["orientation"])) if seen else None,
            )
