"""How robots move, as the filter has it: manners of moving, how one follows another, what each does to a state.

State of a robot (12,): position m, small rotation about the parent's axes against a common reference, velocity m/s,
turn rate rad/s, both about the parent's axes. In every manner the robot goes on as it goes, in its own axes: straight
on, in a circle, turning on the spot, over a bowl. White acceleration disturbs it, much or little; that is all in which
manners differ. Wheels drive a robot along its plane and turn it about its normal, so that most manners differ in these
two: how hard it speeds up, and how hard its turn changes. Across the plane nothing pushes it, and it tilts only as the
surface below it does: the faster, the more. What a hand shows to the camera moves any way, so three manners know no
plane.

Source: Bar-Shalom, Li, Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, 6.2.2 (white
acceleration), 11.6.6 (manners) and 11.7 (turns).
"""

from typing import NamedTuple

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.server.chain.turns import exp_rotations, hats

# Power spectral densities of the acceleration, m^2/s^3, and of the turn's, rad^2/s^3: from a robot that all but stands
# still to one that starts and stops hard. At 60 Hz the last are 6 m/s^2 and 40 rad/s^2, one sigma.
CALM, HARD = 1e-7, 0.6
ARM2 = 45.0  # of the turn's density over the acceleration's, 1/m^2: of points some 0.15 m from the robot's middle
PUSHES = np.geomspace(CALM, HARD, 4)
SWERVES = ARM2 * np.geomspace(CALM, HARD, 3)
CURVATURE2 = 1.0  # 1/m^2, of the surfaces that robots drive on
BUMPS = 3.0  # 1/m^4 s: of surfaces whose curvature changes by 3 /m in a metre, a third of a second long
FREE = (1e-5, 2e-3, HARD)  # of manners that know no plane
CALM_S, HARD_S = 4.0, 0.1  # how long a robot keeps to a manner, on average: one that is hard is soon over
IS_HARD = 0.1  # of the hardest


class Manners(NamedTuple):
    """m manners: densities ``along`` the plane and ``across`` it, m^2/s^3, of the turn about the normal, ``yaw``,
    and of the others, ``tilt``, rad^2/s^3; ``kept_s``, how long a robot keeps to each; each (m,).
    """

    along: Floats
    across: Floats
    yaw: Floats
    tilt: Floats
    kept_s: Floats

    @staticmethod
    def usual() -> "Manners":
        """Those of robots on wheels, and of other things."""
        rows = [(a, CALM, y, max(ARM2 * CALM, CURVATURE2 * a)) for a in PUSHES for y in SWERVES]
        rows += [(a, a, ARM2 * a, ARM2 * a) for a in FREE]
        along, across, yaw, tilt = np.array(rows).T
        is_hard = (along >= IS_HARD * HARD) | (yaw >= IS_HARD * ARM2 * HARD)
        return Manners(along, across, yaw, tilt, np.where(is_hard, HARD_S, CALM_S))


MANNERS = Manners.usual()
COUNT = len(MANNERS.along)
USUAL: Floats = MANNERS.kept_s / MANNERS.kept_s.sum()  # how likely each is where nothing is known


def _spectrum() -> tuple[Floats, Floats, Floats]:
    """Eigenvalues and both bases of the rates at which manners follow each other, all others alike."""
    rates = np.repeat(1.0 / (MANNERS.kept_s[:, None] * (COUNT - 1)), COUNT, axis=1)
    np.fill_diagonal(rates, -1.0 / MANNERS.kept_s)
    root = np.sqrt(USUAL)  # the rates are symmetric in it
    values, vectors = np.linalg.eigh(root[:, None] * rates / root)
    return values, vectors / root[:, None], vectors.T * root


_RATES, _TO, _BACK = _spectrum()


def changes(dt: Floats) -> Floats:
    """How likely one manner (row) has become another (column) after ``dt`` (n,) s: (n, m, m)."""
    found: Floats = (_TO * np.exp(_RATES * dt[:, None])[:, None, :]) @ _BACK
    return np.maximum(found, 0.0)


def moved_on(states: Floats, turn: Floats, dt: Floats) -> tuple[Floats, Floats]:
    """States (n, m, 12) ``dt`` (n,) s later, against a reference that turned at ``turn`` (n, 3) rad/s; and how they
    depend on the states before (n, m, 12, 12).
    """
    t = dt[:, None, None]
    velocity, rate = states[..., 6:9], states[..., 9:]
    reference = exp_rotations(turn * dt[:, None])[:, None]
    other = rate - turn[:, None]
    later, by_state = np.empty_like(states), np.zeros((*states.shape, 12))
    on = np.broadcast_to(np.eye(3), reference.shape)
    halfway = t[..., None] * (on + 0.5 * t[..., None] * hats(turn)[:, None])
    across = hats(velocity)
    half_turned = 0.5 * t * (hats(rate) @ velocity[..., None])[..., 0]
    turned = (reference @ velocity[..., None])[..., 0]
    later[..., :3] = states[..., :3] + t * (velocity + half_turned)
    later[..., 3:6] = (reference @ states[..., 3:6, None] + halfway @ other[..., None])[..., 0]
    later[..., 6:9] = turned + t * (hats(other) @ turned[..., None])[..., 0]
    later[..., 9:] = rate
    by_state[..., :3, :3] = by_state[..., 9:, 9:] = on
    by_state[..., :3, 6:9] = halfway
    by_state[..., :3, 9:] = (-0.5 * t * t)[..., None] * across
    by_state[..., 3:6, 3:6] = by_state[..., 6:9, 6:9] = reference
    by_state[..., 3:6, 9:] = halfway
    by_state[..., 6:9, 9:] = -t[..., None] * (reference @ across)
    return later, by_state


def unforeseen(normals: Floats, speeds: Floats, dt: Floats) -> Floats:
    """What white acceleration adds to covariances (n, m, 12, 12) within ``dt`` (n,) s, of robots whose planes have
    ``normals`` (n, 3) in the parent frame, at ``speeds`` (n,) m/s.
    """
    bumps = (BUMPS * speeds**4)[:, None, None, None]
    upright = (normals[:, :, None] * normals[:, None, :])[:, None]
    flat = np.eye(3) - upright
    out = np.zeros((len(normals), COUNT, 12, 12))
    t = dt[:, None, None, None]
    for first, plane, normal in ((0, MANNERS.along, MANNERS.across), (3, MANNERS.tilt, MANNERS.yaw)):
        density = t * (plane[:, None, None] * flat + normal[:, None, None] * upright)
        if first:
            density = density + t * bumps * flat
        place, rate = slice(first, first + 3), slice(first + 6, first + 9)
        out[..., place, place] = t * t / 3.0 * density
        out[..., place, rate] = out[..., rate, place] = 0.5 * t * density
        out[..., rate, rate] = density
    return out
