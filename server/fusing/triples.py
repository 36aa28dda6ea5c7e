"""Poses of robots nobody knows: three spots of one camera as three LEDs, borne out by the spots of all cameras.

Any three spots are three LEDs of any robot, in two poses. What makes one of them the robot's is that its other LEDs lie
where spots are, in the other cameras above all. So first only those triples are tried near whose line of sight other
cameras see enough spots, and only such poses whose distance these allow.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.server.centres.blobs import Ints
from asterism.server.compiled import compiled
from asterism.server.fusing.look import Body, fit, noise_of
from asterism.server.fusing.near_spots import GATE, gate_of, spread_in
from asterism.server.fusing.sightline import Borne, agreeing, nearest_depth, supports_along
from asterism.server.fusing.three_points import three_points
from asterism.server.pose.fit import LEDS
from asterism.server.pose.planar import NO_SOLUTION

LEAST = 6  # LEDs seen, in all cameras together, that make a robot
MOST_TRIPLES = 2048
NEAR = 0.12  # of it: how far off another camera's spot may be while the pose of three is rough


class Sought(NamedTuple):
    """R robots: ``layouts`` (R, 6, 3) m, ``optics`` (R, C, OPTICS), ``misfits`` (R,), ``systematic`` (R, C),
    ``extents`` (R,) m.
    """

    layouts: Floats
    optics: Floats
    misfits: Floats
    systematic: Floats
    extents: Floats


class Search(NamedTuple):
    """What is looked through: the `look.Scene`, who is `Sought`, the `look.Course`, which spots are ``free`` (n,), the
    `Limits`, and the unit vectors along the rays, ``directions`` (n, 3).
    """

    scene: Any
    sought: Any
    course: Any
    free: Any
    limits: Any
    directions: Any


class Scratch(NamedTuple):
    """Work arrays: ``state`` and ``prior`` (`look.State`), this with information 0, and a `look.Room`."""

    state: Any
    prior: Any
    room: Any


class Support(NamedTuple):
    """What bears three spots out: the `Borne` of their line of sight, how many ``supports`` are in it and how many are
    ``needed``, the least distance that they allow, ``nearest`` m, and all spots ``near`` (k, 2): camera and row.
    """

    borne: Any
    supports: Any
    needed: Any
    nearest: Any
    near: Any


class Guesses(NamedTuple):
    """Poses that at least LEAST spots bear out: ``who`` (k, 8): robot, camera, three spots, three LEDs;
    ``rotations`` (k, 3, 3), ``ts`` (k, 3), and ``seen`` (k,) spots, -1 for no guess.
    """

    who: Ints
    rotations: Floats
    ts: Floats
    seen: Ints


def room_to_guess(most: int) -> Guesses:
    """Room for so many."""
    return Guesses(
        np.zeros((most, 8), np.int64), np.zeros((most, 3, 3)), np.zeros((most, 3)), np.full(most, -1, np.int64)
    )


class Limits(NamedTuple):
    """Distances ``near`` and ``far`` (C,) m within which robots are looked for, and how many poses are tried at
    ``most``, from triple number ``start`` on, round and round.
    """

    near: Floats
    far: Floats
    most: int
    start: int


@compiled
def _directions(scene, out):
    """Fill ``out`` (n, 3): unit vectors along the rays, in the cameras' frames."""
    for k in range(scene.rays.shape[0]):
        x, y = scene.rays[k, 0], scene.rays[k, 1]
        per = 1.0 / math.sqrt(x * x + y * y + 1.0)
        out[k, 0], out[k, 1], out[k, 2] = x * per, y * per, per


@compiled
def _list_triples(scene, free, directions, reach, triples):
    """Fill ``triples`` (m, 4): camera and three of its free spots within reach of each other; returns how many."""
    count = 0
    for c in range(scene.turns.shape[0]):
        for i in range(scene.first[c], scene.first[c + 1]):
            if not free[i]:
                continue
            for j in range(i + 1, scene.first[c + 1]):
                if not free[j] or not _within(directions, i, j, reach[c]):
                    continue
                for k in range(j + 1, scene.first[c + 1]):
                    if (
                        not free[k]
                        or not _within(directions, i, k, reach[c])
                        or not _within(directions, j, k, reach[c])
                    ):
                        continue
                    if count == triples.shape[0]:
                        return count
                    triples[count, 0], triples[count, 1], triples[count, 2], triples[count, 3] = c, i, j, k
                    count += 1
    return count


@compiled
def _within(directions, i, j, reach):
    away2 = 0.0
    for axis in range(3):
        away2 += (directions[i, axis] - directions[j, axis]) ** 2
    return away2 < reach * reach


@compiled
def _at_home(scene, free, directions, triple, reach, near, count):
    """Add the free spots of its own camera within reach of a triple to ``near`` (k, 2), of which there are ``count``;
    returns how many there are then.
    """
    for spot in range(scene.first[triple[0]], scene.first[triple[0] + 1]):
        if not free[spot]:
            continue
        for k in range(1, 4):
            if not _within(directions, spot, triple[k], reach):
                break
        else:
            near[count, 0], near[count, 1] = triple[0], spot
            count += 1
    return count


@compiled
def _seen_roughly(scene, home, layout, extent, rotation, t, near):
    """How many LEDs of a pose T_home_plane have one of the spots ``near`` (k, 2), camera and row, roughly at them."""
    at, point = np.empty(3), np.empty(3)
    count = 0
    for c in range(scene.turns.shape[0]):
        for led in range(LEDS):
            for i in range(3):
                at[i] = t[i]
                for j in range(3):
                    at[i] += rotation[i, j] * layout[led, j]
            x, y, z = at[0], at[1], at[2]
            if c != home:
                for i in range(3):
                    point[i] = scene.origins[home, i] - scene.origins[c, i]
                    for j in range(3):
                        point[i] += scene.turns[home, j, i] * at[j]
                x = y = z = 0.0
                for j in range(3):
                    x += scene.turns[c, 0, j] * point[j]
                    y += scene.turns[c, 1, j] * point[j]
                    z += scene.turns[c, 2, j] * point[j]
            if not z > 1e-3:
                continue
            x, y, near2 = x / z, y / z, (NEAR * extent / z) ** 2
            for k in range(near.shape[0]):
                spot = near[k, 1]
                if near[k, 0] == c and (scene.rays[spot, 0] - x) ** 2 + (scene.rays[spot, 1] - y) ** 2 < near2:
                    count += 1
                    break
    return count


@compiled
def _seen_surely(scene, body, free, room, prior):
    """How many LEDs have a free spot within their gates, in all cameras; of no camera more than it has such spots."""
    spread, gate = np.empty((6, 6)), np.empty(3)
    count = 0
    for c in range(scene.turns.shape[0]):
        start, end = scene.first[c], scene.first[c + 1]
        if start == end:
            continue
        spread_in(scene, room, c, prior, spread)
        hit = np.zeros(end - start, np.bool_)
        leds = 0
        for led in range(LEDS):
            if room.visible[c, led] == 0.0:
                continue
            gate_of(room, c, led, spread, gate)
            some = False
            for spot in range(start, end):
                if not free[spot]:
                    continue
                nxx, nxy, nyy = noise_of(scene, body, c, spot, room.depths[c, led])
                xx, xy, yy = gate[0] + nxx, gate[1] + nxy, gate[2] + nyy
                x, y = scene.rays[spot, 0] - room.rays[c, led, 0], scene.rays[spot, 1] - room.rays[c, led, 1]
                if yy * x * x - 2.0 * xy * x * y + xx * y * y < GATE * (xx * yy - xy * xy):
                    some = hit[spot - start] = True
            if some:
                leds += 1
        count += min(leds, int(np.sum(hit)))
    return count


@compiled
def _keep(guesses, seen, who, rotation, t):
    """Keep a guess in place of the one that fewest spots bear out, if those are fewer."""
    least = 0
    for k in range(guesses.seen.shape[0]):
        if guesses.seen[k] < guesses.seen[least]:
            least = k
    if guesses.seen[least] >= seen:
        return
    guesses.seen[least] = seen
    guesses.who[least] = who
    guesses.rotations[least] = rotation
    guesses.ts[least] = t


@compiled
def guess(scene, sought, course, free, limits, scratch, guesses):
    """Fill the `Guesses` from the ``free`` (n,) spots of all cameras, with a `Scratch`; returns how many poses were
    tried, and of how many triples, -1 for all.
    """
    n = scene.rays.shape[0]
    cameras = scene.turns.shape[0]
    directions = np.empty((n, 3))
    _directions(scene, directions)
    largest = 0.0
    for robot in range(sought.extents.shape[0]):
        largest = max(largest, sought.extents[robot])
    reach = np.empty(cameras)
    for c in range(cameras):
        reach[c] = largest / limits.near[c]
    triples = np.empty((MOST_TRIPLES, 4), np.int64)
    count = _list_triples(scene, free, directions, reach, triples)
    borne, middle = Borne(np.empty(n), np.empty(n), np.empty((n, 2), np.int64)), np.empty(3)
    search = Search(scene, sought, course, free, limits, directions)
    tried = 0
    for turn in range(count):
        if tried >= limits.most:
            return tried, turn
        triple = triples[(limits.start + turn) % count]
        home = triple[0]
        for axis in range(3):
            middle[axis] = (
                directions[triple[1], axis] + directions[triple[2], axis] + directions[triple[3], axis]
            ) / 3.0
        per = 1.0 / math.sqrt(middle[0] ** 2 + middle[1] ** 2 + middle[2] ** 2)
        for axis in range(3):
            middle[axis] *= per
        supports = supports_along(scene, free, directions, home, middle, largest, limits, borne)
        every = _at_home(scene, free, directions, triple, reach[home], borne.near, supports)
        needed = max(LEAST - min(every - supports, LEDS), 1)
        if supports < needed:
            continue
        nearest = max(nearest_depth(borne.depths, borne.slack, supports, needed), limits.near[home])
        if not nearest < limits.far[home]:
            continue
        for robot in range(sought.extents.shape[0]):
            told = Support(borne, supports, needed, nearest, borne.near[:every])
            tried += _try_robot(search, scratch, guesses, robot, triple, told)
    return tried, -1


@compiled
def _try_robot(search, scratch, guesses, robot, triple, told):
    """Try three spots as any three LEDs of a robot; returns how many poses that were."""
    scene, sought, course, free, limits, directions = search
    state, prior, room = scratch
    borne, supports, needed, nearest, near = told
    home = triple[0]
    extent, layout = sought.extents[robot], sought.layouts[robot]
    body = Body(layout, sought.optics[robot], sought.misfits[robot], sought.systematic[robot])
    seen, points = np.empty((3, 3)), np.empty((3, 3))
    rotations, ts = np.empty((2, 3, 3)), np.empty((2, 3))
    labels = np.full((scene.turns.shape[0], LEDS), -1, np.int64)
    who = np.empty(8, np.int64)
    for k in range(3):
        for axis in range(3):
            seen[k, axis] = directions[triple[1 + k], axis]
    det = (
        seen[0, 0] * (seen[1, 1] * seen[2, 2] - seen[1, 2] * seen[2, 1])
        - seen[0, 1] * (seen[1, 0] * seen[2, 2] - seen[1, 2] * seen[2, 0])
        + seen[0, 2] * (seen[1, 0] * seen[2, 1] - seen[1, 1] * seen[2, 0])
    )
    # Sides that are so long at least, wherever the robot is: the LEDs that they join are as far apart.
    side = max(nearest - 0.5 * extent, 0.0)
    ab, bc = side * _chord(seen, 0, 1), side * _chord(seen, 1, 2)
    ac = side * _chord(seen, 0, 2)
    if max(ab, ac, bc) > extent:
        return 0
    tried = 0
    for a in range(LEDS):
        for b in range(LEDS):
            if b == a or _between(layout, a, b) < ab:
                continue
            for c in range(LEDS):
                if c in (a, b) or _between(layout, a, c) < ac or _between(layout, b, c) < bc:
                    continue
                across = (layout[b, 0] - layout[a, 0]) * (layout[c, 1] - layout[a, 1])
                across -= (layout[b, 1] - layout[a, 1]) * (layout[c, 0] - layout[a, 0])
                # Seen from in front, the plate's side that shines: the triangle runs the other way round.
                if across * det >= 0.0:
                    continue
                for axis in range(3):
                    points[0, axis], points[1, axis] = layout[a, axis], layout[b, axis]
                    points[2, axis] = layout[c, axis]
                found = three_points(seen, points, rotations, ts)
                for which in range(found):
                    tried += 1
                    t = ts[which]
                    away = math.sqrt(t[0] ** 2 + t[1] ** 2 + t[2] ** 2)
                    if not limits.near[home] < away < limits.far[home]:
                        continue
                    facing = (
                        rotations[which, 0, 2] * t[0] + rotations[which, 1, 2] * t[1] + rotations[which, 2, 2] * t[2]
                    )
                    if not facing < -0.25 * away or agreeing(borne.depths, borne.slack, supports, away) < needed:
                        continue
                    if _seen_roughly(scene, home, layout, extent, rotations[which], t, near) < LEAST:
                        continue
                    _in_world(scene, home, rotations[which], t, state)
                    labels[home, :] = -1
                    labels[home, a], labels[home, b], labels[home, c] = triple[1], triple[2], triple[3]
                    chi2, _ = fit(scene, body, course, labels, prior, state, 1, room)
                    if chi2 >= NO_SOLUTION:
                        continue
                    count = _seen_surely(scene, body, free, room, prior.information)
                    if count < LEAST:
                        continue
                    who[0], who[1], who[2], who[3], who[4] = robot, home, triple[1], triple[2], triple[3]
                    who[5], who[6], who[7] = a, b, c
                    _keep(guesses, count, who, state.rotation, state.t)
    return tried


@compiled
def _chord(directions, i, j):
    return math.sqrt(
        (directions[i, 0] - directions[j, 0]) ** 2
        + (directions[i, 1] - directions[j, 1]) ** 2
        + (directions[i, 2] - directions[j, 2]) ** 2
    )


@compiled
def _between(layout, i, j):
    return math.hypot(layout[i, 0] - layout[j, 0], layout[i, 1] - layout[j, 1])


@compiled
def _in_world(scene, home, rotation, t, state):
    """Fill the state with T_world_plane of a pose in the frame of camera ``home``."""
    for i in range(3):
        state.t[i] = scene.origins[home, i]
        for j in range(3):
            state.t[i] += scene.turns[home, j, i] * t[j]
            state.rotation[i, j] = 0.0
            for k in range(3):
                state.rotation[i, j] += scene.turns[home, k, i] * rotation[k, j]
