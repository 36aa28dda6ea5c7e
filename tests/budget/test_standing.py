"""The surface as a source of the error budget: information beside the light's, by numeric derivatives of a plane."""

import io
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from asterism.protocol.geometry import Floats
from asterism.protocol.rig import Rig
from asterism.server.__main__ import main
from asterism.server.budget.budget import SOURCES, Light, Poses, covariances_of, poses_at, sources_of
from asterism.server.budget.standing import SURFACE_SOURCES
from asterism.server.budget.uncertainty import Uncertainty
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.on_surface import TOOL, rig_on

NOISE = Uncertainty(0.01, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
LIGHT = Light.assumed("edge-model")
SURFACE_M, SURFACE_RAD = 8e-5, np.radians(0.08)


def standing_rig(tilt_known: bool = True) -> Rig:
    rig = rig_on(robots=2, sigma_m=5e-5, tilt_sigma_deg=0.05)
    assert rig.surface is not None
    first = rig.robots[0]
    assert first.stands is not None
    if not tilt_known:
        first = replace(first, stands=replace(first.stands, tilt_sigma_rad=np.inf))
    surface = replace(rig.surface, sigma_m=SURFACE_M, tilt_sigma_rad=SURFACE_RAD)
    return replace(rig, surface=surface, robots=(first, replace(rig.robots[1], stands=None)))


def off_plane(rotation: Floats, t: Floats, step: Floats) -> Floats:
    """How far a pose that moved by ``step`` is off the plane that it stood upright on: m, and two sines."""
    turned = Rotation.from_rotvec(step[3:]).as_matrix() @ rotation
    lifted = rotation[:, 2] @ (turned @ TOOL + t + step[:3] - rotation @ TOOL - t)
    return np.array([lifted, turned[:, 2] @ rotation[:, 0], turned[:, 2] @ rotation[:, 1]])


@pytest.mark.parametrize("tilt_known", [True, False])
def test_light_and_surface_add_up_as_information(tilt_known: bool) -> None:
    rig = standing_rig(tilt_known)
    robot = rig.robots[0]
    poses, _ = poses_at(rig, robot, 1.3, np.array([[640.0, 500.0], [300.0, 200.0]]), (20.0, 45.0))
    told = covariances_of(rig, robot, poses, NOISE, LIGHT)
    light = covariances_of(replace(rig, surface=None), robot, poses, NOISE, LIGHT).sum(axis=1)
    tilt = np.hypot(SURFACE_RAD, np.radians(0.05)) if tilt_known else np.inf
    sigmas = np.array([np.hypot(SURFACE_M, 5e-5), tilt, tilt])
    for k in range(len(poses)):
        columns = [
            (off_plane(poses.rotations[k], poses.ts[k], h) - off_plane(poses.rotations[k], poses.ts[k], -h)) / 2e-6
            for h in 1e-6 * np.eye(6)
        ]
        by_stand = np.stack(columns, axis=-1) / sigmas[:, None]
        expected = np.linalg.inv(np.linalg.inv(light[k]) + by_stand.T @ by_stand)
        scale = np.sqrt(np.diag(expected))
        assert np.abs((told[k].sum(axis=0) - expected) / np.outer(scale, scale)).max() < 1e-4


def test_more_is_not_known_of_a_surface_that_is_worse(rng: np.random.Generator) -> None:
    """z's share moves from the light to the surface as that is known worse, and never beyond the light alone."""
    rig = standing_rig()
    robot = rig.robots[0]
    poses, _ = poses_at(rig, robot, 1.3, np.array([[640.0, 500.0]]), (20.0,))
    assert rig.surface is not None
    before = 0.0
    alone = covariances_of(replace(rig, surface=None), robot, poses, NOISE, LIGHT).sum(axis=1)[0, 2, 2]
    for sigma in (1e-5, 1e-4, 1e-2):
        told = covariances_of(
            replace(rig, surface=replace(rig.surface, sigma_m=sigma, tilt_sigma_rad=0.5)), robot, poses, NOISE, LIGHT
        )
        assert before < told[0, :, 2, 2].sum() < 1.0001 * alone
        before = float(told[0, :, 2, 2].sum())
    assert before == pytest.approx(alone, rel=0.01)


def test_a_robot_that_stands_on_nothing_has_nothing_of_it() -> None:
    rig = standing_rig()
    robot = rig.robots[1]
    poses = Poses(np.diag([1.0, -1.0, -1.0])[None], np.array([[0.0, 0.0, 1.3]]))
    assert sources_of(rig) == (*SOURCES, *SURFACE_SOURCES)
    assert sources_of(replace(rig, surface=None)) == SOURCES
    told = covariances_of(rig, robot, poses, Uncertainty(), LIGHT)
    assert not told[:, len(SOURCES) :].any()
    assert np.array_equal(
        told[:, : len(SOURCES)], covariances_of(replace(rig, surface=None), robot, poses, Uncertainty(), LIGHT)
    )


def test_the_report_has_the_surface_and_what_would_be_without(tmp_path: Path) -> None:
    text = (DEMO_RIG.parent / "rig.yaml").read_text()
    if "surface:" not in text:
        text = text.replace(
            "robots:", "surface: {plane: {point: [0, 0, 0], normal: [0, 0, 1]}, sigma: 5e-5}\nrobots:", 1
        )
        assert "points: {" in text, "expected a robot with a point to stand on"
    (tmp_path / "camera.yaml").write_text((DEMO_RIG.parent / "camera.yaml").read_text())
    (tmp_path / "rig.yaml").write_text(with_stands(text))
    printed = io.StringIO()
    with redirect_stdout(printed):
        assert main(["report", str(tmp_path / "rig.yaml"), "-o", str(tmp_path / "report")]) == 0
    for words in (printed.getvalue(), (tmp_path / "report" / "report.html").read_text()):
        assert "stand on it" in words
        assert "without" in words


def with_stands(text: str) -> str:
    """Every robot stands on the surface with the first of its points."""
    if "stands:" in text:
        return text
    lines = []
    for line in text.splitlines():
        lines.append(line)
        if line.strip().startswith("points: {"):
            point = line.partition("{")[2].partition(":")[0]
            indent = line[: len(line) - len(line.lstrip())]
            lines.append(f"{indent}stands: {{point: {point}, sigma: 0.00005, tilt_sigma_deg: 0.1}}")
    return "\n".join(lines) + "\n"
