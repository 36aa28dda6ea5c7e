"""Drives with known poses and velocities: robots on wheels, on a curved surface under a camera.

A robot drives straight or in circles, creeps, turns on the spot, stands, and stops within a few hundredths of a second;
some have wheels that never run quite evenly. Errors of poses are drawn from covariances as the chain tells them: those
of six centres, carried through the pose.
"""

from dataclasses import dataclass

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.server.chain.turns import exp_rotations, hats, log_rotations

FINE_S = 1.0 / 1200.0  # of the sums: whole steps a frame at 30, 60 and 120 Hz
CAMERA = np.array([0.0, 0.0, 1.3])  # m, looking down
FOCAL_PX = 1400.0
RADIUS_M = 1.2  # of the surface
HEIGHT_M = 0.02  # of a robot's origin above it
ROOM_M = 0.3  # robots turn back beyond
LEDS = 1e-3 * np.array(
    [[-24, -28.5, 12], [23, 32, 12], [2, 32, 12], [10, -14.5, 12], [38.5, -26.5, 12], [-26, 25.5, 12]]
)
KINDS = ("stand", "straight", "circle", "spot turn", "creep", "change")
STAND, STRAIGHT, CIRCLE, SPOT, CREEP, CHANGE = range(len(KINDS))


@dataclass(frozen=True, slots=True, eq=False)
class Drives:
    """n drives of k frames: ``positions`` (k, n, 3) m, ``rotations`` (k, n, 3, 3), ``twists`` (k, n, 6) m/s and rad/s
    of the robot's own axes; ``manners`` (k, n): what the robot does there, CHANGE while it starts, stops or changes,
    and for 0.15 s after.
    """

    rate_hz: float
    positions: Floats
    rotations: Floats
    twists: Floats
    manners: Floats

    @property
    def dt(self) -> float:
        """s."""
        return 1.0 / self.rate_hz


def drives(rng: np.random.Generator, count: int, seconds: float, rate_hz: float) -> Drives:
    """As many drives, each its own."""
    speeds, turns, manners = zip(*(_wheels(rng, round(seconds / FINE_S) + 2) for _ in range(count)), strict=True)
    speed, turn = np.array(speeds).T, np.array(turns).T
    positions, rotations = _on_surface(rng, speed, turn)
    at = np.round(np.arange(int(seconds * rate_hz)) / rate_hz / FINE_S).astype(int) + 1
    linear = (positions[at + 1] - positions[at - 1]) / (2.0 * FINE_S)
    angular = log_rotations(rotations[at + 1] @ np.swapaxes(rotations[at - 1], -1, -2)) / (2.0 * FINE_S)
    back = np.swapaxes(rotations[at], -1, -2)
    twists = np.concatenate([(back @ linear[..., None])[..., 0], (back @ angular[..., None])[..., 0]], axis=-1)
    return Drives(rate_hz, positions[at], rotations[at], twists, np.array(manners).T[at])


def _wheels(rng: np.random.Generator, steps: int) -> tuple[Floats, Floats, Floats]:
    """Speed, turn rate and manner of one robot at every fine step; a robot outside its room drives back."""
    speed, turn, manner = np.zeros(steps), np.zeros(steps), np.full(steps, STAND)
    at, v, w = 0, 0.0, 0.0
    heading, place = rng.uniform(-np.pi, np.pi), rng.uniform(-0.7, 0.7, 2) * ROOM_M
    begin = [*place, heading]
    uneven = 0.04 if rng.random() < 0.5 else 0.0
    while at < steps:
        kind = int(rng.choice(5, p=[0.25, 0.2, 0.25, 0.2, 0.1]))
        there_v, there_w = _wanted(rng, kind)
        if there_v * (np.cos(heading) * place[0] + np.sin(heading) * place[1]) > 0.0:
            there_v, there_w = -there_v, -there_w
        # Wheels that are told to go start within tenths of a second, and may stop within hundredths.
        ramp_s = rng.uniform(0.02, 0.1) if kind == STAND and rng.random() < 0.5 else rng.uniform(0.1, 0.5)
        ramp, stay = round(ramp_s / FINE_S), round(rng.uniform(0.5, 2.5) / FINE_S)
        share = np.minimum(np.arange(1, ramp + stay + 1) / ramp, 1.0)[: steps - at]
        going = (v + share * (there_v - v)) * (1.0 + uneven * _wander(rng, len(share)))
        turning = (w + share * (there_w - w)) * (1.0 + uneven * _wander(rng, len(share)))
        along = heading + np.cumsum(turning) * FINE_S
        path = place + FINE_S * np.cumsum(going[:, None] * np.stack([np.cos(along), np.sin(along)], axis=-1), axis=0)
        away = np.linalg.norm(path, axis=-1)
        n = len(share)
        if kind != STAND and (away[ramp:] > ROOM_M).any():
            n = min(n, ramp + max(int(np.argmax(away[ramp:] > ROOM_M)), round(0.2 / FINE_S)))
        speed[at : at + n], turn[at : at + n], manner[at : at + n] = going[:n], turning[:n], kind
        manner[at : at + min(ramp + round(0.15 / FINE_S), n)] = CHANGE
        heading, place, v, w, at = float(along[n - 1]), path[n - 1], float(going[n - 1]), float(turning[n - 1]), at + n
    return np.append(speed, begin), turn, manner


def _wanted(rng: np.random.Generator, kind: int) -> tuple[float, float]:
    """Speed m/s and turn rate rad/s."""
    side = rng.choice([-1.0, 1.0])
    speed = rng.uniform(0.03, 0.3)
    return {
        STAND: (0.0, 0.0),
        STRAIGHT: (speed, 0.0),
        CIRCLE: (speed, side * speed / rng.uniform(0.1, 0.5)),
        SPOT: (0.0, side * rng.uniform(0.3, 3.0)),
        CREEP: (rng.uniform(0.002, 0.02), side * rng.uniform(0.0, 0.1)),
    }[kind]


def _wander(rng: np.random.Generator, steps: int) -> Floats:
    """Noise of unit variance that changes within some 30 ms."""
    coarse = rng.standard_normal(steps // 30 + 3)
    return np.interp(np.arange(steps) / 30.0, np.arange(len(coarse)), coarse)


def _on_surface(rng: np.random.Generator, speed: Floats, turn: Floats) -> tuple[Floats, Floats]:
    """Positions and rotations on a dome, by speed (steps + 3, n), whose last rows are where each begins, and turns."""
    x0, y0, heading0 = speed[-3:]
    speed = speed[:-3]
    heading = heading0 + np.cumsum(turn, axis=0) * FINE_S
    x = x0 + np.cumsum(speed * np.cos(heading), axis=0) * FINE_S
    y = y0 + np.cumsum(speed * np.sin(heading), axis=0) * FINE_S
    normal = np.stack([x / RADIUS_M, y / RADIUS_M, np.ones_like(x)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    forward = np.stack([np.cos(heading), np.sin(heading), np.zeros_like(x)], axis=-1)
    forward -= np.sum(forward * normal, axis=-1, keepdims=True) * normal
    forward /= np.linalg.norm(forward, axis=-1, keepdims=True)
    places = np.stack([x, y, -(x**2 + y**2) / (2.0 * RADIUS_M)], axis=-1) + HEIGHT_M * normal
    return places, np.stack([forward, np.cross(normal, forward), normal], axis=-1)


def covariances_of(positions: Floats, rotations: Floats, sigma_px: float) -> Floats:
    """Covariances (..., 6, 6) of poses whose LEDs' centres are off by ``sigma_px`` each."""
    arms = LEDS @ np.swapaxes(rotations, -1, -2)
    seen = positions[..., None, :] + arms - CAMERA
    x, y, z = seen[..., 0], seen[..., 1], seen[..., 2]
    by_point = np.zeros((*x.shape, 2, 3))
    by_point[..., 0, 0] = by_point[..., 1, 1] = FOCAL_PX / z
    by_point[..., 0, 2], by_point[..., 1, 2] = -FOCAL_PX * x / z**2, -FOCAL_PX * y / z**2
    by_pose = np.concatenate([by_point, -by_point @ hats(arms)], axis=-1)
    normal = np.sum(np.swapaxes(by_pose, -1, -2) @ by_pose, axis=-3)
    told: Floats = sigma_px**2 * np.linalg.inv(normal)
    return told


def drawn(rng: np.random.Generator, positions: Floats, rotations: Floats, covariances: Floats) -> tuple[Floats, Floats]:
    """Positions and rotations (..., 3), (..., 3, 3) with errors of these covariances."""
    errors = (np.linalg.cholesky(covariances) @ rng.standard_normal((*positions.shape[:-1], 6, 1)))[..., 0]
    return positions + errors[..., :3], exp_rotations(errors[..., 3:]) @ rotations
