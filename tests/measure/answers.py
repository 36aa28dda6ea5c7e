"""Every answer on frames with truth, to be compared before and after a change that must not show in them.

`python -m tests.measure.answers write OUT.jsonl [FOLDER ...]` locates every folder's frames twice, each alone and one
after another; `... compare A.jsonl B.jsonl` says whether states, LEDs, spots, fates and alternatives are equal, and by
how many sigmas (square root of the difference's weighted square) poses, and by what share of their variances
covariances differ; exit code 1 beyond a thousandth. FOLDER as in `accuracy`.
"""

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from asterism.protocol.geometry import Floats, Pose, log_rotation
from asterism.protocol.rig import load_rig
from asterism.server import Frame, PoseEstimate, Tracks, localize
from tests.chain.judging import truth_of
from tests.measure.accuracy import samples

MOST = 1e-3  # sigmas of a pose, and variances of a covariance


def answers_of(folder: Path, independent: bool) -> Iterator[dict[str, Any]]:
    """A line a frame: every robot's state, LEDs, spots, pose, covariance, residuals and alternative; blobs' fates."""
    rig, tracks = load_rig(folder / "rig.yaml"), Tracks.none()
    for index, entry in enumerate(truth_of(folder)):
        image = cv2.imread(str(folder / "frames" / entry["frame"]), cv2.IMREAD_GRAYSCALE)
        assert image is not None, entry["frame"]
        frame = Frame(np.asarray(image, np.uint8), 1 + index * 16_666_667, index)
        result, after = localize(frame, rig, Tracks.none() if independent else tracks)
        tracks = after
        robots: dict[str, Any] = {}
        for robot, answer in result.answers.items():
            if not isinstance(answer, PoseEstimate):
                robots[robot] = {"state": answer.state, "reason": answer.reason}
                continue
            robots[robot] = {
                "state": answer.state,
                "leds": answer.leds,
                "spots": answer.spots,
                "position": answer.position.tolist(),
                "orientation": answer.orientation.tolist(),
                "covariance": answer.covariance.tolist(),
                "alternative": answer.alternative
                and {
                    "position": answer.alternative.position.tolist(),
                    "orientation": answer.alternative.orientation.tolist(),
                },
            }
        how = "alone" if independent else "following"
        yield {
            "frame": f"{folder.name}/{entry['frame']} {how}",
            "robots": robots,
            "fates": result.blobs.fates.tolist(),
        }


def _apart(a: dict[str, Any], b: dict[str, Any], covariance: Floats) -> float:
    """Sigmas between two poses."""
    first = Pose(np.array(a["position"]), np.array(a["orientation"]))
    second = Pose(np.array(b["position"]), np.array(b["orientation"]))
    turned = log_rotation(first.rotation @ second.rotation.T)
    error = np.concatenate([first.position - second.position, turned])
    return float(np.sqrt(max(error @ np.linalg.solve(covariance, error), 0.0)))


class Difference(NamedTuple):
    """What is not equal in two lines; the largest difference of any pose, sigmas, and of any covariance, variances."""

    told: list[str]
    poses: list[float]
    covariances: list[float]


def differences(a: dict[str, Any], b: dict[str, Any]) -> Difference:
    """Compare two lines."""
    told: list[str] = []
    poses: list[float] = []
    covariances: list[float] = []
    if a["frame"] != b["frame"] or a["robots"].keys() != b["robots"].keys():
        return Difference([f"{a['frame']}: other frame or robots"], poses, covariances)
    if a["fates"] != b["fates"]:
        told.append(f"{a['frame']}: the spots' fates differ")
    for robot, before in a["robots"].items():
        after = b["robots"][robot]
        exact = ("state", "reason", "leds", "spots")
        if any(before.get(key) != after.get(key) for key in exact):
            told.append(f"{a['frame']} {robot}: {before['state']} is {after['state']}, or other LEDs")
            continue
        if "position" not in before:
            continue
        covariance = np.array(before["covariance"])
        pairs = [(before, after)]
        if (before["alternative"] is None) != (after["alternative"] is None):
            told.append(f"{a['frame']} {robot}: an alternative came or went")
        elif before["alternative"] is not None:
            pairs.append((before["alternative"], after["alternative"]))
        poses += [_apart(one, other, covariance) for one, other in pairs]
        spread = np.sqrt(np.diag(covariance))
        covariances.append(float(np.abs((np.array(after["covariance"]) - covariance) / np.outer(spread, spread)).max()))
    return Difference(told, poses, covariances)


def compare(before: Path, after: Path) -> int:
    """Print what differs; the exit code."""
    lines = [[json.loads(line) for line in path.read_text().splitlines()] for path in (before, after)]
    if len(lines[0]) != len(lines[1]):
        sys.exit(f"{before} holds {len(lines[0])} frames, {after} {len(lines[1])}")
    found = [differences(a, b) for a, b in zip(*lines, strict=True)]
    told = [text for difference in found for text in difference.told]
    poses = np.array([value for difference in found for value in difference.poses] or [0.0])
    covariances = np.array([value for difference in found for value in difference.covariances] or [0.0])
    print(*told, sep="\n", end="\n" if told else "")
    print(
        f"{len(found)} frames, {len(poses)} poses: {len(told)} states, LEDs, spots or alternatives differ; poses at "
        f"most {poses.max():.1e} sigma apart (99 %: {np.percentile(poses, 99):.1e}), covariances "
        f"{covariances.max():.1e}"
    )
    return int(bool(told) or max(poses.max(), covariances.max()) > MOST)


def write(out: Path, folders: list[Path]) -> int:
    """Locate everything; the exit code."""
    if not folders:
        sys.exit("name folders with rig.yaml, frames/ and their truth")
    with out.open("w") as file:
        for folder in folders:
            for independent in (True, False):
                for line in answers_of(folder, independent):
                    print(json.dumps(line), file=file)
    return 0


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["write", out, *given]:
            sys.exit(write(Path(out), [Path(folder) for folder in given] or samples()))
        case ["compare", before, after]:
            sys.exit(compare(Path(before), Path(after)))
        case _:
            sys.exit(__doc__)
