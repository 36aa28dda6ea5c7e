"""What a client takes for a pose, and that everything else is refused with a reason."""

import re
import subprocess
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from hypothesis import given
from hypothesis import strategies as st

from asterism.clients.accept import is_covariance, problem
from asterism.protocol.codec import decode_odometry, encode_odometry
from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Pose
from asterism.protocol.messages import RobotPose, Velocity
from tests.clients.serving import COVARIANCE
from tests.protocol.make_golden import ROBOT_POSE, SMOOTHED_POSE

POSE = replace(ROBOT_POSE, covariance=COVARIANCE)
MOVING = Velocity(np.array([0.1, 0.0, 0.0]), np.zeros(3), COVARIANCE, (1e-3, 1e-1))
UNEVEN = COVARIANCE + 1e-6 * np.eye(6, k=1)
# No two of its axes correlate by more than 1, and yet there is a direction in which its variance is below 0.
CONTRADICTORY = 1e-6 * (np.eye(6) + 0.9 * (np.eye(6, k=1) + np.eye(6, k=-1) - np.eye(6, k=2) - np.eye(6, k=-2)))
BEYOND = COVARIANCE + 2e-10 * (np.eye(6, k=1) + np.eye(6, k=-1))


def test_what_a_server_tells_is_taken() -> None:
    for state in ("TRACKED", "TILT_AMBIGUOUS"):
        for leds in (4, 5, 6):
            assert problem(replace(POSE, state=state, leds=leds, velocity=MOVING), "alpha") is None
    assert problem(replace(POSE, published_ns=POSE.exposed_ns), "alpha") is None  # solved again
    for golden in (ROBOT_POSE, SMOOTHED_POSE):
        assert problem(decode_odometry(encode_odometry(golden)), "alpha") is None


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"robot": "bravo"}, "is of robot 'bravo'"),
        ({"robot": "\x1b[2J"}, r"is of robot '\\x1b\[2J'"),
        ({"state": "LOST"}, "has state 'LOST', expected TRACKED or TILT_AMBIGUOUS"),
        ({"state": ""}, "has state ''"),
        ({"leds": -6}, "rests on -6 LEDs, expected 4 to 6"),
        ({"leds": 7}, "rests on 7 LEDs"),
        ({"leds": 10**400}, "rests on a number of many digits LEDs"),
        ({"rms_px": float("nan")}, "has residuals of nan px"),
        ({"rms_px": -1.0}, "has residuals of -1.0 px"),
        ({"covariance": np.full((6, 6), np.nan)}, "has a covariance that is none"),
        ({"covariance": -COVARIANCE}, "has a covariance that is none"),
        ({"covariance": np.zeros((6, 6))}, "has a covariance that is none"),
        ({"covariance": UNEVEN}, "has a covariance that is none"),
        ({"covariance": BEYOND}, "has a covariance that is none"),
        ({"covariance": CONTRADICTORY}, "has a covariance that is none"),
        ({"covariance": 1e30 * np.eye(6)}, "has a covariance that is none"),
        (
            {"pose": Pose(np.array([0, 0, 1e10]), POSE.orientation)},
            r"a position that is not finite, or beyond 1e\+09 m",
        ),
        ({"velocity": replace(MOVING, linear=np.array([np.inf, 0, 0]))}, "has a velocity that is none"),
        ({"velocity": replace(MOVING, angular=np.array([0, 1e300, 0]))}, "has a velocity that is none"),
        ({"velocity": replace(MOVING, covariance=UNEVEN)}, "has a velocity that is none"),
        ({"velocity": replace(MOVING, accelerations=(np.nan, 0.0))}, "has a velocity that is none"),
        ({"sequence": -1}, "has sequence -1"),
        ({"session": 10**400}, "has session a number of many digits"),
        ({"published_ns": POSE.exposed_ns - 3_600_000_000_000}, "was published -3600.000 s after exposure"),
        ({"published_ns": 0}, "after exposure, expected 0 to 600"),
        ({"published_ns": 10**400}, "published at a number of many digits ns"),
        ({"exposed_ns": -5}, "was exposed at -5"),
    ],
)
def test_nonsense_is_refused_with_a_reason(changes: dict[str, Any], words: str) -> None:
    assert re.search(words, problem(replace(POSE, **changes), "alpha") or "")


def message(pose: RobotPose = POSE) -> Odometry:
    told = Odometry()
    told.ParseFromString(encode_odometry(pose))
    return told


@pytest.mark.parametrize("quaternion", [(0, 0, 0, 0), (0, 0, 0, 2.0), (np.nan, 0, 0, 1), (np.inf, 0, 0, 0)])
def test_a_quaternion_that_is_no_rotation_is_refused(quaternion: tuple[float, ...]) -> None:
    told = message()
    q = told.pose.orientation
    q.x, q.y, q.z, q.w = quaternion
    with pytest.raises(InputError, match=r"no pose of Asterism .a quaternion of length"):
        decode_odometry(told.SerializeToString())


def test_it_is_refused_without_assertions_as_well() -> None:
    told = message()
    told.pose.orientation.Clear()
    program = (
        "import sys\n"
        "from asterism.protocol.codec import decode_odometry\n"
        "from asterism.protocol.errors import InputError\n"
        "try:\n"
        "    decode_odometry(sys.stdin.buffer.read())\n"
        "except InputError as error:\n"
        "    print(error)\n"
    )
    command = [sys.executable, "-O", "-c", program]
    run = subprocess.run(command, input=told.SerializeToString(), capture_output=True, check=True)
    assert b"a quaternion of length 0" in run.stdout


def test_correlations_decide_whatever_the_units(rng: np.random.Generator) -> None:
    for _ in range(100):
        half = rng.standard_normal((6, 6)) * 10.0 ** rng.uniform(-12, 3, 6)[:, None]
        assert is_covariance(half @ half.T)
    with np.errstate(all="raise"):
        for size in (1e-320, 1e-300, 1e300):
            assert is_covariance(np.full((6, 6), 0.0) + size * np.eye(6))
        assert not is_covariance(1e-300 * np.eye(6) + 1e300 * np.eye(6, k=1))


def test_covariances_of_fewer_directions_than_axes_are_taken(rng: np.random.Generator) -> None:
    """As a solver tells them of a pose that a prior holds fast."""
    for rank in range(1, 6):
        half = rng.standard_normal((6, rank))
        assert is_covariance(half @ half.T)


@given(st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), min_size=1, max_size=20))
def test_damaged_bytes_end_in_a_pose_or_a_sentence(damages: list[tuple[int, int]]) -> None:
    payload = bytearray(encode_odometry(replace(POSE, velocity=MOVING)))
    for place, value in damages:
        payload[place % len(payload)] = value
    try:
        pose = decode_odometry(bytes(payload))
    except InputError:
        return
    assert isinstance(problem(pose, "alpha"), str | None)
