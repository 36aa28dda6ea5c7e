"""Lines of `fuse` beside a truth."""

import json
from pathlib import Path

import numpy as np
import pytest

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Pose, exp_rotation
from asterism.server.budget.budget import Light
from asterism.server.budget.truth import compare
from asterism.server.budget.truth_lines import match_lines, sightings_of_lines
from asterism.server.budget.uncertainty import Uncertainty
from asterism.server.calibration.survey.survey import read_survey
from tests.helpers import assert_poses_close
from tests.several import Drive, facing_pair, rigs_at

RIG = rigs_at(facing_pair(), robots=2)[0]
ROBOTS = [robot.id for robot in RIG.robots]
OFF, TURNED = np.array([1e-4, -2e-4, 3e-4]), np.array([1e-3, 2e-3, -1e-3])
SIGMAS = np.array([1e-4, 2e-4, 3e-4, 1e-3, 2e-3, 1e-3])  # every error is one


def written(path: Path, times_ns: list[int], pose_of: Pose | None, **more: object) -> Path:
    """Lines of all robots where the drive has them, or off by what is given."""
    lines = []
    for time_ns in times_ns:
        robots = []
        for robot, true in Drive(tuple(ROBOTS))(time_ns * 1e-9).items():
            pose = true
            if pose_of is not None:
                pose = Pose.from_matrix(pose_of.rotation @ true.rotation, true.position + pose_of.position)
            told = {"id": robot, "position": pose.position.tolist(), "orientation": pose.orientation.tolist()}
            robots.append(told | more)
        lines.append(json.dumps({"frame": f"left {time_ns}", "exposed_ns": time_ns, "robots": robots, "lost": {}}))
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def fused(tmp_path: Path) -> Path:
    told = {"state": "TRACKED", "covariance": np.diag(SIGMAS**2).ravel().tolist(), "leds": 6, "rms_px": 0.01}
    off = Pose.from_matrix(exp_rotation(TURNED), OFF)
    return written(tmp_path / "fused.jsonl", [0, 5, 10], off, **told, cameras=["left", "right"], alternative=None)


def test_errors_are_told_about_the_axes_of_the_camera_and_weigh_what_the_lines_say(tmp_path: Path, fused: Path) -> None:
    survey = read_survey(written(tmp_path / "truth.jsonl", [0, 5, 7], None, visible={"left": 6}), ROBOTS)
    seen, truth, remarks = match_lines(survey, sightings_of_lines(fused, RIG), str(fused))
    assert len(remarks) == 1
    assert remarks[0].startswith(f"{fused}: 1 of 3 lines are of a time that ")
    found = compare(RIG, seen, truth, Uncertainty(), Light.assumed(RIG.centre))
    assert (len(found.errors), found.lost, found.flips) == (4, 0, 0)
    assert RIG.T_world_camera is not None
    turn = RIG.T_world_camera.rotation.T
    np.testing.assert_allclose(found.errors, np.tile(np.concatenate([turn @ OFF, turn @ TURNED]), (4, 1)), atol=1e-9)
    assert found.nees[1] == pytest.approx(6.0)
    first = seen[0][1][0]
    assert_poses_close(RIG.T_world_camera @ first.pose, Pose.from_matrix(
        exp_rotation(TURNED) @ Drive(tuple(ROBOTS))(0.0)[first.robot].rotation,
        Drive(tuple(ROBOTS))(0.0)[first.robot].position + OFF,
    ))  # fmt: skip


def test_lines_that_cannot_be_compared_are_refused(tmp_path: Path, fused: Path) -> None:
    survey = read_survey(written(tmp_path / "truth.jsonl", [1, 2], None), ROBOTS)
    with pytest.raises(InputError, match=r"none of its lines is of an exposed_ns that .*fused.jsonl has"):
        match_lines(survey, sightings_of_lines(fused, RIG), str(fused))
    bare = written(tmp_path / "bare.jsonl", [0], None)
    with pytest.raises(InputError, match=r"bare.jsonl: line 1: r00: tells no covariance, expected one"):
        sightings_of_lines(bare, RIG)


def test_lines_of_fuse_are_a_truth_too(fused: Path) -> None:
    assert [frame.exposed_ns for frame in read_survey(fused, ROBOTS).frames] == [0, 5, 10]
