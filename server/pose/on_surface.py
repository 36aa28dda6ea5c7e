"""A pose from light and surface together: the robot's point lies on it, its axis along the normal, within sigmas.

Three residuals join those of the spots: the distance of the point along the normal, and the two tilts of the axis
against it. The normal turns with the place, so their derivatives hold the surface's bends. Everything is in the
camera's frame; poses are of the plane, about the visible LEDs' mean.

Errors that spots share (light beside all LEDs, an LED's light that is not known) are marginalised: with E what they do
to the rays, and V their covariance, the spots' information is W - W E (V^-1 + E' W E)^-1 E' W. So are those that are
told of the pose itself, T: A (1 + T A)^-1 in place of the information A of the spots. The surface then weighs against
what light knows in truth, and takes nothing off an error that it does not see.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig
from asterism.server.compiled import compiled
from asterism.server.pose.ground import ZX, ZXX, ZXY, ZY, ZYY, Terrain, touch, touching_room
from asterism.server.pose.planar import CONVERGED, NO_SOLUTION, damped_step, normal_equations, pose_cost
from asterism.server.pose.spot_shift import CORRECTIONS, STANDS_STILL_PX, correct_rays, has_shift

ALONG_X = 0.9  # a normal nearer to the camera's x axis has its tilts told along y


class Feet(NamedTuple):
    """How the robots of a rig stand: whether they do, ``stands`` (robots,); their ``points`` (robots, 3) m and ``axes``
    (robots, 3) in the plane's frame; ``variances`` (robots, 2): of the point along the normal, m^2, and of either tilt,
    rad^2, inf where it is not told.
    """

    stands: NDArray[np.int64]
    points: Floats
    axes: Floats
    variances: Floats


class Underfoot(NamedTuple):
    """The surface as the camera has it: ``terrain`` in its own frame, T_camera_surface as ``rotation`` (3, 3) and
    ``origin`` (3,) m; and who stands on it.
    """

    terrain: Terrain
    feet: Feet
    rotation: Floats
    origin: Floats

    @staticmethod
    def of(rig: Rig) -> "Underfoot | None":
        """That of a rig; None where nobody stands on anything."""
        if rig.surface is None or not any(robot.stands is not None for robot in rig.robots):
            return None
        feet = Feet(np.zeros(len(rig.robots), np.int64), *(np.zeros((len(rig.robots), size)) for size in (3, 3, 2)))
        for k, robot in enumerate(rig.robots):
            if robot.stands is not None:
                T_plane_robot = robot.T_robot_plane.inverse()
                feet.stands[k] = 1
                feet.points[k] = T_plane_robot.map(robot.points[robot.stands.point])
                feet.axes[k] = T_plane_robot.rotation @ robot.stands.axis
                feet.variances[k] = robot.stands.sigma_m**2, robot.stands.tilt_sigma_rad**2
        away = Underfoot(Terrain.of(rig.surface), feet, np.eye(3), np.zeros(3))
        return away.at(rig, rig.T_world_camera or Pose.identity())

    def at(self, rig: Rig, T_world_camera: Pose) -> "Underfoot":
        """The same as a camera at another place has it."""
        assert rig.surface is not None
        T = T_world_camera.inverse() @ rig.surface.T_world_surface
        return self._replace(rotation=np.array(T.rotation), origin=np.array(T.position))


class Stance(NamedTuple):
    """One robot's standing, and scratch: its ``point`` (3,) m from the visible LEDs' mean, and ``axis`` (3,), in the
    plane's frame; how far light has its pose off, ``move`` (3,) m in the camera's; ``weights`` (2,): of the distance
    and of either tilt, one over their variances. Of a pose: ``off`` (3,): distance and tilts, ``by_pose`` (3, 6) their
    derivatives, ``normal`` (3,) in the camera's frame.
    """

    point: Any
    axis: Any
    move: Any
    weights: Any
    off: Any
    by_pose: Any
    normal: Any
    touching: Any


@compiled
def stance_room():
    """Room for one robot's."""
    point, axis, move, weights = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(2)
    return Stance(point, axis, move, weights, np.zeros(3), np.zeros((3, 6)), np.zeros(3), touching_room())


@compiled
def _fill_tangents(normal, tangents):
    """Fill ``tangents`` (2, 3): two directions across a normal (3,), the first nearest to the camera's x, or y."""
    k = 0 if abs(normal[0]) < ALONG_X else 1
    size = math.sqrt(1.0 - normal[k] * normal[k])
    for i in range(3):
        tangents[0, i] = ((1.0 if i == k else 0.0) - normal[k] * normal[i]) / size
    for i in range(3):
        j, m = (i + 1) % 3, (i + 2) % 3
        tangents[1, i] = normal[j] * tangents[0, m] - normal[m] * tangents[0, j]


@compiled
def _fill_bends(here, tangents, distance, bends):
    """Fill ``bends`` (2, 2): how the normal of the nearest point turns as the point moves, along ``tangents`` (2, 3) of
    the surface's frame: (1 - d K)^-1 K, with K the surface's own.
    """
    size = math.sqrt(1.0 + here[ZX] ** 2 + here[ZY] ** 2)
    for i in range(2):
        u, v = tangents[i, 0], tangents[i, 1]
        for j in range(2):
            p, q = tangents[j, 0], tangents[j, 1]
            bends[i, j] = (u * (here[ZXX] * p + here[ZXY] * q) + v * (here[ZXY] * p + here[ZYY] * q)) / size
    # A function of K alone: (K - d det K) / (1 - d trace K + d^2 det K).
    det, trace = bends[0, 0] * bends[1, 1] - bends[0, 1] * bends[1, 0], bends[0, 0] + bends[1, 1]
    scale = 1.0 / (1.0 - distance * trace + distance * distance * det)
    for i in range(2):
        bends[i, i] -= distance * det
        for j in range(2):
            bends[i, j] *= scale


@compiled
def fill_stance(rotation, t, stance, underfoot, with_derivatives):
    """Fill what a pose is off the surface by, and how that changes with the pose; whether there is a surface there."""
    turn, origin, touching = underfoot.rotation, underfoot.origin, stance.touching
    off, normal, by_pose, room = stance.off, stance.normal, stance.by_pose, np.empty((8, 3))
    arm, axis, there, own, tangents, across = room[0], room[1], room[2], room[3], room[4:6], room[6:8]
    for i in range(3):
        arm[i] = axis[i] = 0.0
        for j in range(3):
            arm[i] += rotation[i, j] * stance.point[j]
            axis[i] += rotation[i, j] * stance.axis[j]
        there[i] = arm[i] + t[i] + stance.move[i] - origin[i]
    for i in range(3):
        own[i] = 0.0
        for j in range(3):
            own[i] += turn[j, i] * there[j]
    distance, found = touch(underfoot.terrain, own[0], own[1], own[2], touching)
    if not found:
        return False
    here = touching.here
    size = math.sqrt(1.0 + here[ZX] ** 2 + here[ZY] ** 2)
    for i in range(3):
        normal[i] = (turn[i, 2] - turn[i, 0] * here[ZX] - turn[i, 1] * here[ZY]) / size
    _fill_tangents(normal, tangents)
    cosine = axis[0] * normal[0] + axis[1] * normal[1] + axis[2] * normal[2]
    off[0] = distance
    for i in range(2):
        off[1 + i] = axis[0] * tangents[i, 0] + axis[1] * tangents[i, 1] + axis[2] * tangents[i, 2]
    sine = math.sqrt(off[1] ** 2 + off[2] ** 2)
    # An axis far from the normal is off by the angle, not by its sine.
    longer = math.atan2(sine, cosine) / sine if sine > 1e-6 else 1.0
    off[1] *= longer
    off[2] *= longer
    if not with_derivatives:
        return True
    for i in range(2):
        for j in range(3):
            across[i, j] = 0.0
            for k in range(3):
                across[i, j] += turn[k, j] * tangents[i, k]
    bends = np.empty((2, 2))
    _fill_bends(here, across, distance, bends)
    for i in range(3):
        by_pose[0, i] = normal[i]
        for k in range(2):
            by_pose[1 + k, i] = cosine * longer * (bends[k, 0] * tangents[0, i] + bends[k, 1] * tangents[1, i])
    for row in range(3):
        for i in range(3):
            j, m = (i + 1) % 3, (i + 2) % 3
            by_pose[row, 3 + i] = arm[j] * by_pose[row, m] - arm[m] * by_pose[row, j]
            if row > 0:
                by_pose[row, 3 + i] += longer * (axis[j] * tangents[row - 1, m] - axis[m] * tangents[row - 1, j])
    return True


@compiled
def stance_cost(stance):
    """Squared sigmas that a pose is off the surface by."""
    off, weights = stance.off, stance.weights
    return weights[0] * off[0] ** 2 + weights[1] * (off[1] ** 2 + off[2] ** 2)


@compiled
def add_stance(stance, distance, a, b):
    """Add the surface's information to ``a`` (6, 6; its lower triangle) and ``b`` (6,) of a step; that of the
    ``distance`` only if asked for.
    """
    off, by_pose = stance.off, stance.by_pose
    for row in range(0 if distance else 1, 3):
        weight = stance.weights[min(row, 1)]
        for i in range(6):
            b[i] -= weight * by_pose[row, i] * off[row]
            for j in range(i + 1):
                a[i, j] += weight * by_pose[row, i] * by_pose[row, j]


@compiled
def _refine(rotation, t, lit, stance, underfoot, iterations):
    """`planar.refine_pose` with the surface; returns the cost, NO_SOLUTION where there is no surface."""
    cost = pose_cost(rotation, t, lit.points, lit.seen, lit.information)
    if cost >= NO_SOLUTION or not fill_stance(rotation, t, stance, underfoot, True):
        return NO_SOLUTION
    cost += stance_cost(stance)
    six, three = np.empty((7, 6)), np.empty((3, 3, 3))
    a, b, step, new_rotation, new_t = six[:6], six[6], three[0], three[1], three[2, 0]
    damping = 1e-6
    for _ in range(iterations):
        normal_equations(rotation, t, lit.points, lit.seen, lit.information, a, b)
        add_stance(stance, True, a, b)
        if not damped_step((a, b), damping, rotation, t, step, new_rotation, new_t):
            damping = damping * 10.0 + 1e-3
            continue
        new_cost = pose_cost(new_rotation, new_t, lit.points, lit.seen, lit.information)
        if new_cost < NO_SOLUTION and fill_stance(new_rotation, new_t, stance, underfoot, True):
            new_cost += stance_cost(stance)
        else:
            new_cost = NO_SOLUTION
        if new_cost <= cost:
            gained = cost - new_cost
            rotation[:, :] = new_rotation
            t[:] = new_t
            cost = new_cost
            damping *= 0.1
            if gained <= CONVERGED:
                break
        else:
            damping = damping * 10.0 + 1e-4
            fill_stance(rotation, t, stance, underfoot, True)
    return cost


@compiled
def refine_standing(rotation, t, lit, optics, stance, underfoot, iterations, focal):
    """Levenberg-Marquardt on light and surface, in place, the rays corrected for the spots' shifts at the pose that
    results; returns the robust cost, NO_SOLUTION where there is no surface. ``stance`` is left as of the pose.
    """
    correct_rays(rotation, t, lit, optics)
    cost = _refine(rotation, t, lit, stance, underfoot, iterations)
    if not has_shift(optics):
        return cost
    for _ in range(CORRECTIONS):
        if cost >= NO_SOLUTION or correct_rays(rotation, t, lit, optics) * focal < STANDS_STILL_PX:
            break
        cost = _refine(rotation, t, lit, stance, underfoot, iterations)
    return cost
