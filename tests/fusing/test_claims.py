"""Whose spots are whose across cameras: what they show together, and what is refused."""

from collections.abc import Mapping, Sequence

import numpy as np
import pytest

from asterism.protocol.geometry import Pose, exp_rotation
from asterism.protocol.rig import Rig
from asterism.server.fusing.claims import Claim, Foreseen, claims_of
from asterism.server.fusing.fleet import Fleet, View
from asterism.server.fusing.sighting import Sighting
from asterism.server.pose.solve import Lost
from tests.fusing.spotted import drawn, truth_of
from tests.several import facing_pair, rigs_at

RIGS = rigs_at(facing_pair(60.0), robots=3)
FLEET = Fleet.of([View(rig) for rig in RIGS])
ALL = range(6)
PLACES = {
    "r00": Pose.from_matrix(exp_rotation(np.array([0.1, -0.05, 0.4])), np.array([-0.12, 0.05, 0.0])),
    "r01": Pose.from_matrix(exp_rotation(np.array([-0.08, 0.12, 2.0])), np.array([0.12, -0.06, 0.02])),
    "r02": Pose.from_matrix(exp_rotation(np.array([0.02, 0.1, -1.0])), np.array([0.1, 0.15, -0.02])),
}
Lit = Mapping[str, Sequence[int]]


def nothing(robot: str, at_ns: int) -> Foreseen | None:
    """Nothing is known before."""
    return None


def near(robot: str, at_ns: int) -> Foreseen | None:
    """All robots are known to about a millimetre and a hundredth."""
    off = Pose.from_matrix(exp_rotation(np.array([0.004, -0.006, 0.005])), np.zeros(3))
    turned = (off @ PLACES[robot]).rotation
    spread = np.diag([1e-6] * 3 + [1e-4] * 3)
    return Foreseen(Pose.from_matrix(turned, PLACES[robot].position + np.array([1e-3, -5e-4, 1e-3])), spread)


def seen(
    lit: Sequence[Lit], rng: np.random.Generator, claimed: Sequence[Sequence[str]] = ((), ()), glints: int = 0
) -> list[Sighting]:
    """What the cameras report of robots at their places."""
    robots = {name: (FLEET.robots[name], pose) for name, pose in PLACES.items()}
    return [
        drawn(rig, robots, leds, rng, glints, {name: PLACES[name] for name in names})
        for rig, leds, names in zip(RIGS, lit, claimed, strict=True)
    ]


def true_spots(sightings: Sequence[Sighting], lit: Sequence[Lit], robot: str) -> dict[str, list[int]]:
    """The rows that are a robot's, by the cameras that see any."""
    rows = {}
    for sighting, rig, leds in zip(sightings, RIGS, lit, strict=True):
        found = truth_of(sighting, rig, FLEET.robots[robot], PLACES[robot])
        rows[sighting.camera] = [int(found[led]) if led in leds.get(robot, ()) else -1 for led in range(6)]
    return {camera: spots for camera, spots in rows.items() if max(spots) >= 0}


def told(answer: Claim | Lost) -> dict[str, list[int]]:
    """The spots of a claim."""
    assert isinstance(answer, Claim), answer
    return {camera: spots.tolist() for camera, spots in answer.spots.items()}


@pytest.mark.parametrize("glints", [0, 8])
def test_three_leds_in_each_camera_are_a_pose(rng: np.random.Generator, glints: int) -> None:
    lit = [{"r00": [0, 1, 2], "r01": [5, 1, 3]}, {"r00": [3, 4, 5], "r01": [0, 1, 4]}]
    sightings = seen(lit, rng, glints=glints)
    claims = claims_of(FLEET, sightings, nothing)
    for robot in ("r00", "r01"):
        assert told(claims[robot]) == true_spots(sightings, lit, robot)
        (start, *_) = claims[robot].starts  # type: ignore[union-attr]
        assert np.linalg.norm(start.position - PLACES[robot].position) < 1e-3
    assert isinstance(claims["r02"], Lost)
    assert list(claims) == list(FLEET.robots)


def test_what_was_foreseen_keeps_robots_known_that_no_camera_knows(rng: np.random.Generator) -> None:
    lit = [{"r00": [0, 1, 2], "r01": [2, 3, 4, 5], "r02": [0, 2]}, {"r00": [0, 1, 5], "r01": [0, 1], "r02": [1]}]
    sightings = seen(lit, rng, glints=8)
    claims = claims_of(FLEET, sightings, near)
    for robot in ("r00", "r01"):
        assert told(claims[robot]) == true_spots(sightings, lit, robot)
    # Three of its LEDs in all are no pose.
    lost = claims["r02"]
    assert isinstance(lost, Lost)
    assert lost.reason == ("left sees two of its LEDs, right sees one: show four to one camera, or three to two")


def test_a_camera_that_knows_a_robot_shows_the_other_which_spots_are_its(rng: np.random.Generator) -> None:
    lit = [{"r00": ALL}, {"r00": [1, 4], "r01": [0, 2]}]
    sightings = seen(lit, rng, claimed=(("r00",), ()))
    assert told(claims_of(FLEET, sightings, nothing)["r00"]) == true_spots(sightings, lit, "r00")


def test_a_spot_that_two_explain_is_nobodys(rng: np.random.Generator) -> None:
    lit = [{"r00": ALL}, {"r00": [1, 4]}]
    left, right = seen(lit, rng, claimed=(("r00",), ()))
    row = true_spots([left, right], lit, "r00")["right"][4]
    # Another light within a tenth of a pixel of the LED's own.
    right.rays[1 - row] = right.rays[row] + 7e-5
    spots = told(claims_of(FLEET, [left, right], nothing)["r00"])
    assert spots.get("right", [-1] * 6)[4] == -1


def test_cameras_that_name_one_robot_differently_are_judged_by_all_spots(rng: np.random.Generator) -> None:
    lit = [{"r00": ALL}, {"r00": [0, 1, 3, 4]}]
    left, right = seen(lit, rng, claimed=(("r00",), ("r00",)))
    # The other camera takes it for r01, its LEDs in another order.
    right.robots[:] = 1
    right.leds[:] = (right.leds + 2) % 6
    right.told["r01"].CopyFrom(right.told["r00"])
    right.told["r01"].id = "r01"
    right.told["r00"].ClearField("pose")
    for sightings in ([left, right], [right, left]):
        claims = claims_of(FLEET, sightings, nothing)
        assert told(claims["r00"]) == true_spots([left, right], lit, "r00")
        assert isinstance(claims["r01"], Lost)


def test_a_robot_at_two_places_is_at_none(rng: np.random.Generator) -> None:
    lit = [{"r00": ALL}, {"r00": ALL}]
    left, _ = seen(lit, rng, claimed=(("r00",), ()))
    elsewhere = Pose(PLACES["r00"].position + np.array([0.3, 0.1, 0.0]), PLACES["r00"].orientation)
    right = drawn(RIGS[1], {"r00": (FLEET.robots["r00"], elsewhere)}, lit[1], rng, claimed={"r00": elsewhere})
    answers = [claims_of(FLEET, sightings, nothing)["r00"] for sightings in ([left, right], [right, left])]
    for lost in answers:
        assert isinstance(lost, Lost)
        assert lost.state == "IDENTITY_AMBIGUOUS"
        assert "left" in lost.reason
        assert "right" in lost.reason
        assert "show more of its LEDs" in lost.reason


def test_a_camera_that_stands_elsewhere_than_the_rig_says_names_robots_all_the_same(rng: np.random.Generator) -> None:
    lit = [{"r00": ALL}, {"r00": ALL}]
    left, _ = seen(lit, rng, claimed=(("r00",), ()))
    moved = Pose.from_matrix(exp_rotation(np.array([0.0, 0.002, 0.0])), np.array([0.001, 0.0, 0.001]))
    there = moved @ PLACES["r00"]
    right = drawn(RIGS[1], {"r00": (FLEET.robots["r00"], there)}, lit[1], rng, claimed={"r00": there})
    spots = told(claims_of(FLEET, [left, right], nothing)["r00"])
    assert min(min(rows) for rows in spots.values()) >= 0
    assert set(spots) == {"left", "right"}


def test_a_strangers_constellation_is_nobody(rng: np.random.Generator) -> None:
    stranger = rigs_at(facing_pair(60.0), robots=6, seed=5)[0].robots[5]
    hidden: list[Rig] = RIGS
    for turn in range(5):
        pose = PLACES["r00"] @ Pose.from_matrix(exp_rotation(np.array([0.0, 0.1, 1.1 * turn])), np.zeros(3))
        leds = [rng.choice(6, 4, replace=False) for _ in hidden]
        sightings = [
            drawn(rig, {"stranger": (stranger, pose)}, {"stranger": seen}, rng)
            for rig, seen in zip(hidden, leds, strict=True)
        ]
        assert all(isinstance(answer, Lost) for answer in claims_of(FLEET, sightings, nothing).values())


def test_a_camera_that_sees_nothing_changes_nothing(rng: np.random.Generator) -> None:
    lit = [{"r00": ALL, "r01": [0, 1, 2]}, {"r00": [0, 1], "r01": [3, 4, 5]}]
    sightings = seen(lit, rng, claimed=(("r00",), ()))
    third = rigs_at([*facing_pair(60.0), RIGS[0].T_world_camera], robots=3)[2]  # type: ignore[list-item]
    blind = drawn(third, {}, {}, rng)
    fleet = Fleet.of([*FLEET.views.values(), View(third)])
    two, three = claims_of(FLEET, sightings, nothing), claims_of(fleet, [*sightings, blind], nothing)
    for robot in ("r00", "r01"):
        assert told(two[robot]) == told(three[robot])


def test_the_same_sightings_give_the_same_claims(rng: np.random.Generator) -> None:
    lit = [{"r00": [0, 1, 2], "r01": [5, 1, 3]}, {"r00": [3, 4, 5], "r01": [0, 1, 4]}]
    sightings = seen(lit, rng, glints=8)
    one, again = claims_of(FLEET, sightings, nothing), claims_of(FLEET, sightings, nothing)
    for robot in ("r00", "r01"):
        assert told(one[robot]) == told(again[robot])
        for first, second in zip(one[robot].starts, again[robot].starts, strict=True):  # type: ignore[union-attr]
            assert first.position.tobytes() == second.position.tobytes()
