"""A map -> the message that tells it: what changed since the one before, or all."""

import numpy as np
from numpy.typing import NDArray

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import set_report_pose
from asterism.server.coverage.visits import CoverageMap, Visits


def told(covered: CoverageMap, before: CoverageMap | None, session: int) -> "pb.Coverage":
    """What changed since ``before``; all where that is None, or on another grid."""
    grid = covered.grid
    if before is not None and before.grid.box != grid.box:
        before = None
    message = pb.Coverage(
        session=session,
        since_ns=covered.since_ns,
        exposed_ns=covered.until_ns,
        x0=(grid.box.column + 0.5) * grid.pitch_m,
        y0=(grid.box.row + 0.5) * grid.pitch_m,
        pitch=grid.pitch_m,
        columns=grid.box.shape[1],
        rows=grid.box.shape[0],
        whole=before is None,
    )
    set_report_pose(message.frame, grid.surface.T_world_surface)
    for robot, visits in covered.robots.items():
        earlier = before.robots.get(robot) if before is not None else None
        changed = visits.visited if earlier is None else visits.dwell_s != earlier.dwell_s
        _tell(message.robots.add(robot=robot), visits, np.flatnonzero(changed))
    return message


def _tell(entry: "pb.CoverageOf", visits: Visits, patches: NDArray[np.int64]) -> None:
    dwell, path = visits.dwell_s.ravel()[patches], visits.path_m.ravel()[patches]
    shift = visits.shift_m.reshape(-1, 2)[patches]
    entry.patch.extend(patches.tolist())
    entry.dwell_s.extend(dwell.tolist())
    entry.passes.extend(visits.passes.ravel()[patches].tolist())
    entry.speed.extend((path / dwell).tolist())
    entry.direction.extend(np.arctan2(shift[:, 1], shift[:, 0]).tolist())
    entry.last_ns.extend(visits.last_ns.ravel()[patches].tolist())
    for reason, count in visits.left_out.items():
        entry.left_out[reason] = count
    entry.radius, entry.counted, entry.counted_s = visits.radius_m, visits.counted, visits.counted_s
