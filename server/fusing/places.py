"""Whether cameras stand where their rigs say, by the robots that several of them see: averaged over time and robots.

Every robot that several cameras see ties their places together: with J_c the derivatives of camera c's rays by the
robot's pose, D_c those by the camera's place, W the rays' information and r the residuals, the pose taken out leaves

    M_cd = [c = d] D_c' W D_c - D_c' W J_c N^-1 J_d' W D_d,    b_c = D_c' W r_c - D_c' W J_c N^-1 sum J_d' W r_d

with N = sum J_c' W J_c, normal equations of how far all cameras are off. Sums over robots and exposures, slowly
forgotten, see what the noise of one exposure hides. Camera c alone is off by M_cc^-1 b_c, which lowers chi squared by
b_c' M_cc^-1 b_c: the camera that explains nearly all is to blame, if no other does. Of two cameras
nobody can know which.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.server.compiled import compiled
from asterism.server.fusing.joint_rays import linearize, work_room
from asterism.server.pose.covariance import invert

FORGET_S = 3.0
LEAST_S = 0.5  # of exposures, before a camera is blamed, ...
LEAST_APART_S = 0.1  # ... and before two are told to be apart: poses of both would be too sure of themselves
OFF, AGREES = 60.0, 20.0  # chi squared, six degrees of freedom, from which a camera is off, and below which it is not
BLAMED = 4.0  # times what it leaves unexplained every other leaves, before a camera is to blame
STEADY = 1e-9
# What nobody can know of a place, nor needs to: of spots' errors that stay, as how they lie on the pixels.
FLOOR = np.diag([3e-6] * 3 + [3e-6] * 3) ** 2


@dataclass(frozen=True, slots=True, eq=False)
class Misplaced:
    """A camera that is not where its rig says: by how much, m and rad, and since when."""

    off_m: float
    off_rad: float
    since_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """``normal`` (6 c, 6 c) and ``right`` (6 c,) as above, of ``cameras`` in this order, at ``at_ns``; ``seconds`` of
    exposures are in them, and which share of the rays' variances ``stays`` from frame to frame. ``misplaced`` are
    cameras found to be off; ``apart`` is how far two cameras, where there are no more, are off against each other.
    """

    cameras: tuple[str, ...] = ()
    normal: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    right: Floats = field(default_factory=lambda: np.zeros(0))
    ties: float = 0.0
    stays: float = 0.0
    seconds: float = 0.0
    at_ns: int = 0
    misplaced: Mapping[str, Misplaced] = field(default_factory=dict)
    apart: Misplaced | None = None

    def later(self, cameras: Sequence[str], exposed_ns: int) -> "Places":
        """The same at an exposure, with what is forgotten by then; of other cameras than before nothing is known."""
        names = tuple(cameras)
        gone_s = (exposed_ns - self.at_ns) * 1e-9
        if names != self.cameras or not 0.0 <= gone_s < FORGET_S:
            c = len(names)
            kept = {name: found for name, found in self.misplaced.items() if name in names}
            return Places(names, np.zeros((6 * c, 6 * c)), np.zeros(6 * c), at_ns=exposed_ns, misplaced=kept)
        keep = math.exp(-gone_s / FORGET_S)
        return replace(
            self, normal=keep * self.normal, right=keep * self.right, ties=keep * self.ties, stays=keep * self.stays,
            seconds=keep * self.seconds + gone_s, at_ns=exposed_ns,
        )  # fmt: skip


@compiled
def add_ties(eyes, bodies, bundle, motion, poses, normal, right):
    """Add to ``normal`` and ``right`` what robots at their ``poses`` tell of cameras' places. Returns how many, and the
    sum of the shares of their rays' variances that stay.
    """
    c = eyes.ts.shape[0]
    count, stays = 0.0, 0.0
    across, half, towards = np.empty((6 * c, 6)), np.empty((6 * c, 6)), np.empty(6)
    pose, inverse = np.empty((6, 6)), np.empty((6, 6))
    for k in range(bundle.bodies.shape[0]):
        begin, end = bundle.first[k], bundle.first[k + 1]
        work = work_room(end - begin)
        if end == begin or not linearize(
            k, (poses.rotations[k], poses.ts[k]), eyes, bodies, bundle, motion, work, True
        ):
            continue
        pose[:, :] = across[:, :] = 0.0
        towards[:] = 0.0
        share = 0.0
        for i in range(end - begin):
            first = 6 * bundle.cameras[begin + i]
            own = bundle.covariances[begin + i]
            led, time2 = work.by_led[i, 0], bundle.times[begin + i] ** 2
            extra = bundle.misfits[k] ** 2 * (led[0] ** 2 + led[1] ** 2 + led[2] ** 2)
            share += extra / (extra + own[0])
            for j in range(6):
                # What is not known of the robot's motion, roughly: of rays of another time.
                extra += time2 * work.by_pose[i, 0, j] ** 2 * motion.covariances[k, j, j]
            xx, xy, yy = own[0] + extra, own[1], own[2] + extra
            det = xx * yy - xy * xy
            a, b, d = yy / det, -xy / det, xx / det
            u, v, p, q = work.by_pose[i, 0], work.by_pose[i, 1], work.by_place[i, 0], work.by_place[i, 1]
            e, f = work.off[i, 0], work.off[i, 1]
            for j in range(6):
                uj, vj, pj, qj = a * u[j] + b * v[j], b * u[j] + d * v[j], a * p[j] + b * q[j], b * p[j] + d * q[j]
                towards[j] += uj * e + vj * f
                right[first + j] += pj * e + qj * f
                for h in range(6):
                    pose[j, h] += uj * u[h] + vj * v[h]
                    across[first + j, h] += pj * u[h] + qj * v[h]
                    normal[first + j, first + h] += pj * p[h] + qj * q[h]
        invert(pose, inverse)
        for i in range(6 * c):
            for j in range(6):
                half[i, j] = 0.0
                for h in range(6):
                    half[i, j] += across[i, h] * inverse[h, j]
                right[i] -= half[i, j] * towards[j]
            for m in range(6 * c):
                for j in range(6):
                    normal[i, m] -= half[i, j] * across[m, j]
        count += 1.0
        stays += share / (end - begin)
    return count, stays


def judged(places: Places, covariances: Floats, robots: int) -> Places:
    """The places with the cameras that are off by what is known now; ``covariances`` (c, 6, 6) are those of their
    places as their rigs tell them.
    """
    c = len(places.cameras)
    if places.seconds < (LEAST_S if c > 2 else LEAST_APART_S):
        return places
    if c == 2:
        move, score, _ = _alone(places, 0, covariances, robots)
        found = Misplaced(_length(move[:3]), _length(move[3:]), places.at_ns)
        return replace(places, apart=found if score > (AGREES if places.apart else OFF) else None)
    alone = [_alone(places, k, covariances, robots) for k in range(c)]
    misplaced = dict(places.misplaced)
    for name, (move, score, _) in zip(places.cameras, alone, strict=True):
        if name in misplaced:
            if score < AGREES:
                del misplaced[name]
            else:
                misplaced[name] = replace(misplaced[name], off_m=_length(move[:3]), off_rad=_length(move[3:]))
    worst = max(range(c), key=lambda k: alone[k][2])
    name, (move, score, gain) = places.cameras[worst], alone[worst]
    second = max(alone[k][2] for k in range(c) if k != worst)
    if name not in misplaced and score > OFF and c - len(misplaced) > 2 and _explains(places, gain, second):
        misplaced[name] = Misplaced(_length(move[:3]), _length(move[3:]), places.at_ns)
    return replace(places, misplaced=misplaced)


def _explains(places: Places, gain: float, second: float) -> bool:
    """Whether one camera being off explains nearly all that any cameras' being off explains, and no other does."""
    normal = places.normal + STEADY * np.diag(np.diag(places.normal))
    normal += STEADY * np.trace(normal) * np.eye(len(normal))
    total = float(places.right @ np.linalg.solve(normal, places.right))
    return total - second > BLAMED * max(total - gain, 0.0)


def _length(vector: Floats) -> float:
    return float(np.linalg.norm(vector))


def _alone(places: Places, k: int, covariances: Floats, robots: int) -> tuple[Floats, float, float]:
    """How far camera k alone is off (6,), chi squared of that, and by how much it lowers that of all residuals."""
    rows = slice(6 * k, 6 * k + 6)
    block, right = places.normal[rows, rows], places.right[rows]
    known = np.trace(block) > 0.0
    if not known:
        return np.zeros(6), 0.0, 0.0
    noise = np.linalg.inv(block + STEADY * np.diag(np.diag(block)))
    move = noise @ right
    others = np.delete(covariances, k, axis=0).mean(axis=0)
    # Errors that stay are as many as robots, however many exposures there are.
    share = places.stays / max(places.ties, 1e-9)
    staying = noise * share * places.ties / max(robots, 1)
    spread = noise + staying + covariances[k] + others + FLOOR
    return move, float(move @ np.linalg.solve(spread, move)), float(right @ move)
