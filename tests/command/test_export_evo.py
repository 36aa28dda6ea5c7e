"""evo, which nobody here wrote, finds in exported trajectories the error that `asterism report` finds in the film."""

from pathlib import Path

import numpy as np
import pytest

from asterism.protocol.rig import load_rig
from asterism.server.__main__ import main
from asterism.server.budget.budget import Light
from asterism.server.budget.truth import bins_of
from asterism.server.budget.uncertainty import read_uncertainty
from asterism.server.command.report import _compare, _observe
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.sources.open_source import open_source

FRAMES = 12


def test_evo_finds_the_error_that_report_finds(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    film, poses = tmp_path / "film", tmp_path / "poses.jsonl"
    simulated = ("simulate", DEMO_RIG, film, "--hand", "alpha", "--frames", FRAMES)
    located = ("locate", film / "rig.yaml", film / "frames", "--independent", "-o", poses)
    for words in (
        simulated,
        located,
        ("export", poses, "--to", "tum", "-o", tmp_path / "found"),
        ("export", film / "truth.jsonl", "--to", "tum", "-o", tmp_path / "true"),
    ):
        assert main([str(word) for word in (*words, "--quiet")]) == 0, capsys.readouterr().err
    monkeypatch.setenv("HOME", str(tmp_path))  # where evo keeps its settings
    found = _rmse_of_evo(tmp_path / "true" / "alpha.tum", tmp_path / "found" / "alpha.tum")
    assert found == pytest.approx(_rmse_of_report(film), rel=0.01)
    assert 1e-6 < found < 1e-3


def _rmse_of_evo(truth: Path, estimate: Path) -> float:
    """evo_ape tum TRUTH ESTIMATE: RMSE of positions, m, nothing aligned."""
    from evo.core import metrics, sync
    from evo.tools import file_interface

    reference, estimated = (file_interface.read_tum_trajectory_file(str(path)) for path in (truth, estimate))
    assert estimated.num_poses == FRAMES
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data(sync.associate_trajectories(reference, estimated))
    return float(ape.get_statistic(metrics.StatisticsType.rmse))


def _rmse_of_report(film: Path) -> float:
    """Of the table that `asterism report --truth` prints: RMS of x, y and z at all distances together, m."""
    path = film / "rig.yaml"
    rig = load_rig(path)
    source = open_source(str(film / "frames"), rig, lambda _: None)
    uncertainty = read_uncertainty(path, rig.centre, film / "camera.yaml")
    seen = _observe(rig, film / "truth.jsonl", source)
    compared, _ = _compare(rig, seen, uncertainty, Light.assumed(rig.centre))
    assert (compared.flips, compared.lost) == (0, 0), "which report leaves out, and evo does not"
    bins = bins_of(compared)
    counts = np.array([part.count for part in bins])
    squares = np.array([np.square(part.measured[:3]).sum() for part in bins])
    return float(np.sqrt((counts * squares).sum() / counts.sum()))
