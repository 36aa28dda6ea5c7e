"""Frame reports in the bytes of a recording's chunk: of each robot what coverage asks for, without decoding the rest.

A report is protobuf: fields, each behind a tag that tells its number and kind. Those that are not asked for are
skipped. What a server of ours never writes (a field twice, a number of another kind, a pose that is none) is called
odd, and left to the real decoder.
Formats: https://protobuf.dev/programming-guides/encoding, https://mcap.dev/spec.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.compiled import compiled

READ, ODD = 0, 1
_VARINT, _EIGHT, _BYTES, _FOUR = 0, 1, 2, 5  # kinds of fields
_CONTINUES, _SEVEN = np.uint8(0x80), np.uint8(0x7F)
_FINITE_M, _UNIT = 1e6, 1e-3  # as `decodable` has them: of positions, and of the length of quaternions
_STATES = 4
_MESSAGE, _RECORD_HEAD, _MESSAGE_HEAD = 5, 9, 22


class Robots(NamedTuple):
    """Whom to look for: ``names`` (r, most) their ids' bytes, and how many of them, ``lengths`` (r,); ``levers`` (r, 3)
    m, their tools' points.
    """

    names: NDArray[np.uint8]
    lengths: NDArray[np.int64]
    levers: Floats


class Columns(NamedTuple):
    """What n reports tell: ``times_ns`` (n,), ``found`` (n,) READ or ODD; and of r robots ``states`` (n, r),
    ``standings`` (n, r), ``points`` (n, r, 3) m, ``covariances`` (n, r, 6) as of `sightings.Told`.
    """

    times_ns: NDArray[np.int64]
    found: NDArray[np.int64]
    states: NDArray[np.int64]
    standings: NDArray[np.int64]
    points: Floats
    covariances: Floats

    @staticmethod
    def of(reports: int, robots: int) -> "Columns":
        """Empty ones."""
        times, found = np.zeros((2, reports), np.int64)
        states, standings = np.zeros((2, reports, robots), np.int64)
        points, covariances = np.zeros((reports, robots, 3)), np.zeros((reports, robots, 6))
        return Columns(times, found, states, standings, points, covariances)


class _Scratch(NamedTuple):
    """Bytes, and the same bytes as numbers: a covariance (36,), and a pose (7,)."""

    bytes36: NDArray[np.uint8]
    covariance: Floats
    bytes7: NDArray[np.uint8]
    pose: Floats


@compiled
def records_of(data):
    """The records in a chunk's bytes (n,): rows (records, 4) of opcode, channel (-1: no message), and where the body,
    or the message's payload, begins and ends. A last row of opcode -1 says that they are not whole.
    """
    rows = np.empty((len(data) // _RECORD_HEAD + 1, 4), np.int64)
    at, count = 0, 0
    while at < len(data):
        rows[count, 0] = -1
        if at + _RECORD_HEAD > len(data):
            return rows[: count + 1]
        length = 0
        for k in range(8):
            length |= np.int64(data[at + 1 + k]) << (8 * k)
        begin = at + _RECORD_HEAD
        if length < 0 or length > len(data) - begin or (data[at] == _MESSAGE and length < _MESSAGE_HEAD):
            return rows[: count + 1]
        channel, payload = -1, begin
        if data[at] == _MESSAGE:
            channel, payload = np.int64(data[begin]) | np.int64(data[begin + 1]) << 8, begin + _MESSAGE_HEAD
        rows[count, 0], rows[count, 1], rows[count, 2], rows[count, 3] = data[at], channel, payload, begin + length
        at, count = begin + length, count + 1
    return rows[:count]


@compiled
def read_reports(data, spans, robots, columns):
    """Read the reports whose payloads are between ``spans`` (n, 2) of a chunk's bytes into the columns."""
    bytes36, bytes7 = np.zeros(36 * 8, np.uint8), np.zeros(7 * 8, np.uint8)
    scratch = _Scratch(bytes36, bytes36.view(np.float64), bytes7, bytes7.view(np.float64))
    for n in range(len(spans)):
        columns.found[n] = READ if _report(data, spans[n, 0], spans[n, 1], robots, columns, n, scratch) else ODD


@compiled
def _report(data, at, end, robots, columns, n, scratch):
    """Read one report; False: it is odd."""
    guess = 0
    while at < end:
        number, kind, value, begin, at = _field(data, at, end)
        if at < 0:
            return False
        if number == 2:
            if kind != _EIGHT or value < 0:
                return False
            columns.times_ns[n] = value
        elif number == 8:
            if kind != _BYTES:
                return False
            guess = _robot(data, begin, at, robots, columns, n, (guess, scratch))
            if guess < 0:
                return False
    return True


@compiled
def _robot(data, at, end, robots, columns, n, more):
    """Read one robot; returns which may come next, -1: it is odd."""
    guess, scratch = more
    who, state, standing = -2, np.int64(0), np.int64(0)
    posed, spread, stands = False, False, False
    while at < end:
        number, kind, value, begin, at = _field(data, at, end)
        if at < 0:
            return -1
        if number == 1:
            if kind != _BYTES or who != -2:
                return -1
            who = _who(data, begin, at, robots, guess)
        elif number == 2:
            if kind != _VARINT:
                return -1
            state = value
        elif number == 4:
            if kind != _BYTES or posed or not _pose(data, begin, at, scratch):
                return -1
            posed = True
        elif number == 5:
            if kind != _BYTES or spread or at - begin != len(scratch.bytes36):
                return -1
            scratch.bytes36[:] = data[begin:at]
            spread = True
        elif number == 19:
            if kind != _BYTES or stands:
                return -1
            standing = _standing(data, begin, at)
            if standing < 0:
                return -1
            stands = True
    if who == -2 or not 0 < state <= _STATES or posed != spread:
        return -1
    if who < 0:
        return guess
    if columns.states[n, who] != 0:
        return -1
    columns.states[n, who], columns.standings[n, who] = state, standing
    if posed:
        _point(scratch, robots.levers[who], columns.points[n, who], columns.covariances[n, who])
    elif state <= 2:
        return -1
    return who + 1


@compiled
def _who(data, at, end, robots, guess):
    """Which robot these bytes name, -1 for none that is looked for; most often it is the guess."""
    for k in range(len(robots.lengths)):
        robot = (guess + k) % len(robots.lengths)
        if robots.lengths[robot] == end - at:
            same = True
            for j in range(end - at):
                same = same and robots.names[robot, j] == data[at + j]
            if same:
                return robot
    return -1


@compiled
def _pose(data, at, end, scratch):
    """Read position and orientation; False: they are no pose."""
    scratch.bytes7[:] = 0
    seen = 0
    while at < end:
        number, kind, _, begin, at = _field(data, at, end)
        if at < 0:
            return False
        if number in (1, 2):
            if kind != _BYTES or seen & number or not _doubles(data, begin, at, scratch.bytes7, 24 * (number - 1)):
                return False
            seen |= number
    p = scratch.pose
    length = np.sqrt(p[3] * p[3] + p[4] * p[4] + p[5] * p[5] + p[6] * p[6])
    near = abs(p[0]) < _FINITE_M and abs(p[1]) < _FINITE_M and abs(p[2]) < _FINITE_M
    return near and abs(length - 1.0) <= _UNIT


@compiled
def _doubles(data, at, end, into, offset):
    """Read the fields 1, 2, ... of a vector or quaternion; False: it is odd."""
    most = 3 if offset == 0 else 4
    while at < end:
        number, kind, _, begin, at = _field(data, at, end)
        if at < 0:
            return False
        if 1 <= number <= most:
            if kind != _EIGHT:
                return False
            into[offset + 8 * (number - 1) : offset + 8 * number] = data[begin:at]
    return True


@compiled
def _standing(data, at, end):
    """How a robot stands on the surface; -1: it is odd."""
    standing = np.int64(0)
    while at < end:
        number, kind, value, _, at = _field(data, at, end)
        if at < 0:
            return np.int64(-1)
        if number == 1:
            if kind != _VARINT or not 0 <= value <= 0x7FFFFFFF:
                return np.int64(-1)
            standing = value
    return standing


@compiled
def _point(scratch, lever, point, covariance):
    """The tool's point, and its covariance: a small turn w about the parent's axes moves it by w x (R lever)."""
    x, y, z, w = scratch.pose[3], scratch.pose[4], scratch.pose[5], scratch.pose[6]
    scale = 2.0 / (x * x + y * y + z * z + w * w)
    arm = np.empty(3)
    arm[0] = lever[0] + scale * (-(y * y + z * z) * lever[0] + (x * y - z * w) * lever[1] + (x * z + y * w) * lever[2])
    arm[1] = lever[1] + scale * ((x * y + z * w) * lever[0] - (x * x + z * z) * lever[1] + (y * z - x * w) * lever[2])
    arm[2] = lever[2] + scale * ((x * z - y * w) * lever[0] + (y * z + x * w) * lever[1] - (x * x + y * y) * lever[2])
    jacobian = np.zeros((3, 6))
    for k in range(3):
        point[k] = scratch.pose[k] + arm[k]
        jacobian[k, k] = 1.0
    jacobian[0, 4], jacobian[0, 5] = arm[2], -arm[1]
    jacobian[1, 3], jacobian[1, 5] = -arm[2], arm[0]
    jacobian[2, 3], jacobian[2, 4] = arm[1], -arm[0]
    half = np.zeros((3, 6))
    for i in range(3):
        for j in range(6):
            for k in range(6):
                half[i, j] += jacobian[i, k] * scratch.covariance[6 * k + j]
    at = 0
    for i in range(3):
        for j in range(i, 3):
            total = 0.0
            for k in range(6):
                total += half[i, k] * jacobian[j, k]
            covariance[at] = total
            at += 1


@compiled
def _field(data, at, end):
    """The next field: its number and kind, and what `_value` says of it; -1 where it is not whole."""
    number, kind, at = _tag(data, at, end)
    if at < 0:
        return 0, 0, np.int64(0), -1, -1
    value, begin, at = _value(data, at, end, kind)
    return number, kind, value, begin, at


@compiled
def _tag(data, at, end):
    """A field's number and kind, and where its value begins; -1: it has none that is whole."""
    value, at = _varint(data, at, end)
    if at < 0 or value < 8 or value > 0xFFFFFFFF:
        return 0, 0, -1
    return value >> 3, value & 7, at


@compiled
def _value(data, at, end, kind):
    """A field's number where it has one that is whole, where its bytes begin, and where it ends; -1: it is not whole,
    or of a kind that nobody writes any more.
    """
    if kind == _VARINT:
        value, after = _varint(data, at, end)
        return value, at, after
    length = np.int64(8)
    if kind == _FOUR:
        length = np.int64(4)
    elif kind == _BYTES:
        length, at = _varint(data, at, end)
        if at < 0:
            return np.int64(0), -1, -1
    elif kind != _EIGHT:
        return np.int64(0), -1, -1
    if length < 0 or length > end - at:
        return np.int64(0), -1, -1
    value = np.int64(0)
    if kind == _EIGHT:
        for k in range(8):
            value |= np.int64(data[at + k]) << (8 * k)
    return value, at, at + length


@compiled
def _varint(data, at, end):
    """A number of up to ten bytes, and where it ends; -1: it is not whole."""
    value, shift = np.int64(0), 0
    while at < end and shift < 70:
        part = data[at]
        at += 1
        value |= np.int64(part & _SEVEN) << shift
        if not part & _CONTINUES:
            return value, at
        shift += 7
    return value, -1
