"""What a client takes for a pose: a forged or damaged message must not drive a robot."""

import math
from operator import mul

from asterism.protocol.geometry import Floats
from asterism.protocol.messages import RobotPose

LOCATED = ("TRACKED", "TILT_AMBIGUOUS")
LEDS = range(4, 7)  # that a pose can rest on, ...
JOINED = range(3, 7)  # ... where cameras are joined: several may each see the same three
LONGEST_S = 600.0  # from exposure to publishing
_NS = 1 << 63
UNEVEN = 1e-6  # of a covariance's two halves, as a correlation
MOST = 1e9  # m, m/s, rad/s: what is computed from such numbers stays finite


def problem(pose: RobotPose, robot: str) -> str | None:
    """Why that is no pose of ``robot``, or None if it may be one."""
    if pose.robot != robot:
        return f"is of robot {pose.robot[:40]!r}"
    if pose.state not in LOCATED:
        return f"has state {pose.state[:40]!r}, expected {' or '.join(LOCATED)}"
    leds = JOINED if pose.cameras else LEDS
    if pose.leds not in leds:
        return f"rests on {_number(pose.leds)} LEDs, expected {leds[0]} to {leds[-1]}"
    if not _is_within(pose.position, MOST):
        return f"has a position that is not finite, or beyond {MOST:g} m"
    if not 0.0 <= pose.rms_px <= MOST:
        return f"has residuals of {pose.rms_px} px"
    if not (_is_within(pose.covariance.ravel(), MOST**2) and is_covariance(pose.covariance)):
        return "has a covariance that is none"
    velocity = pose.velocity
    if velocity is not None and not (
        _is_within(velocity.linear, MOST)
        and _is_within(velocity.angular, MOST)
        and _is_within(velocity.covariance.ravel(), MOST**2)
        and is_covariance(velocity.covariance)
        and all(0.0 <= density <= MOST for density in velocity.accelerations)
    ):
        return "has a velocity that is none"
    return _times(pose)


def is_covariance(matrix: Floats) -> bool:
    """Finite, symmetric, with variances above 0 in every direction but for rounding: (n, n)."""
    rows = matrix.tolist()  # plain numbers: numpy is slow at small arrays
    variances = [rows[k][k] for k in range(len(rows))]
    if not all(0.0 < variance < math.inf for variance in variances):
        return False
    sigmas = [math.sqrt(variance) for variance in variances]
    factor: list[list[float]] = []  # Cholesky's, of the correlations
    for i, row in enumerate(rows):
        line: list[float] = []
        for j in range(i):
            most = sigmas[i] * sigmas[j]
            if not (abs(row[j]) <= (1.0 + UNEVEN) * most and abs(row[j] - rows[j][i]) <= UNEVEN * most):
                return False
            told = sum(map(mul, line, factor[j]))  # of as many as the shorter one has
            line.append((row[j] / most - told) / factor[j][j])
        left = 1.0 + UNEVEN - sum(map(mul, line, line))
        if left <= 0.0:
            return False
        factor.append([*line, math.sqrt(left)])
    return True


def _is_within(vector: Floats, most: float) -> bool:
    return all(abs(number) <= most for number in vector.tolist())


def _times(pose: RobotPose) -> str | None:
    if not 0 <= pose.sequence < 2 * _NS:
        return f"has sequence {_number(pose.sequence)}"
    if not 0 <= pose.session < 2 * _NS:
        return f"has session {_number(pose.session)}"
    if not (0 < pose.exposed_ns < _NS and 0 <= pose.published_ns < _NS):
        return f"was exposed at {_number(pose.exposed_ns)} and published at {_number(pose.published_ns)} ns"
    took_s = (pose.published_ns - pose.exposed_ns) * 1e-9
    if not 0.0 <= took_s <= LONGEST_S:
        return f"was published {took_s:.3f} s after exposure, expected 0 to {LONGEST_S:.0f}"
    return None


def _number(value: int) -> str:
    """A whole number, if it is not absurdly long."""
    return str(value) if abs(value) < 10 * _NS else "a number of many digits"
