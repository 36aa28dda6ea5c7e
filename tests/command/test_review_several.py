"""`asterism review` of several cameras, read back from the rerun file."""

import json
from pathlib import Path

import numpy as np
import pytest
import rerun as rr

from asterism.protocol.rig import load_rig
from asterism.recordings.entities import JOINED, beside_joined, by_itself
from asterism.recordings.layout_several import several_blueprint
from asterism.server.__main__ import main
from tests.command.test_command_line import refused
from tests.command.test_fuse_recordings import films, recorded
from tests.recordings.test_drawing import contents, views

__all__ = ["films", "recorded"]
PLACE = "Transform3D:translation"


def reviewed(out: Path, *recordings: Path) -> Path:
    assert main(["review", *map(str, recordings), "-o", str(out)]) == 0
    return out


def times_of(file: Path) -> set[str]:
    return {name for chunk in rr.chunk.RrdReader(str(file)).stream() for name in chunk.to_record_batch().schema.names}


def test_what_is_joined_is_drawn_once_and_every_camera_stands_in_its_place(
    films: Path, recorded: Path, tmp_path: Path
) -> None:
    lines = tmp_path / "fused.jsonl"
    assert main(["fuse", str(recorded), "-o", str(lines), "--record", str(tmp_path)]) == 0
    fused = next(tmp_path.glob("fused-*"))
    found = contents(reviewed(tmp_path / "x.rrd", recorded, fused))
    for camera in ("left", "right"):
        place = load_rig(films / f"{camera}.yaml").T_world_camera
        assert place is not None
        np.testing.assert_allclose(found[f"/world/cameras/{camera}"][PLACE][0][1][0], place.position, atol=1e-6)
        assert len(found[f"/world/cameras/{camera}/image/plates"]["LineStrips2D:strips"]) == 6
    drawn = [row[0] for _, row in found["/world/robots/r00"][PLACE]]
    told = [json.loads(line)["robots"][0]["position"] for line in lines.read_text().splitlines()]
    np.testing.assert_allclose(np.sort(drawn, axis=0), np.sort(told, axis=0), atol=1e-6)
    assert "| left, right |" in "".join(str(row) for _, row in found["/robots"]["TextDocument:text"])
    assert not [entity for entity in found if entity.startswith("/world/by") or entity == "/world/camera"]
    assert {"exposed"} == times_of(tmp_path / "x.rrd") & {"exposed", "frame"}
    alone = contents(reviewed(tmp_path / "y.rrd", fused))  # there is no camera to draw
    assert "/world/robots/r00" in alone
    assert not [entity for entity in alone if "camera" in entity]


def test_where_nobody_joined_them_each_camera_tells_of_the_robots(recorded: Path, tmp_path: Path) -> None:
    found = contents(reviewed(tmp_path / "x.rrd", recorded))
    for camera in ("left", "right"):
        assert len(found[f"/world/by/{camera}/robots/r00"][PLACE]) == 6
        assert len(found[f"/{camera}/plots/position/r00/x"]["Scalars:scalars"]) == 6
        assert found[f"/world/by/{camera}/robots/r00/name"]["Points3D:labels"][0][1] == [f"r00, {camera}"]
    assert "/world/robots/r00" not in found


def test_every_view_shows_something(films: Path, recorded: Path, tmp_path: Path) -> None:
    rigs = [load_rig(films / f"{camera}.yaml") for camera in ("left", "right")]
    apart = several_blueprint([(rig, by_itself(rig.camera.name, k)) for k, rig in enumerate(rigs)])
    joined = several_blueprint([*((rig, beside_joined(rig.camera.name)) for rig in rigs), (rigs[0], JOINED)])
    drawn = contents(reviewed(tmp_path / "x.rrd", recorded))
    for layout, origins in (
        (apart, {"left/robots", "right/robots", "left/states", "right/states"}),
        (joined, {"robots", "states"}),
    ):
        shown = {str(view.origin) for view in views(layout.root_container)}
        common = {"world", "events", "/", "world/cameras/left/image", "world/cameras/right/image"}
        assert shown == common | origins
    assert all(any(entity.startswith(f"/{origin}") for entity in drawn) for origin in ("left/robots", "world/cameras"))


def test_a_camera_without_a_place_is_refused(
    films: Path, recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (films / "left.yaml").read_text()
    (films / "lone.yaml").write_text("".join(line for line in text.splitlines(True) if not line.startswith("world:")))
    assert main(["locate", str(films / "lone.yaml"), str(films / "film-left"), "--record", str(tmp_path)]) == 0
    capsys.readouterr()
    right = next(recorded.glob("right-*"))
    told = refused(capsys, "review", right, next(tmp_path.glob("left-*")), "-o", tmp_path / "x.rrd")
    assert "its rig has no `world`, expected where its camera stands, to show it beside others" in told
