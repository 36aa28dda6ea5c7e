"""Simulated robots on their rig's surface: they touch it, upright, within its edge, each in a part of its own."""

from dataclasses import replace

import numpy as np
import pytest

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.protocol.rig import Rig, load_rig
from asterism.protocol.surface import Heights, Quadric, Surface
from asterism.server.simulation.demo_rig import DEMO_RIG, DEMO_WORKPIECE
from asterism.server.simulation.drive import CLEARANCE
from asterism.server.simulation.ground import Workpiece
from asterism.server.simulation.shared_floor import check_shared
from asterism.server.simulation.simulate import Scene
from asterism.server.simulation.surface_part import part_of
from asterism.server.simulation.work import Lanes, Lift, Work
from tests.on_surface import BENT, TOOL, rig_on, stood
from tests.several import looking_at

TIMES = (0.0, 7.25, 41.5, 1_800_000_000.125)
AWAY = Pose.from_matrix(exp_rotation(np.array([0.3, -0.2, 0.5])), np.array([0.2, -0.1, 0.15]))

TILTED = Surface(Quadric.plane(np.zeros(3), np.array([0.0, 0.1, 1.0])))


def poses(rig: Rig, scene: Scene, time_s: float) -> list[Pose]:
    """T_world_robot of every robot."""
    assert rig.T_world_camera is not None
    return [rig.T_world_camera @ entry.T_camera_robot for entry in scene.truth(0, time_s)]


def tools(rig: Rig, scene: Scene, times: Floats) -> Floats:
    """Where tools are in the surface's frame, (times, robots, 3)."""
    assert rig.surface is not None
    T_surface_world = rig.surface.T_world_surface.inverse()
    return np.array([[T_surface_world.map(pose.map(TOOL)) for pose in poses(rig, scene, float(t))] for t in times])


@pytest.mark.parametrize("frame", [Pose.identity(), AWAY], ids=["as the world", "away"])
def test_who_stands_has_its_point_on_the_surface_and_is_upright_there(frame: Pose) -> None:
    rig = rig_on(replace(BENT, T_world_surface=frame))
    scene = Scene(rig, 2)
    for time_s in TIMES:
        for pose in poses(rig, scene, time_s):
            x, y, _ = frame.inverse().map(pose.map(TOOL))
            expected = stood(replace(BENT, T_world_surface=frame), x, y, 0.0)
            np.testing.assert_allclose(pose.map(TOOL), expected.map(TOOL), atol=1e-9)
            np.testing.assert_allclose(pose.rotation[:, 2], expected.rotation[:, 2], atol=1e-8)


def test_an_axis_and_a_point_of_its_own_are_those_that_stand() -> None:
    rig = rig_on(robots=2)
    axis = np.array([0.6, 0.0, 0.8])
    stands = [replace(robot.stands, axis=axis) for robot in rig.robots if robot.stands is not None]
    point = np.array([0.02, 0.01, -0.04])
    robots = [replace(r, stands=s, points={"tool": point}) for r, s in zip(rig.robots, stands, strict=True)]
    rig = replace(rig, robots=tuple(robots))
    for pose in poses(rig, Scene(rig, 2), 3.0):
        touch = BENT.touch(pose.map(point))
        assert abs(touch.distances[0]) < 1e-9
        np.testing.assert_allclose(pose.rotation @ axis, touch.normals[0], atol=1e-9)


def test_who_does_not_stand_is_above_it_as_on_any_table() -> None:
    rig = rig_on(robots=2)
    rig = replace(rig, robots=(rig.robots[0], replace(rig.robots[1], stands=None)))
    robot, pose = rig.robots[1], poses(rig, Scene(rig, 2), 3.0)[1]
    leds = BENT.touch((pose @ robot.T_robot_plane).map(np.zeros(3)))
    assert leds.distances[0] == pytest.approx(CLEARANCE, abs=1e-9)


def test_without_a_surface_nobody_notices_that_they_would_stand() -> None:
    """The very same poses, whatever a robot has to say of standing."""
    rig = load_rig(DEMO_RIG)
    would = rig_on(robots=1).robots[0].stands
    other = replace(rig, robots=tuple(replace(robot, stands=would) for robot in rig.robots))
    for one, two in zip(poses(rig, Scene(rig, 3), 5.0), poses(other, Scene(other, 3), 5.0), strict=True):
        np.testing.assert_array_equal(one.position, two.position)
        np.testing.assert_array_equal(one.orientation, two.orientation)


def holed(x: int = 81, y: int = 61) -> Heights:
    """0.8 x 0.6 m, a bulge, with a hole and a corner that is missing."""
    grid = np.stack(np.meshgrid(np.linspace(-0.4, 0.4, x), np.linspace(-0.3, 0.3, y), indexing="ij"), axis=-1)
    values = 0.02 * np.cos(4.0 * grid[..., 0]) * np.cos(3.0 * grid[..., 1])
    values[(np.linalg.norm(grid - [0.3, 0.2], axis=-1) < 0.06) | ((grid[..., 0] < -0.33) & (grid[..., 1] < -0.2))] = (
        np.nan
    )
    return Heights(np.array([-0.4, -0.3]), np.array([0.8 / (x - 1), 0.6 / (y - 1)]), values, np.zeros((x, y)))


@pytest.mark.parametrize(
    "surface",
    [
        Surface(holed()),
        replace(TILTED, edge=np.array([[-0.4, -0.3], [0.4, -0.3], [0.0, 0.4]])),
        replace(BENT, edge=0.35 * np.array([[np.cos(a), np.sin(a)] for a in np.linspace(0, 6, 40)])),
    ],
    ids=["holes", "triangle", "round"],
)  # fmt: skip
@pytest.mark.parametrize("lanes", [None, 0.02], ids=["about", "lanes"])
def test_nobody_drives_beyond_the_edge_or_over_a_hole(surface: Surface, lanes: float | None) -> None:
    rig = rig_on(surface, robots=2)
    scene = Scene(rig, 1, work=Work(lanes))
    seen = tools(rig, scene, np.arange(0.0, 60.0, 0.83))
    assert surface.ground(seen.reshape(-1, 3)[:, :2]).inside.all()
    assert np.ptp(seen[..., 0]) > 0.1
    assert np.linalg.norm(seen[:, 0] - seen[:, 1], axis=1).min() > 0.08


def test_the_part_that_is_driven_on_is_the_largest_rectangle(rng: np.random.Generator) -> None:
    """Against every rectangle of a small grid."""
    for _ in range(20):
        values = np.where(rng.random((7, 6)) < 0.12, np.nan, 0.0)
        values[0, 0] = values[-1, -1] = 0.0
        surface = Surface(Heights(np.zeros(2), np.array([0.1, 0.2]), values, np.zeros((7, 6))))
        whole = np.isfinite(values)
        best = max(
            (x1 - x0) * (y1 - y0)
            for x0 in range(7) for x1 in range(x0, 7) for y0 in range(6) for y1 in range(y0, 6)
            if whole[x0 : x1 + 1, y0 : y1 + 1].all()
        )  # fmt: skip
        part = part_of(surface, (1.0, 1.0))
        if best == 0:
            assert part is None
            continue
        assert part is not None
        assert 4.0 * part.half[0] * part.half[1] == pytest.approx(best * 0.02)
        corners = [part.middle + np.array(part.half) * [x, y] for x in (-0.99, 0.99) for y in (-0.99, 0.99)]
        assert surface.ground(np.array(corners)).inside.all()


def test_cameras_of_one_surface_show_the_same_robots() -> None:
    left = rig_on(replace(BENT, T_world_surface=AWAY))
    at = AWAY.position
    right = replace(
        left, T_world_camera=looking_at(at + np.array([0.4, 0.5, 1.1]), at), camera=replace(left.camera, name="right")
    )
    check_shared(["left", "right"], [left, right])
    for one, two in zip(poses(left, Scene(left, 3), 9.0), poses(right, Scene(right, 3), 9.0), strict=True):
        np.testing.assert_allclose(one.position, two.position, atol=1e-12)
    other = replace(right, surface=replace(BENT, T_world_surface=Pose.identity()))
    with pytest.raises(InputError, match="right: its `surface` is not that of left"):
        check_shared(["left", "right"], [left, other])


def test_a_camera_that_looks_at_another_part_has_its_own_robots_there() -> None:
    rig = rig_on(TILTED, robots=3)
    rig = replace(rig, T_world_camera=looking_at(np.array([2.0, 0.4, 1.2]), np.array([2.02, 0.4, 0.0])))
    scene = Scene(rig, 0)
    assert not scene.table.common
    assert all(sum(scene.visible(k, entry)) == 6 for k, entry in enumerate(scene.truth(0, 1.0)))


def test_a_surface_without_room_is_refused() -> None:
    small = Surface(
        Quadric.plane(np.zeros(3), np.array([0.0, 0.0, 1.0])), edge=0.1 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    )
    with pytest.raises(InputError, match=r"0\.20 x 0\.20 m in one piece to drive on, for 5 robots"):
        Scene(rig_on(small), 0)
    gone = Surface(replace(holed(3, 3), values=np.full((3, 3), np.nan)))
    with pytest.raises(InputError, match="the rig's `surface` is nowhere"):
        Scene(rig_on(gone), 0)


@pytest.mark.parametrize("turned", [False, True])
def test_lanes_come_by_everywhere_within_half_a_lane(turned: bool) -> None:
    lanes = Lanes((0.20, 0.30) if turned else (0.30, 0.20), 0.03)
    assert lanes.apart <= 0.03
    way = np.array([lanes.at(t) for t in np.linspace(0.0, lanes.once_s, 4000)])
    speeds = np.linalg.norm(np.diff(way, axis=0), axis=1) / (lanes.once_s / 3999)
    assert np.median(speeds) == pytest.approx(0.12, rel=1e-6)
    spots = np.stack(np.meshgrid(np.linspace(-0.135, 0.135, 28), np.linspace(-0.1, 0.1, 21)), axis=-1).reshape(-1, 2)
    spots = spots[:, ::-1] if turned else spots
    nearest = np.linalg.norm(spots[:, None] - way[None], axis=-1).min(axis=1)
    assert nearest.max() <= 0.5 * lanes.apart + 1e-4
    np.testing.assert_allclose(lanes.at(lanes.once_s + 1.0), lanes.at(lanes.once_s - 1.0), atol=1e-9)


@pytest.mark.parametrize("robots", [2, 5])
def test_in_lanes_robots_go_over_all_of_their_table_and_never_touch(robots: int) -> None:
    rig = rig_on(TILTED, robots=robots)
    scene = Scene(rig, 1, work=Work(0.03))
    assert scene.lanes is not None
    seen = tools(rig, scene, np.arange(0.0, scene.lanes.once_s, 0.1))[..., :2]
    apart = np.linalg.norm(seen[:, :, None] - seen[:, None], axis=-1) + np.eye(robots)
    assert apart.min() > 0.12
    half = np.array(scene.table.half) - 0.015
    spots = np.stack(np.meshgrid(*[np.linspace(-side, side, 23) for side in half]), axis=-1).reshape(-1, 2)
    nearest = np.linalg.norm(spots[:, None] - seen.reshape(-1, 2)[None], axis=-1).min(axis=1)
    assert nearest.max() < 0.023  # half a lane, or where lanes of two parts end before each other


def test_a_lifted_robot_is_off_the_surface_by_so_much_for_so_long() -> None:
    rig = rig_on()
    scene = Scene(rig, 2, work=Work(0.02, Lift(rig.robots[1].id, 0.003, 2.0, 4.0)))
    for time_s, off in ((1.9, 0.0), (2.0, 0.003), (3.9, 0.003), (4.0, 0.0)):
        touch = BENT.touch(np.array([pose.map(TOOL) for pose in poses(rig, scene, time_s)]))
        np.testing.assert_allclose(touch.distances, [0.0, off, 0.0, 0.0, 0.0], atol=1e-9)


def test_the_demonstration_is_the_rig_of_old_on_the_workpiece_of_old() -> None:
    """Its surface is the one that robots without one drive on, as far as they drive, to a hundredth of a millimetre."""
    old, rig = load_rig(DEMO_RIG), load_rig(DEMO_WORKPIECE)
    assert rig.surface is not None
    np.testing.assert_array_equal(rig.camera.matrix, old.camera.matrix)
    for one, other in zip(rig.robots, old.robots, strict=True):
        np.testing.assert_array_equal(one.leds, other.leds)
        assert one.stands is not None
    half = Scene(old, 0).table.half
    piece = Workpiece(half[0])
    for x in np.linspace(-half[0], half[0], 13):
        for y in np.linspace(-half[1], half[1], 13):
            ground = rig.surface.ground(np.array([x, y]))
            assert ground.inside.all()
            assert abs(ground.heights[0] - piece.at(x, y)[0]) < 0.02e-3
            np.testing.assert_allclose(ground.slopes[0], piece.at(x, y)[1:], atol=2e-3)
    assert min(Scene(rig, 0).table.half) > 0.9 * min(half)
