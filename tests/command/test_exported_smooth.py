"""Recordings' frames smoothed forwards and backwards for export: what is told, and what is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import quat_from_matrix
from asterism.protocol.rig import load_rig
from asterism.recordings.export.frames import ExportedFrame, ExportedRobot
from asterism.server.chain.smooth_both import BOTH
from asterism.server.command.exported_smooth import smoothed_frames
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.chain.drives import covariances_of, drawn, drives
from tests.command.test_command_line import refused

RIG = load_rig(DEMO_RIG)
RIGS = [(0, RIG)]
ROBOT, MISSING = RIG.robots[0].id, RIG.robots[1].id
WHERE = Path("recording")


def frames_of(rng: np.random.Generator) -> tuple[list[ExportedFrame], np.ndarray]:  # type: ignore[type-arg]
    """One robot on a drive, another that is lost; and where the first was."""
    told = drives(rng, 1, 2.0, 30.0)
    covariances = covariances_of(told.positions, told.rotations, 0.02)
    positions, rotations = drawn(rng, told.positions, told.rotations, covariances)
    frames = [
        ExportedFrame(
            str(k), k, 1 + round(k * told.dt * 1e9), 5, "world",
            (
                ExportedRobot(
                    ROBOT, "TRACKED",
                    position=tuple(positions[k, 0].tolist()),
                    orientation=tuple(quat_from_matrix(rotations[k, 0]).tolist()),
                    covariance=tuple(covariances[k, 0].ravel().tolist()),
                    leds=6, residuals_px=dict.fromkeys(range(6), (0.0, 0.0)), spots_px2=4e-4, misfit_m=0.0,
                ),
                ExportedRobot(MISSING, "LOST", "none of its LEDs is visible"),
            ),
        )
        for k in range(len(positions))
    ]  # fmt: skip
    return frames, told.positions[:, 0]


def test_poses_are_nearer_the_truth_labelled_and_have_velocities(rng: np.random.Generator) -> None:
    frames, true = frames_of(rng)
    told = list(smoothed_frames(frames, RIGS, WHERE))
    assert [frame.sequence for frame in told] == list(range(len(frames)))
    before, after = (np.array([frame.robots[0].position for frame in part]) - true for part in (frames, told))
    assert np.sqrt(np.mean(after**2)) < 0.7 * np.sqrt(np.mean(before**2))
    for frame, was in zip(told, frames, strict=True):
        assert (frame.robots[0].smoothed_by, frame.robots[1]) == (BOTH, was.robots[1])
        assert frame.robots[0].velocity is not None
        assert frame.robots[0].residuals_px == was.robots[0].residuals_px


def test_errors_of_leds_are_not_averaged_away(rng: np.random.Generator) -> None:
    frames, _ = frames_of(rng)
    wrong = [replace(f, robots=(replace(f.robots[0], misfit_m=1e-4), f.robots[1])) for f in frames]
    for plain, kept in zip(smoothed_frames(frames, RIGS, WHERE), smoothed_frames(wrong, RIGS, WHERE), strict=True):
        spreads = [np.array(frame.robots[0].covariance).reshape(6, 6) for frame in (plain, kept)]
        assert np.trace(spreads[0][:3, :3]) < np.trace(spreads[1][:3, :3])
        told = np.array(wrong[0].robots[0].covariance).reshape(6, 6)
        assert np.trace(spreads[1][:3, :3]) > 0.5 * np.trace(told[:3, :3])


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"smoothed_by": "a filter"}, rf"recording: frame 3: {ROBOT} is smoothed already \(a filter\)"),
        ({"id": "zulu"}, "recording: frame 3: zulu is not in the rig"),
        ({"covariance": None}, rf"recording: frame 3: {ROBOT}: a covariance that is none"),
        ({"covariance": (0.0,) * 36}, rf"recording: frame 3: {ROBOT}: a covariance that is none"),
        ({"covariance": (float("nan"),) * 36}, rf"recording: frame 3: {ROBOT}: a covariance that is none"),
    ],
)
def test_what_cannot_be_smoothed_is_said(rng: np.random.Generator, changes: dict[str, object], said: str) -> None:
    frames, _ = frames_of(rng)
    frames[3] = replace(frames[3], robots=(replace(frames[3].robots[0], **changes),))
    with pytest.raises(InputError, match=said):
        list(smoothed_frames(frames, RIGS, WHERE))


def test_lines_tell_too_little(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "poses.jsonl").write_text("")
    told = refused(
        capsys, "export", tmp_path / "poses.jsonl", "--to", "csv", "-o", tmp_path / "out", "--smooth", "both"
    )
    assert "--smooth: only a recording tells what smoothing has to know" in told
