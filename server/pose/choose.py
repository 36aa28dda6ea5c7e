"""Which of a plane's two poses it is: by what the spots say, and by what is known beforehand.

Beforehand are known the pose a moment ago, and the surface's normal if the rig tells it. Both candidates stay, with
their odds; poses that face away are out already. The chosen one is expressed in the parent frame.
"""

import math

import numpy as np

from asterism.server.compiled import compiled
from asterism.server.pose.fit import median_of
from asterism.server.pose.planar import NO_SOLUTION
from asterism.server.pose.rotations import product_into, quat_into
from asterism.server.pose.solve import move_origin, turn_axes
from asterism.server.pose.track import EVIDENCE, HAS_OTHER, TURN_SIGMA, follow_track, is_fresh, tilt_cost

MOST_ODDS = 1e12
NORMAL_SIGMA = math.radians(2.0)  # how soft the edge of a robot's cone of normals is


@compiled
def axis_cost(axis, wanted, within):
    """Squared sigmas by which a direction (3,) leaves the cone of half angle ``within`` rad around a wanted one."""
    dot = axis[0] * wanted[0] + axis[1] * wanted[1] + axis[2] * wanted[2]
    off = math.acos(min(max(dot, -1.0), 1.0)) - within
    return (off / NORMAL_SIGMA) ** 2 if off > 0.0 else 0.0


@compiled
def choose(
    robots, exposed_ns, rotations, ts, costs, covariances, assignment, heights,
    view, eye, plane_rotations, plane_origins, axes, normals, within,
    seen_ns, track_rotations, track_ts, velocities, turns, other_rotations, numbers,
    best, odds, positions, quaternions, parent_covariances,
):  # fmt: skip
    """Choose for every solved robot, and write its track.

    ``robots`` (m,) indices into the rig; ``rotations`` (m, 2, 3, 3), ``ts`` (m, 2, 3), ``costs`` (m, 2) and
    ``covariances`` (m, 2, 6, 6) as `solve.solve_robots` fills them; ``assignment`` (m, 6) and
    ``heights`` (n,) of the spots. ``view`` (3, 3)
    and ``eye`` (3,) are T_parent_camera. Per robot of the rig: ``plane_rotations`` (k, 3, 3) and ``plane_origins``
    (k, 3) = T_robot_plane, ``axes`` (k, 3) of the LEDs in the plane's frame, ``normals`` (k, 3) in the parent frame
    with ``within`` (k,) rad, negative where there is no prior. Then the tracks, which are changed.

    Fills ``best`` (m,) (-1: no pose at all), ``odds`` (m,) over the other candidate (MOST_ODDS if there is none),
    ``positions`` (m, 2, 3), ``quaternions`` (m, 2, 4) x y z w of T_parent_robot, the chosen one first, and
    ``parent_covariances`` (m, 6, 6) of the chosen one.
    """
    totals = np.empty(2)
    turn, parent, axis, arm = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(3)
    inverse = np.empty((3, 3))
    for k in range(robots.shape[0]):
        robot = robots[k]
        known = numbers[robot]
        fresh = is_fresh(seen_ns[robot], exposed_ns)
        for which in range(2):
            totals[which] = costs[k, which]
            if costs[k, which] >= NO_SOLUTION:
                continue
            rotation = rotations[k, which]
            if fresh:
                totals[which] += tilt_cost(
                    rotation, track_rotations[robot], turns[robot], known[TURN_SIGMA], other_rotations[robot],
                    known[HAS_OTHER], known[EVIDENCE], (exposed_ns - seen_ns[robot]) * 1e-9,
                )  # fmt: skip
            if within[robot] >= 0.0:
                product_into(view, rotation, turn)
                for i in range(3):
                    axis[i] = 0.0
                    for j in range(3):
                        axis[i] += turn[i, j] * axes[robot, j]
                totals[which] += axis_cost(axis, normals[robot], within[robot])
        chosen = 0 if totals[0] <= totals[1] else 1
        if totals[chosen] >= NO_SOLUTION:
            best[k] = -1
            continue
        other = 1 - chosen
        has_other = costs[k, other] < NO_SOLUTION
        best[k] = chosen
        evidence = 0.5 * (min(totals[other], NO_SOLUTION) - totals[chosen])
        odds[k] = math.exp(min(evidence, math.log(MOST_ODDS)))
        for i in range(3):
            for j in range(3):
                inverse[i, j] = plane_rotations[robot, j, i]
        for place in range(2):
            which = chosen if place == 0 else other
            if costs[k, which] >= NO_SOLUTION:
                continue
            product_into(rotations[k, which], inverse, turn)  # R_camera_robot
            for i in range(3):
                arm[i] = 0.0
                for j in range(3):
                    arm[i] -= turn[i, j] * plane_origins[robot, j]
            for i in range(3):
                positions[k, place, i] = eye[i]
                for j in range(3):
                    positions[k, place, i] += view[i, j] * (ts[k, which, j] + arm[j])
            product_into(view, turn, parent)
            quat_into(parent, quaternions[k, place])
            if place == 0:
                out = parent_covariances[k]
                out[:, :] = covariances[k, which]
                move_origin(out, arm)
                turn_axes(view, out)
                for i in range(6):
                    for j in range(i):
                        out[i, j] = out[j, i] = 0.5 * (out[i, j] + out[j, i])
        follow_track(
            seen_ns, track_rotations, track_ts, velocities, turns, other_rotations, numbers,
            robot, exposed_ns, rotations[k, chosen], ts[k, chosen], covariances[k, chosen],
            median_of(heights, assignment[k]),
            rotations[k, other], has_other, evidence,
        )  # fmt: skip
