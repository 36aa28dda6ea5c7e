"""Reports read by their bytes are those that the real decoder reads, whole ones and broken ones."""

from pathlib import Path

import numpy as np
import pytest

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import to_bytes
from asterism.recordings.decodable import read_report
from asterism.server.coverage.report_bytes import ODD, Columns, read_reports
from asterism.server.coverage.told import Looked, decode_into, looked_for
from tests.coverage.driven import START_NS, report_of, working_rig
from tests.helpers import random_pose

WHERE = Path("recording")


@pytest.fixture(scope="module")
def payloads() -> list[bytes]:
    """Reports of three robots, all that a report can hold among them."""
    rig, rng, told = working_rig(3), np.random.default_rng(1), []
    for number in range(20):
        poses = {robot.id: random_pose(rng) for robot in rig.robots if rng.uniform() < 0.8}
        report = report_of(rig, number, START_NS + number, poses, rng)
        for entry in report.robots:
            if entry.state == pb.TRACKED and rng.uniform() < 0.3:
                entry.state, entry.smoothed_by = pb.TILT_AMBIGUOUS, "kalman"
                entry.alternative.pose.CopyFrom(entry.pose)
                entry.surface.standing = int(rng.integers(0, 6))
                entry.velocity.linear.x, entry.extrapolated = 0.3, True
        if number % 5 == 0:
            del report.robots[1]
            report.spots.robot[:] = [-1] * len(report.spots.robot)
            report.cameras.extend(["left", "right"])
        told.append(to_bytes(report))
    return told


@pytest.fixture(scope="module")
def looked() -> Looked:
    """Two of the three, in another order."""
    return looked_for({"r02": np.array([0.01, -0.02, -0.03]), "r00": np.array([0.0, 0.0, -0.03])})


def read(payload: bytes, looked: Looked) -> Columns:
    """By bytes; ODD where that says nothing."""
    columns = Columns.of(1, len(looked.ids))
    data = np.array(np.frombuffer(payload, np.uint8))
    read_reports(data, np.array([[0, len(data)]]), looked.robots, columns)
    return columns


def decoded(payload: bytes, looked: Looked) -> Columns:
    """By the decoder. Raises InputError."""
    columns = Columns.of(1, len(looked.ids))
    decode_into(columns, 0, read_report(payload, WHERE), looked)
    return columns


def same(one: Columns, other: Columns) -> bool:
    """Whether they tell the same, numbers to rounding."""
    exact = ("times_ns", "states", "standings")
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in exact) and all(
        np.allclose(getattr(one, name), getattr(other, name), rtol=1e-9, atol=1e-15, equal_nan=True)
        for name in ("points", "covariances")
    )


def test_reports_of_a_server_are_read_by_their_bytes(payloads: list[bytes], looked: Looked) -> None:
    for payload in payloads:
        columns = read(payload, looked)
        assert columns.found[0] != ODD
        assert same(columns, decoded(payload, looked))


def test_what_is_broken_is_read_as_the_decoder_reads_it_or_left_to_it(
    payloads: list[bytes], looked: Looked, rng: np.random.Generator
) -> None:
    read_anyway = refused = 0
    for k in range(1500):
        payload = broken(payloads[k % len(payloads)], rng)
        columns = read(payload, looked)
        report = pb.FrameReport()
        try:
            report.ParseFromString(payload)
            parsed = True
        except Exception:
            parsed = False
        if columns.found[0] == ODD:
            refused += 1
            continue
        if parsed:
            read_anyway += 1
            expected = Columns.of(1, len(looked.ids))
            decode_into(expected, 0, report, looked)
            assert same(columns, expected), k
    assert min(read_anyway, refused) > 100


def broken(payload: bytes, rng: np.random.Generator) -> bytes:
    """With some bytes changed, lost, or there twice."""
    data, at = bytearray(payload), int(rng.integers(len(payload)))
    kind = rng.integers(4)
    if kind == 0:
        for _ in range(rng.integers(1, 4)):
            data[rng.integers(len(data))] = rng.integers(256)
    elif kind == 1:
        del data[at : at + int(rng.integers(1, 20))]
    elif kind == 2:
        data[at:at] = data[at : at + int(rng.integers(1, 60))]
    else:
        data[rng.integers(min(200, len(data)))] ^= 1 << int(rng.integers(8))
    return bytes(data)
