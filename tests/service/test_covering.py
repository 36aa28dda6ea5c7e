"""What a server tells of where tools have been, second by second."""

from dataclasses import replace

import numpy as np
import pytest

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import decode_coverage, to_bytes
from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Pose
from asterism.protocol.messages import Message
from asterism.protocol.rig import Rig
from asterism.recordings.from_network import arrived
from asterism.server.service.covering import WHOLE_EVERY, Covering
from tests.coverage.driven import FLAT, RATE_HZ, START_NS, STEP_NS, message_of, report_of, working_rig

SECONDS = 25
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])


def second(rig: Rig, number: int, rng: np.random.Generator) -> list[Message]:
    """A second in which the robots go straight, beside each other."""
    told = []
    for frame in range(number * RATE_HZ, (number + 1) * RATE_HZ):
        poses = {
            robot.id: Pose(np.array([-0.2 + 0.0002 * frame, -0.1 + 0.1 * k, 0.03]), UPRIGHT)
            for k, robot in enumerate(rig.robots)
        }
        told.append(message_of(rig, report_of(rig, frame, START_NS + frame * STEP_NS, poses, rng)))
    return told


def breath() -> None:
    """Nobody waits."""


@pytest.fixture(scope="module")
def spoken() -> list["pb.Coverage"]:
    """What is told of half a minute."""
    rig, rng, found = working_rig(2, FLAT), np.random.default_rng(0), []
    covering = Covering(rig)
    for number in range(SECONDS):
        covering.add(second(rig, number, rng))
        found += [decode_coverage(message.payload) for message in covering.look(7, breath)]
    return found


def heard(messages: list["pb.Coverage"], robot: int) -> dict[int, tuple[float, int, int]]:
    """What somebody knows who hears them."""
    known: dict[int, tuple[float, int, int]] = {}
    for message in messages:
        told = message.robots[robot]
        known |= dict(zip(told.patch, zip(told.dwell_s, told.passes, told.last_ns, strict=True), strict=True))
    return known


def test_who_joins_late_knows_all_within_ten_seconds(spoken: list["pb.Coverage"]) -> None:
    assert len(spoken) == SECONDS
    assert WHOLE_EVERY == 10
    for robot in range(2):
        all_of_it = heard(spoken, robot)
        assert len(all_of_it) > 500
        for late in range(1, SECONDS - WHOLE_EVERY + 1):
            assert heard(spoken[late : late + WHOLE_EVERY], robot) == heard(spoken[: late + WHOLE_EVERY], robot)


def test_a_message_holds_what_changed_and_its_sums(spoken: list["pb.Coverage"]) -> None:
    changes = [message for message in spoken[1:] if not message.whole]
    assert max(len(message.robots[0].patch) for message in changes) < 0.2 * len(heard(spoken, 0))
    last = spoken[-1]
    known, speed = heard(spoken, 0), 0.0002 * 1e9 / STEP_NS
    patches, dwell = np.array(list(known)), np.array([told[0] for told in known.values()])
    x, y = last.x0 + last.pitch * (patches % last.columns), last.y0 + last.pitch * (patches // last.columns)
    behind = (x > -0.19) & (x < -0.2 + 0.0002 * SECONDS * RATE_HZ - 0.011)
    assert np.allclose(dwell[behind], 2.0 * np.sqrt(0.01**2 - (y[behind] + 0.1) ** 2) / speed, rtol=1e-5)
    assert last.robots[0].counted == SECONDS * RATE_HZ
    assert last.exposed_ns - last.since_ns == (SECONDS * RATE_HZ - 1) * STEP_NS
    assert np.allclose(last.robots[0].speed, speed, rtol=1e-4)


def test_a_rig_of_the_same_surface_goes_on_and_another_begins_anew(rng: np.random.Generator) -> None:
    rig = working_rig(2, FLAT)
    covering = Covering(rig)
    covering.add(second(rig, 0, rng))
    assert covering.look(7, breath)
    covering.take_rig(replace(rig, range_m=(0.5, 2.0)))
    assert [decode_coverage(told.payload).since_ns for told in covering.look(7, breath)] == [START_NS]
    covering.take_rig(working_rig(2))
    assert covering.look(7, breath) == []
    covering.take_rig(working_rig(2, None))
    covering.add(second(rig, 1, rng))
    assert covering.look(7, breath) == []


def test_what_is_told_is_heard_as_it_was_and_nothing_else(spoken: list["pb.Coverage"]) -> None:
    got = arrived("asterism/test/coverage", to_bytes(spoken[3]))
    assert (got.camera, got.session, got.told) == ("test", 7, spoken[3])
    broken = pb.Coverage()
    broken.CopyFrom(spoken[3])
    broken.robots[0].patch.append(1)
    for payload in (b"", to_bytes(broken)):
        with pytest.raises(InputError, match=r"no asterism\.Coverage of a server"):
            arrived("asterism/test/coverage", payload)
