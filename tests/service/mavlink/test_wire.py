"""Frames on the wire, read and written by MAVLink's own Python library, which nobody here wrote."""

import numpy as np
import pytest

pytest.importorskip("pymavlink", reason="pymavlink is not installed (pip install '.[dev]')")

from pymavlink.dialects.v20 import common as theirs
from pymavlink.generator.mavcrc import x25crc

from asterism.server.service.mavlink.wire import (
    ALIVE,
    BODY_FRD,
    HEARTBEAT,
    LOCAL_FRD,
    MOTION_CAPTURE,
    ODOMETRY,
    TIMESYNC,
    Odometry,
    checksum,
    framed,
    unframed,
)


def parsed(datagram: bytes) -> "theirs.MAVLink_message":
    """The one message in it, as their parser reads it."""
    reader = theirs.MAVLink(None)
    (message,) = reader.parse_buffer(bytearray(datagram))
    assert reader.total_receive_errors == 0
    return message


def test_the_numbers_of_messages_are_theirs() -> None:
    for kind, theirs_of_it in (
        (HEARTBEAT, theirs.MAVLink_heartbeat_message),
        (TIMESYNC, theirs.MAVLink_timesync_message),
        (ODOMETRY, theirs.MAVLink_odometry_message),
    ):
        assert (kind.number, kind.seed) == (theirs_of_it.id, theirs_of_it.crc_extra)
        assert kind.fields.size == theirs_of_it.unpacker.size
    assert theirs.MAV_FRAME_LOCAL_FRD == LOCAL_FRD
    assert theirs.MAV_FRAME_BODY_FRD == BODY_FRD
    assert theirs.MAV_ESTIMATOR_TYPE_MOCAP == MOTION_CAPTURE


def test_the_checksum_is_theirs(rng: np.random.Generator) -> None:
    for length in (0, 1, 2, 17, 280):
        data = rng.bytes(length)
        assert checksum(data) == x25crc(data).crc


def test_their_parser_reads_every_field(rng: np.random.Generator) -> None:
    for sequence in (0, 7, 255):
        told = Odometry(
            int(rng.integers(2**60)),
            rng.normal(size=3),
            rng.normal(size=4),
            _symmetric(rng),
            rng.normal(size=6),
            _symmetric(rng),
            300,
            10,
        )
        read = parsed(framed(ODOMETRY, told.payload(), sequence, 9))
        assert (read.get_srcSystem(), read.get_srcComponent(), read.get_seq()) == (
            9,
            theirs.MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY,
            sequence,
        )
        assert read.time_usec == told.time_us
        np.testing.assert_allclose([read.x, read.y, read.z], told.position, rtol=1e-6)
        np.testing.assert_allclose(read.q, told.orientation, rtol=1e-6)
        speeds = [read.vx, read.vy, read.vz, read.rollspeed, read.pitchspeed, read.yawspeed]
        np.testing.assert_allclose(speeds, told.velocity, rtol=1e-6)
        np.testing.assert_allclose(read.pose_covariance, told.covariance[np.triu_indices(6)], rtol=1e-6)
        np.testing.assert_allclose(read.velocity_covariance, told.velocity_covariance[np.triu_indices(6)], rtol=1e-6)
        assert (read.frame_id, read.child_frame_id) == (theirs.MAV_FRAME_LOCAL_FRD, theirs.MAV_FRAME_BODY_FRD)
        assert (read.reset_counter, read.estimator_type, read.quality) == (
            300 % 256,
            theirs.MAV_ESTIMATOR_TYPE_MOCAP,
            10,
        )


def test_what_ends_in_zeros_is_cut_as_theirs_is() -> None:
    ours = framed(TIMESYNC, TIMESYNC.fields.pack(5, 0), 3, 1)
    writer = theirs.MAVLink(None, srcSystem=1, srcComponent=theirs.MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY)
    writer.seq = 3
    assert ours == bytes(theirs.MAVLink_timesync_message(5, 0).pack(writer))
    heartbeat = parsed(framed(HEARTBEAT, HEARTBEAT.fields.pack(*ALIVE), 0, 2))
    assert heartbeat.type == theirs.MAV_TYPE_ONBOARD_CONTROLLER
    assert heartbeat.autopilot == theirs.MAV_AUTOPILOT_INVALID
    assert heartbeat.system_status == theirs.MAV_STATE_ACTIVE


def test_what_they_write_is_read_and_what_is_damaged_is_not(rng: np.random.Generator) -> None:
    writer = theirs.MAVLink(None, srcSystem=4, srcComponent=1)
    datagram = bytes(theirs.MAVLink_timesync_message(0, 2**61 + 5).pack(writer))
    assert unframed(TIMESYNC, datagram) == (0, 2**61 + 5)
    assert unframed(HEARTBEAT, datagram) is None
    for place in range(1, len(datagram)):
        changed = bytearray(datagram)
        changed[place] ^= 1 + int(rng.integers(255))
        assert unframed(TIMESYNC, bytes(changed)) is None
        assert unframed(TIMESYNC, datagram[:place]) is None
    for length in range(40):
        unframed(TIMESYNC, b"\xfd" + rng.bytes(length))


def _symmetric(rng: np.random.Generator) -> np.ndarray:
    half = rng.normal(size=(6, 6))
    return half @ half.T
