"""The sphere of directions and the planes that touch it: there nothing is stretched towards the edge of a wide image.

On the plane z = 1, where a ray is x / z, y / z, an angle far off the axis looks 1 / cos^2 as long, and the same error
of a spot so much larger.
"""

import math

from asterism.server.compiled import compiled


@compiled
def touch(unit, frame):
    """Fill ``frame`` (3, 3) with the axes of the plane that touches the sphere at a direction, the last one: those of
    the image turned there the shortest way.
    """
    x, y, z = unit[0], unit[1], unit[2]
    k = 1.0 / (1.0 + z)
    frame[0, 0], frame[0, 1], frame[0, 2] = 1.0 - k * x * x, -k * x * y, -x
    frame[1, 0], frame[1, 1], frame[1, 2] = -k * x * y, 1.0 - k * y * y, -y
    frame[2, 0], frame[2, 1], frame[2, 2] = x, y, z


@compiled
def project(frame, direction):
    """Where a direction (3,), of any length, meets the plane of a `touch`."""
    x, y, z = direction[0], direction[1], direction[2]
    depth = frame[2, 0] * x + frame[2, 1] * y + frame[2, 2] * z
    across = frame[0, 0] * x + frame[0, 1] * y + frame[0, 2] * z
    down = frame[1, 0] * x + frame[1, 1] * y + frame[1, 2] * z
    return across / depth, down / depth


@compiled
def distance(t):
    """The length of a translation (3,)."""
    return math.sqrt(t[0] * t[0] + t[1] * t[1] + t[2] * t[2])


@compiled
def lay_flat(rays, covariances, focal, flat, variances):
    """Fill ``flat`` (n, 2), px, y up, with an equal-area map of the sphere (Lambert's azimuthal) of ``rays`` (n, 2), y
    down, and ``variances`` (n,) with those of their directions, rad^2, the mean over both axes.

    ``covariances`` (n, 3) xx, xy, yy of the rays. Densities on the map are those on the sphere, and lengths nearly.
    """
    for i in range(rays.shape[0]):
        x, y = rays[i, 0], rays[i, 1]
        r2 = x * x + y * y
        c = 1.0 / math.sqrt(1.0 + r2)
        scale = focal * c * math.sqrt(2.0 / (1.0 + c))
        flat[i, 0], flat[i, 1] = scale * x, -scale * y
        xx, xy, yy = covariances[i, 0], covariances[i, 1], covariances[i, 2]
        outward = (x * x * xx + 2.0 * x * y * xy + y * y * yy) / r2 if r2 > 1e-12 else 0.5 * (xx + yy)
        # Along the radius an angle is c^2 of what it is on the plane z = 1, across it c.
        variances[i] = 0.5 * c * c * (c * c * outward + xx + yy - outward)
