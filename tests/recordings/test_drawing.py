"""What a person sees of a recording: entities, units and places, read back from the rerun stream."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol import keys
from asterism.protocol.codec import set_report_pose, to_bytes
from asterism.protocol.event_text import sentence
from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.protocol.messages import EVENT, Message
from asterism.protocol.rig import Rig, Robot, load_rig
from asterism.recordings.drawing import Drawing
from asterism.recordings.layout import blueprint, review_blueprint
from asterism.recordings.plates import RIM, plate_outline, roll_pitch_yaw_deg
from asterism.recordings.png_image import png
from asterism.recordings.reader import Recording
from asterism.recordings.recorder import FramesKept, Recorder
from asterism.server.command.review import write_rrd
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.helpers import random_pose, random_rotation
from tests.protocol import make_golden
from tests.recordings.reloaded import record_reloaded

STEP_NS = 16_666_667
Rows = list[tuple[int | None, Any]]  # of a component: frame (None: static) and value


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig(DEMO_RIG)


def place(k: int, yaw_deg: float = 20.0) -> Pose:
    """T_world_robot of the demo's robot k, on its table."""
    turn = exp_rotation(np.array([0.0, 0.0, np.radians(yaw_deg)])) @ exp_rotation(np.array([0.1, -0.2, 0.0]))
    return Pose.from_matrix(turn, np.array([-0.3 + 0.15 * k, 0.05 * k, 0.03]))


def told(rig: Rig, sequence: int, poses: dict[str, Pose]) -> "pb.FrameReport":
    """A report of robots that are where ``poses`` says, every LED seen 0.01 px right of its place; the others lost."""
    report = pb.FrameReport(sequence=sequence, exposed_ns=10**18 + sequence * STEP_NS)
    assert rig.T_world_camera is not None
    for index, robot in enumerate(rig.robots):
        entry = report.robots.add(id=robot.id, state=pb.LOST, reason="none of its LEDs is seen")
        if robot.id not in poses:
            continue
        entry.state, entry.reason, entry.leds, entry.rms_px = pb.TRACKED, "", 6, 0.01
        set_report_pose(entry.pose, poses[robot.id])
        pixels = rig.camera.project(rig.T_world_camera.inverse().map(poses[robot.id].map(robot.leds)))
        for led, (x, y) in enumerate(pixels):
            entry.led.append(led)
            entry.spot.append(len(report.spots.x))
            entry.residual_x.append(0.01)
            entry.residual_y.append(0.0)
            spot = {
                "x": x + 0.01,
                "y": y,
                "radius": 2.0,
                "fate": pb.LED,
                "robot": index,
                "led": led,
                "brightness": 200.0,
            }
            noise = {"covariance_xx": 1e-4, "covariance_xy": 0.0, "covariance_yy": 1e-4}
            for column, value in (spot | noise).items():
                getattr(report.spots, column).append(value)
    return report


def drawn(rig: Rig, reports: list["pb.FrameReport"], out: Path) -> dict[str, dict[str, Rows]]:
    """Entity -> component -> its rows, in the order of frames."""
    stream = rr.RecordingStream("asterism-test")
    stream.save(out)
    drawing = Drawing(stream, rig)
    for report in reports:
        drawing.report(report)
    stream.flush()
    stream.disconnect()
    return contents(out)


def contents(file: Path) -> dict[str, dict[str, Rows]]:
    """Of a rerun file: entity -> component -> its rows, in the order of frames."""
    found: dict[str, dict[str, Rows]] = {}
    for chunk in rr.chunk.RrdReader(str(file)).stream():
        batch = chunk.to_record_batch()
        names = [name for name in batch.schema.names if ":" in name]
        frames = batch.column("frame").to_pylist() if "frame" in batch.schema.names else [None] * batch.num_rows
        for name in names:
            rows = found.setdefault(str(chunk.entity_path), {}).setdefault(name, [])
            rows += zip(frames, batch.column(name).to_pylist(), strict=True)
    for components in found.values():
        for rows in components.values():
            rows.sort(key=lambda row: -1 if row[0] is None else row[0])
    return found


def everywhere(rig: Rig) -> dict[str, Pose]:
    return {robot.id: place(k) for k, robot in enumerate(rig.robots)}


def inside(edge: Floats, points: Floats) -> Floats:
    """Distance of points (n, 2) from the nearest side of an anticlockwise convex polygon (m, 2); negative outside."""
    along = np.roll(edge, -1, axis=0) - edge
    left = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1)[:, None]
    distances: Floats = ((points[:, None] - edge) * left).sum(axis=-1).min(axis=1)
    return distances


def test_a_plate_reaches_as_far_beyond_every_led(rng: np.random.Generator) -> None:
    for _ in range(20):
        flat = np.column_stack([rng.uniform(-0.05, 0.05, (6, 2)), np.zeros(6)])
        T_robot_plate = random_pose(rng)
        robot = Robot("alpha", T_robot_plate.map(flat), axis=T_robot_plate.rotation[:, 2])
        edge = T_robot_plate.inverse().map(plate_outline(robot))
        np.testing.assert_allclose(edge[:, 2], 0.0, atol=1e-12)
        rim = RIM * robot.extent
        # The circle around an LED is a polygon of sixteen sides.
        assert inside(edge[:, :2], flat[:, :2]).min() >= rim * np.cos(np.pi / 16) - 1e-12
        assert np.linalg.norm(edge[:, None, :2] - flat[:, :2], axis=-1).min(axis=1).max() <= rim + 1e-12


def test_angles_are_those_of_rotations_about_the_fixed_axes(rng: np.random.Generator) -> None:
    for _ in range(50):
        rotation = random_rotation(rng)
        about_x, about_y, about_z = (
            exp_rotation(np.radians(angle) * axis)
            for angle, axis in zip(roll_pitch_yaw_deg(rotation), np.eye(3), strict=True)
        )
        np.testing.assert_allclose(about_z @ about_y @ about_x, rotation, atol=1e-9)
    np.testing.assert_allclose(roll_pitch_yaw_deg(exp_rotation(np.array([0.0, 0.0, np.pi / 6]))), [0, 0, 30], atol=1e-9)


def test_png_keeps_every_pixel(rng: np.random.Generator) -> None:
    image = rng.integers(0, 256, (37, 53)).astype(np.uint8)
    np.testing.assert_array_equal(cv2.imdecode(np.frombuffer(png(image), np.uint8), cv2.IMREAD_UNCHANGED), image)


def test_plates_are_drawn_where_the_leds_are(rig: Rig, tmp_path: Path) -> None:
    poses = everywhere(rig)
    entities = drawn(rig, [told(rig, 0, poses)], tmp_path / "x.rrd")
    overlay = entities["/world/camera/image/plates"]
    assert overlay["LineStrips2D:labels"] == [(0, [robot.id for robot in rig.robots])]
    assert rig.T_world_camera is not None
    for robot, edge in zip(rig.robots, overlay["LineStrips2D:strips"][0][1], strict=True):
        pixels = rig.camera.project(rig.T_world_camera.inverse().map(poses[robot.id].map(robot.leds))) + 0.5
        outline = np.array(edge, np.float32)
        assert all(cv2.pointPolygonTest(outline, pixel.tolist(), True) > 5.0 for pixel in pixels)
        own = entities[f"/world/robots/{robot.id}"]
        np.testing.assert_allclose(own["Transform3D:translation"][0][1][0], poses[robot.id].position, atol=1e-6)
        np.testing.assert_allclose(own["Transform3D:quaternion"][0][1][0], poses[robot.id].orientation, atol=1e-6)
        assert own["TransformAxes3D:axis_length"][0][1][0] == pytest.approx(0.8 * robot.extent)
        mesh = entities[f"/world/robots/{robot.id}/plate"]["Mesh3D:vertex_positions"][0][1]
        np.testing.assert_allclose(mesh, plate_outline(robot), atol=1e-7)
        assert entities[f"/world/robots/{robot.id}/name"]["Points3D:labels"] == [(0, [robot.id])]


def test_residuals_begin_at_their_spots(rig: Rig, tmp_path: Path) -> None:
    report = told(rig, 0, everywhere(rig))
    entities = drawn(rig, [report], tmp_path / "x.rrd")["/world/camera/image/residuals"]
    spots = np.column_stack([report.spots.x, report.spots.y])
    np.testing.assert_allclose(entities["Arrows2D:origins"][0][1], spots + 0.5, atol=1e-3)
    np.testing.assert_allclose(entities["Arrows2D:vectors"][0][1], np.tile([5.0, 0.0], (len(spots), 1)), atol=1e-4)


def test_a_robot_that_is_lost_is_drawn_nowhere_and_its_lines_break(rig: Rig, tmp_path: Path) -> None:
    poses = everywhere(rig)
    without = {robot: pose for robot, pose in poses.items() if robot != "bravo"}
    reports = [told(rig, k, without if k == 1 else poses) for k in range(3)]
    entities = drawn(rig, reports, tmp_path / "x.rrd")
    bravo = entities["/world/robots/bravo"]
    assert [scale for _, scale in bravo["Transform3D:scale"]] == [[[1.0] * 3], [[0.0] * 3], [[1.0] * 3]]
    assert [frame for frame, _ in entities["/world/robots/bravo/name"]["Clear:is_recursive"]] == [1]
    for plot in ("position", "angles", "residual"):
        assert entities[f"/plots/{plot}/bravo"]["Clear:is_recursive"] == [(1, [True])]
    assert [frame for frame, _ in entities["/plots/position/bravo/x"]["Scalars:scalars"]] == [0, 2]
    states = [(frame, state) for frame, (state,) in entities["/states/bravo"]["StateChange:state"]]
    assert states == [(0, "TRACKED"), (1, "LOST"), (2, "TRACKED")]
    assert "bravo" not in entities["/world/camera/image/names"]["Points2D:labels"][1][1]
    table = entities["/robots"]["TextDocument:text"][1][1][0]
    assert "| **bravo** | **LOST** |" in table
    assert "**bravo**: none of its LEDs is seen" in table
    assert "| **alpha** | TRACKED | -300.0 | 0.0 | 30.0 | " in table


def test_both_tilts_of_an_ambiguous_plate_are_drawn(rig: Rig, tmp_path: Path) -> None:
    reports = [told(rig, k, everywhere(rig)) for k in range(2)]
    other = Pose.from_matrix(exp_rotation(np.array([0.4, 0.0, 0.0])), place(0).position)
    reports[0].robots[0].state = pb.TILT_AMBIGUOUS
    set_report_pose(reports[0].robots[0].alternative.pose, other)
    reports[0].robots[0].alternative.odds = 2.5
    entities = drawn(rig, reports, tmp_path / "x.rrd")
    second = entities["/world/alternatives/alpha"]
    edge = other.map(plate_outline(rig.robot("alpha")))
    np.testing.assert_allclose(second["LineStrips3D:strips"][0][1][0][:-1], edge, atol=1e-6)
    assert second["LineStrips3D:labels"][0] == (0, ["or alpha so, 2.5 times less likely"])
    assert [frame for frame, _ in second["Clear:is_recursive"]] == [1]
    names = [label for _, (label,) in entities["/world/robots/alpha/name"]["Points3D:labels"]]
    assert names == ["alpha: TILT AMBIGUOUS", "alpha"]


def test_no_line_is_drawn_across_a_full_turn(rig: Rig, tmp_path: Path) -> None:
    reports = [told(rig, k, {"alpha": place(0, yaw_deg)}) for k, yaw_deg in enumerate((170.0, 178.0, 186.0, 194.0))]
    yaw = drawn(rig, reports, tmp_path / "x.rrd")["/plots/angles/alpha/yaw"]
    assert [frame for frame, _ in yaw["Clear:is_recursive"]] == [2]
    values = {frame: value for frame, (value,) in yaw["Scalars:scalars"]}
    assert values[1] - values[0] == pytest.approx(8.0, abs=1e-6)
    assert values[3] - values[1] == pytest.approx(16.0 - 360.0, abs=1e-6)


def test_without_a_world_angles_are_those_of_a_plate_that_faces_the_camera(rig: Rig, tmp_path: Path) -> None:
    alone = replace(rig, T_world_camera=None)
    report = pb.FrameReport(sequence=0, exposed_ns=10**18)
    entry = report.robots.add(id="alpha", state=pb.TRACKED)
    # The camera looks along +z, so that a plate which faces it is turned by half a turn about x.
    set_report_pose(entry.pose, Pose.from_matrix(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1.2])))
    entities = drawn(alone, [report], tmp_path / "x.rrd")
    for angle in ("roll", "pitch", "yaw"):
        ((_, (value,)),) = entities[f"/plots/angles/alpha/{angle}"]["Scalars:scalars"]
        assert value == pytest.approx(0.0, abs=1e-9)
    assert "/world/origin" not in entities


def views(part: Any) -> Iterator[rrb.View]:
    if isinstance(part, rrb.View):
        yield part
        return
    for inner in part.contents:
        yield from views(inner)


def test_every_view_shows_what_is_logged_and_names_its_unit(rig: Rig, tmp_path: Path) -> None:
    entities = drawn(rig, [told(rig, 0, everywhere(rig))], tmp_path / "x.rrd")
    shown = list(views(blueprint(rig).root_container))
    for view in shown:
        assert any(f"{entity}/".startswith(f"/{view.origin}/") for entity in entities), view.origin
    plots = [view for view in shown if isinstance(view, rrb.TimeSeriesView)]
    assert len(plots) == 8 * len(rig.robots)
    for view in plots:
        assert str(view.name).rpartition(", ")[2] in ("m", "deg", "px", "ms")
        lines = [own["SeriesLines:names"][0][1][0] for path, own in entities.items() if f"/{view.origin}" in path]
        assert lines
        assert {line.rpartition(", ")[2] for line in lines} == {str(view.name).rpartition(", ")[2]}
        # One line needs no legend; two are told apart by their colours.
        assert len(lines) == (2 if view.origin == "plots/latency" else 1)


def test_events_are_written_down_as_sentences_in_a_review(tmp_path: Path) -> None:
    rig, happened = load_rig(DEMO_RIG), make_golden.event()
    recorder = Recorder(tmp_path, rig, "test", FramesKept(0), wait=True)
    message = Message(keys.event("demo"), EVENT, to_bytes(happened), happened.since_ns, happened.since_ns, 42)
    recorder.write([message], None, message.log_ns, 42)
    recorder.close({})
    write_rrd(Recording(recorder.folder), tmp_path / "out.rrd")
    logged = contents(tmp_path / "out.rrd")["/events"]
    assert logged["TextLog:text"] == [(42, [sentence(happened)])]
    assert logged["TextLog:level"] == [(42, ["WARN"])]
    assert "events" in {str(view.origin) for view in views(review_blueprint(rig).root_container)}


def test_a_robot_that_joined_by_a_reload_is_drawn_and_one_that_left_is_not(tmp_path: Path) -> None:
    """The recording goes on with the rig that is read again; what is drawn follows it."""
    recording = record_reloaded(tmp_path, lambda rig, sequence: told(rig, sequence, everywhere(rig)))
    write_rrd(recording, tmp_path / "out.rrd")
    entities = contents(tmp_path / "out.rrd")
    placed = {
        robot: [frame for frame, _ in rows]
        for robot in ("alpha", "bravo", "echo", "zulu")
        for name, rows in entities[f"/world/robots/{robot}"].items()
        if name.endswith("translation")
    }
    assert placed == {"alpha": [1, 2], "bravo": [1, 2, 3, 4], "echo": [3, 4], "zulu": [3, 4]}
    assert any("clear" in name.lower() for name in entities["/world/robots/alpha"])


def test_a_robot_that_another_rig_has_is_left_out(rig: Rig, tmp_path: Path) -> None:
    """A recording goes on when the server's rig is read again, with whoever is in it then."""
    report = told(rig, 0, everywhere(rig))
    before = drawn(rig, [report], tmp_path / "before.rrd")
    report.robots.add().CopyFrom(report.robots[0])
    report.robots[-1].id = "zulu"
    assert drawn(rig, [report], tmp_path / "after.rrd").keys() == before.keys()
