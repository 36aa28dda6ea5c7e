"""The covariance of all rays of a robot together, compiled: what each has of its own, and what they share.

The formula is that of `joint_solve`.
"""

import math

import numpy as np

from asterism.protocol.led_offset import MOST_KNOTS
from asterism.server.compiled import compiled
from asterism.server.fusing.joint_rays import shared_motion, way_by_change
from asterism.server.pose.rotations import mapped, product_into
from asterism.server.pose.spot_shift import AXIS, DOUBT, DOUBTS, along_axis


@compiled
def _add(total, left, right, share):
    """Add ``share`` (a number) times left (2, d) right' (2, d) to a block (2, 2)."""
    for a in range(2):
        for b in range(2):
            value = 0.0
            for j in range(left.shape[1]):
                value += left[a, j] * right[b, j]
            total[a, b] += share * value


@compiled
def _doubts(k, rotation, t, eyes, bodies, bundle, work, shifts):
    """Fill ``shifts`` (n, 2, d), rays: what each thing that is not known of the LEDs' light does to every ray."""
    begin, body = bundle.first[k], bundle.bodies[k]
    turned, axis = np.empty((3, 3)), np.empty(3)
    product_into(rotation, bodies.rotations[body], turned)
    shifts[:, :, :] = 0.0
    for i in range(begin, bundle.first[k + 1]):
        camera, led, row = bundle.cameras[i], bundle.leds[i], i - begin
        optics = bodies.optics[camera, body]
        dot = away2 = 0.0
        x, y, z = mapped(turned, t, bodies.layouts[body, led])
        sight = (x - eyes.origins[camera, 0], y - eyes.origins[camera, 1], z - eyes.origins[camera, 2])
        for j in range(3):
            axis[j] = turned[j, 0] * optics[AXIS] + turned[j, 1] * optics[AXIS + 1] + turned[j, 2] * optics[AXIS + 2]
            dot += axis[j] * sight[j]
            away2 += sight[j] * sight[j]
        angle = math.asin(math.sqrt(min(max(1.0 - dot * dot / away2, 0.0), 1.0)))
        for d in range(int(optics[DOUBTS])):
            along = along_axis(optics, DOUBT + d * MOST_KNOTS, angle)
            for a in range(2):
                for j in range(3):
                    shifts[row, a, d] += along * work.by_pose[row, a, j] * axis[j]


@compiled
def _most_doubts(k, bodies, bundle):
    """How many things are not known of the light of robot k's LEDs, of the camera that knows the most of them."""
    most = 0
    for i in range(bundle.first[k], bundle.first[k + 1]):
        most = max(most, int(bodies.optics[bundle.cameras[i], bundle.bodies[k], DOUBTS]))
    return most


@compiled
def fill_covariance(k, rotation, t, eyes, bodies, bundle, motion, work):
    """Fill the lower triangle of the work's ``factor`` with the covariance of all rays of robot k, by the derivatives
    there at that pose.
    """
    begin = bundle.first[k]
    n = bundle.first[k + 1] - begin
    misfit2 = bundle.misfits[k] ** 2
    placed, rated, risen = np.empty((2, 6)), np.empty((2, 6)), np.empty((2, 6))
    age, swayed, block = motion.ages[k], np.empty((2, 6)), np.empty((2, 2))
    rates = motion.covariances[k]
    lights = _most_doubts(k, bodies, bundle)
    light = np.empty((n, 2, max(lights, 1)))
    if lights:
        _doubts(k, rotation, t, eyes, bodies, bundle, work, light)
    for i in range(n):
        camera, time = bundle.cameras[begin + i], bundle.times[begin + i]
        change = way_by_change(time, age)
        for a in range(2):
            for j in range(6):
                placed[a, j] = rated[a, j] = risen[a, j] = 0.0
                swayed[a, j] = work.by_pose[i, a, j] * motion.densities[k, j]
                for h in range(6):
                    placed[a, j] += work.by_place[i, a, h] * eyes.places[camera, h, j]
                    if time != 0.0:
                        move = work.by_pose[i, a, h]
                        rated[a, j] += move * (time * rates[h, j] + change * rates[6 + h, j])
                        risen[a, j] += move * (time * rates[h, 6 + j] + change * rates[6 + h, 6 + j])
        for m in range(i + 1):
            other = bundle.times[begin + m]
            block[:, :] = 0.0
            if bundle.cameras[begin + m] == camera:
                _add(block, placed, work.by_place[m], 1.0)
            if misfit2 > 0.0 and bundle.leds[begin + m] == bundle.leds[begin + i]:
                _add(block, work.by_led[i], work.by_led[m], misfit2)
            if time * other != 0.0:
                _add(block, rated, work.by_pose[m], other)
                _add(block, risen, work.by_pose[m], way_by_change(other, age))
                _add(block, swayed, work.by_pose[m], shared_motion(time, other, age))
            if lights:
                _add(block, light[i], light[m], 1.0)
            if m == i:
                own = bundle.covariances[begin + i]
                block[0, 0] += own[0]
                block[0, 1] += own[1]
                block[1, 0] += own[1]
                block[1, 1] += own[2]
            for a in range(2):
                for b in range(2):
                    work.factor[2 * i + a, 2 * m + b] = block[a, b]
