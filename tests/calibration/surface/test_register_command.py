"""`asterism calibrate surface --stl`: a drive on a mould through the command, with its drawing in mm; bad input."""

from pathlib import Path

import numpy as np
import pytest

from asterism.protocol.geometry import Floats
from asterism.protocol.rig import load_rig
from asterism.protocol.surface import Heights
from asterism.server.__main__ import main
from tests.calibration.surface.driven import Driven, bowl, drive
from tests.calibration.surface.test_calibrate_surface import written
from tests.command.test_command_line import refused
from tests.protocol.meshes import binary_stl, sheet

HILLS = np.array([[-0.12, 0.05, 0.010], [0.10, -0.06, 0.014], [0.13, 0.08, -0.008]])  # x, y, height, m
TURN, SHIFT = np.array([[0.0, -1.0], [1.0, 0.0]]), np.array([0.05, -0.02])  # world from drawing


def hilly(xy: Floats) -> tuple[Floats, Floats]:
    """Three hills, with their slopes."""
    z, slopes = bowl(xy)
    for x, y, height in HILLS:
        off = xy - [x, y]
        hill = height * np.exp(-(off**2).sum(axis=1) / (2 * 0.06**2))
        z, slopes = z + hill, slopes - off * hill[:, None] / 0.06**2
    return z, slopes


def drawing(side: str = "+z") -> Floats:
    """Its triangles in the drawing's frame, mm; where +y is up if it is so."""

    def height(x: Floats, y: Floats) -> Floats:
        world = np.stack([x, y], axis=-1) @ TURN.T + SHIFT
        return hilly(world.reshape(-1, 2))[0].reshape(x.shape) - 0.03

    triangles = 1e3 * sheet(height, (81, 101), (0.5, 0.64))
    return triangles[..., [0, 2, 1]] * [1.0, 1.0, -1.0] if side == "+y" else triangles


@pytest.fixture(scope="module")
def driven() -> Driven:
    """Where robots were."""
    return drive(hilly, seconds=30.0, rate_hz=4.0)


@pytest.mark.parametrize("side", ["+z", "+y"])
def test_a_drawing_in_mm_is_registered_and_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], driven: Driven, side: str
) -> None:
    rig, lines = written(tmp_path, driven)
    stl, out = tmp_path / "mould.stl", tmp_path / "rig2.yaml"
    stl.write_bytes(binary_stl(drawing(side)))
    more = ["--as-drawn"] if side == "+y" else []
    command = ["calibrate", "surface", str(rig), str(lines), "--stl", str(stl), "--scale", "0.001", *more]
    assert main([*command, "-o", str(out)]) == 0
    told = capsys.readouterr().out
    assert max(len(line) for line in told.splitlines() if not line.startswith("written")) <= 80
    assert ("its +y up" in told) == (side == "+y")
    assert "warning" not in told
    assert "mould.stl" in out.read_text()
    new = load_rig(out)
    assert new.surface is not None
    assert isinstance(new.surface.shape, Heights)
    xy = np.random.default_rng(1).uniform([-0.2, -0.15], [0.2, 0.15], (500, 2))
    touch = new.surface.touch(np.column_stack([xy, hilly(xy)[0]]))
    assert touch.inside.all()
    assert np.sqrt((touch.distances**2).mean()) < 0.06e-3
    assert (np.abs(touch.distances) < 2.0 * touch.sigmas).mean() > 0.9
    for name in ("rig2.surface.csv", "rig2.surface.png", "rig2.differs.csv"):
        assert f"written: {tmp_path / name}" in told
    assert (tmp_path / "rig2.surface.png").read_bytes().startswith(b"\x89PNG")


def test_bad_input_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str], driven: Driven) -> None:
    rig, lines = written(tmp_path, driven)
    stl, out = tmp_path / "mould.stl", tmp_path / "rig2.yaml"
    stl.write_bytes(binary_stl(drawing()))
    command = ["calibrate", "surface", str(rig), str(lines), "-o", str(out)]
    assert "--stl FILE too" in refused(capsys, *command, "--as-drawn")
    assert "--stl FILE too" in refused(capsys, *command, "--scale", "0.001")
    assert "is it in mm? Then --scale 0.001" in refused(capsys, *command, "--stl", str(stl))
    assert "is it in m already?" in refused(capsys, *command, "--stl", str(stl), "--scale", "1e-6")
    assert "no such file" in refused(capsys, *command, "--stl", str(tmp_path / "none.stl"))
    assert not out.exists()
