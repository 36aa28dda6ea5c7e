"""Rigs that do not fit together are refused by what is wrong with them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from asterism.protocol.errors import InputError
from asterism.protocol.rig import Robot, load_rig
from asterism.server.fusing.fitting import refuse_unlike_robots, unlike, view_of
from asterism.server.fusing.fleet import View
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.several import facing_pair, rigs_at


def test_rigs_of_the_same_robots_fit() -> None:
    left, right = (view_of(rig, "here") for rig in rigs_at(facing_pair()))
    refuse_unlike_robots(right, [left])
    assert [unlike(one, other) for one, other in zip(left.rig.robots, right.rig.robots, strict=True)] == [""] * 2


def test_a_rig_that_places_no_camera_is_refused() -> None:
    left, _ = rigs_at(facing_pair())
    with pytest.raises(InputError, match=r"left/rig.yaml: the rig has no `world`.*calibrate cameras"):
        view_of(replace(left, T_world_camera=None), "left/rig.yaml")


def test_how_well_the_place_is_known_is_taken_from_the_rigs_files() -> None:
    left, _ = rigs_at(facing_pair())
    told = {"uncertainty.yaml": "world: {position_m: 0.002, orientation_rad: 0.001, by: a tape}\n"}
    view = view_of(replace(left, files=told), "here")
    assert np.allclose(np.diag(view.place_covariance), [4e-6] * 3 + [1e-6] * 3)
    assert not view_of(left, "here").place_covariance.any()


def test_a_robot_that_differs_is_named_with_how_much() -> None:
    left, right = rigs_at(facing_pair())
    moved = np.array(right.robots[1].leds)
    moved[3, 0] += 0.0005
    other = View(replace(right, robots=(right.robots[0], replace(right.robots[1], leds=moved))))
    robot = right.robots[1].id
    with pytest.raises(InputError, match=f"robot '{robot}' .* 'right' than in that of 'left': LED 3 is 0.5 mm else"):
        refuse_unlike_robots(other, [View(left)])


def test_all_that_a_pose_depends_on_is_compared() -> None:
    robot = rigs_at(facing_pair())[0].robots[0]
    assert unlike(robot, robot) == ""
    pointed = replace(robot, points={"tool": np.array([0.0, 0.0, 0.1])})
    assert unlike(robot, pointed) == "the point 'tool' is in one of them only"
    longer = replace(robot, points={"tool": np.array([0.0, 0.0, 0.102])})
    assert unlike(pointed, longer) == "the point 'tool' is 2 mm elsewhere"
    fixed = replace(robot, T_world_fixed=facing_pair()[0])
    assert unlike(robot, fixed) == "it is `fixed` in one of them only"
    assert unlike(fixed, replace(robot, T_world_fixed=facing_pair()[1])).startswith("it is fixed 1.3e+03 mm and")
    leaning = Robot(robot.id, robot.leds, np.array([0.0, np.sin(0.02), np.cos(0.02)]))
    assert unlike(robot, leaning) == "led.axis is turned by 1.15 degrees"


def test_no_camera_is_called_fused(tmp_path: Path) -> None:
    for file in DEMO_RIG.parent.glob("*.yaml"):
        (tmp_path / file.name).write_text(file.read_text().replace("camera_name: demo", "camera_name: fused"))
    with pytest.raises(InputError, match="has camera_name 'fused', which names what asterism fuse publishes"):
        load_rig(tmp_path / DEMO_RIG.name)
