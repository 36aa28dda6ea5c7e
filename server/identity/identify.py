"""Who is who: warm where robots were a moment ago, cold for the rest, doubts kept as doubts."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats
from asterism.server.centres.blobs import Blobs, Ints
from asterism.server.identity.cold import find
from asterism.server.identity.follow import follow, gates_px, gather_missing
from asterism.server.identity.plan import Plan
from asterism.server.identity.search import Spots
from asterism.server.pose.fit import LEDS
from asterism.server.pose.planar import NO_SOLUTION
from asterism.server.pose.track import HEIGHT, Tracks, predict

WIDEST_GATE = 0.25  # of a constellation's image; beyond that a prediction is no help
GATHER_PX = 1.5  # a found robot's missing LED is looked for this near to its place


@dataclass(slots=True, eq=False)
class Matches:
    """Robots with their spots: row i of every array is the same robot.

    ``robots`` (m,) indices into the rig; ``assignment`` (m, 6) rows of the frame's blobs, -1 for LEDs not seen;
    ``rotations`` (m, 3, 3), ``ts`` (m, 3) T_camera_plane; ``is_warm`` (m,). ``doubts`` says why a robot that is not
    among them is ambiguous.
    """

    robots: Ints
    assignment: Ints
    rotations: Floats
    ts: Floats
    is_warm: NDArray[np.bool_]
    doubts: dict[int, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """The kept spots as the matching sees them; row i is blob ``rows[i]``."""

    rows: Ints
    flat: Floats  # (n, 2) ideal px about the principal point, y up
    rays: Floats  # (n, 2) x / z, y / z
    covariances: Floats  # (n, 3) of the rays
    variances: Floats  # (n,) of the rays, mean of both axes
    heights: Floats  # (n,)
    radii: Floats  # (n,) px


def rays_of(blobs: Blobs, rows: Ints, rays: Floats, covariances: Floats, focal: float) -> Rays:
    """Collect what the matching needs of the kept spots."""
    flat = rays * np.array([focal, -focal])
    variances = 0.5 * (covariances[:, 0] + covariances[:, 2])
    return Rays(rows, flat, rays, covariances, variances, blobs.heights[rows], blobs.radii_px[rows])


def identify(seen: Rays, plan: Plan, tracks: Tracks, exposed_ns: int) -> Matches:
    """Match spots to robots: those that were there a moment ago first, the rest searched cold."""
    n_robots = len(plan.layouts)
    free = np.ones(len(seen.rows), np.bool_)
    robots, assignment, rotations, ts = _follow(seen, free, plan, tracks, exposed_ns)
    warm = np.ones(len(robots), np.bool_)
    doubts: dict[int, str] = {}
    if len(robots) < n_robots and int(free.sum()) >= 4:
        known = np.zeros(n_robots, np.bool_)
        known[robots] = True
        found, doubts = find(Spots(seen.flat, seen.rays, seen.variances, seen.heights, seen.radii, free), plan, known)
        if found:
            robots = np.concatenate([robots, [entry[0] for entry in found]])
            assignment = np.concatenate([assignment, [entry[1] for entry in found]])
            rotations = np.concatenate([rotations, [entry[2] for entry in found]])
            ts = np.concatenate([ts, [entry[3] for entry in found]])
            warm = np.concatenate([warm, np.zeros(len(found), np.bool_)])
    return Matches(robots, assignment, rotations, ts, warm, doubts)


def _follow(
    seen: Rays, free: NDArray[np.bool_], plan: Plan, tracks: Tracks, exposed_ns: int
) -> tuple[Ints, Ints, Floats, Floats]:
    """Warm matching of the robots whose prediction is good enough: robots, spots, rotations, translations."""
    n = len(plan.layouts)
    index, rotations, ts, sigmas = np.empty(n, np.int64), np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, 2))
    count = predict(
        tracks.seen_ns, tracks.rotations, tracks.ts, tracks.velocities, tracks.turns, tracks.numbers, exposed_ns,
        index, rotations, ts, sigmas,
    )  # fmt: skip
    index, rotations, ts, sigmas = index[:count], rotations[:count], ts[:count], sigmas[:count]
    depths, extents = np.maximum(ts[:, 2], 1e-6), plan.extents[index]
    gates = gates_px(sigmas[:, 0], sigmas[:, 1], extents, plan.focal, depths)
    usable = (ts[:, 2] > 0.0) & (gates <= WIDEST_GATE * extents * plan.focal / depths)
    if not usable.all():
        index, rotations, ts, gates = index[usable], rotations[usable], ts[usable], gates[usable]
    heights = tracks.numbers[index, HEIGHT]
    assignment, costs = np.full((len(index), LEDS), -1), np.empty(len(index))
    layouts = plan.layouts[index]
    follow(
        seen.flat, seen.rays, seen.variances, seen.heights, free, layouts, plan.optics[index], rotations, ts,
        gates, heights, plan.focal, assignment, costs,
    )  # fmt: skip
    gather_missing(
        seen.flat, seen.heights, free, layouts, rotations, ts, costs, heights, plan.focal, GATHER_PX, assignment,
    )  # fmt: skip
    good = costs < NO_SOLUTION
    return index[good], assignment[good], rotations[good], ts[good]
