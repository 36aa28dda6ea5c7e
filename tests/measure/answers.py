"""Every answer on frames with truth, to be compared before and after a change that must not show in them.

`python -m tests.measure.answers write OUT.jsonl [FOLDER ...]` locates every folder's frames twice, each alone and one
after another; `... compare A.jsonl B.jsonl` says whether states, LEDs and alternatives are equal, and by how many
sigmas (square root of the difference's weighted square) poses differ, and ends with exit code 1 where they are not
the same to a millionth of a sigma. FOLDER as in `accuracy`.
"""

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from asterism.protocol.geometry import Floats, Pose, log_rotation
from asterism.protocol.rig import load_rig
from asterism.server import Frame, PoseEstimate, Tracks, localize
from tests.chain.judging import truth_of
from tests.measure.accuracy import samples

MOST_SIGMAS = 1e-6


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


def differences(a: dict[str, Any], b: dict[str, Any]) -> tuple[list[str], float, int]:
    """What is not equal in two lines, the most sigmas any pose is off, and how many poses were compared."""
    told, most, poses = [], 0.0, 0
    if a["frame"] != b["frame"] or a["robots"].keys() != b["robots"].keys():
        return [f"{a['frame']}: other frame or robots"], most, poses
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
        for one, other in pairs:
            most, poses = max(most, _apart(one, other, covariance)), poses + 1
        spread = np.sqrt(np.diag(covariance))
        changed = float(np.abs((np.array(after["covariance"]) - covariance) / np.outer(spread, spread)).max())
        if changed > MOST_SIGMAS:
            told.append(f"{a['frame']} {robot}: its covariance differs by {changed:.1g} of its variances")
    return told, most, poses


def compare(before: Path, after: Path) -> int:
    """Print what differs; the exit code."""
    lines = [[json.loads(line) for line in path.read_text().splitlines()] for path in (before, after)]
    told, most, poses = [], 0.0, 0
    if len(lines[0]) != len(lines[1]):
        told.append(f"{len(lines[0])} frames and {len(lines[1])}")
    for a, b in zip(*lines, strict=False):
        more, sigmas, count = differences(a, b)
        told, most, poses = told + more, max(most, sigmas), poses + count
    print(*told, sep="\n", end="\n" if told else "")
    print(f"{len(lines[0])} frames, {poses} poses: {len(told)} differences; poses at most {most:.2g} sigma apart")
    return int(bool(told) or most > MOST_SIGMAS)


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
