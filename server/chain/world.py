"""`world: {follow: true}`: where the camera is, taken anew in every frame from the constellations that stand still.

A camera stands still, creeps with the temperature, shakes with the machine it hangs from, or is kicked. Each frame's
place (`pose.place`) is joined to that of the frame before by a Kalman filter that expects no motion, but forgets: a
tenth of what it knows in every frame, and more at once where the new place is farther off than noise explains. So a
camera that stands has the noise of its place averaged, one that shakes is followed, and a kick is taken over in the
very frame that shows it. Only errors that are new in every frame average out; those that stay are carried beside, as
is a share of the noise: a shake that is smaller than it cannot be seen, but may be there.

While no such constellation is seen the last place holds, and its covariance grows as that of a mount which wanders.
What happened to the camera in the meantime nobody can know.
"""

import math
from functools import lru_cache

import numpy as np

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.rig import Rig
from asterism.server.centres.blobs import Blobs
from asterism.server.identity.plan import Plan
from asterism.server.identity.rays import Rays
from asterism.server.pose.choose import Choices
from asterism.server.pose.fit import LEDS
from asterism.server.pose.lens import undistort
from asterism.server.pose.matched import Matched
from asterism.server.pose.place import Pinned, Place, PlaceFit, apart, fit_place, moved
from asterism.server.pose.planar import NO_SOLUTION
from asterism.server.pose.solve import MISFIT, Solutions
from asterism.server.pose.track import Tracks

FORGET = 0.1  # of what is known, a frame
SHAKES = 0.4  # of a frame's noise that is told of every place, for what it hides
STAYS = 0.25  # of the variance of a spot that stands still is the same in every frame: how it lies on the pixels
EXPECTED = 6.0  # chi squared of a place that differs by noise
KICK = 60.0  # and of one that does not
WANDER_M, WANDER_RAD = 1e-5, math.radians(1e-3)  # one sigma, in a second, of a mount that nobody sees
UNSEEN_M, UNSEEN_RAD = 5e-3, math.radians(0.5)  # of the rig's own place, before the first sight
TILT_ODDS = 25.0  # chi squared up to which the tilt near the place before is believed
ALONE_STEPS = 1  # of the fit, from a place that was right a frame ago


class Following(Tracks):
    """Tracks that also remember where the camera was."""

    place: Place

    @staticmethod
    def of(tracks: Tracks, place: Place) -> "Following":
        """The tracks with that place."""
        out = Following(*tracks)
        out.place = place
        return out


def place_before(tracks: Tracks, rig: Rig, exposed_ns: int) -> Place:
    """Where the camera should be in a frame, by the frames before; where the rig has it, if there were none."""
    assert rig.T_world_camera is not None
    if not isinstance(tracks, Following):
        unseen = np.diag([UNSEEN_M**2] * 3 + [UNSEEN_RAD**2] * 3)
        return Place(rig.T_world_camera, unseen, unseen, exposed_ns, 0)
    place = tracks.place
    seconds = max(exposed_ns - place.at_ns, 0) * 1e-9
    wander = seconds * np.diag([WANDER_M**2] * 3 + [WANDER_RAD**2] * 3)
    return Place(place.T_world_camera, place.covariance + wander, place.noise + wander, exposed_ns, place.seen_ns)


def place_now(before: Place, plan: Plan, blobs: Blobs, seen: Rays, found: Matched, solutions: Solutions) -> Place:
    """The place with what this frame shows of the constellations that stand still."""
    pinned = _pinned(plan, blobs, seen, found, solutions)
    if pinned is None:
        return before
    if not before.seen_ns:
        fit = _best(pinned, [before.T_world_camera, *_starts(plan, found, solutions)])
        stays = _with_survey(fit) + SHAKES * fit.noise
        return _told(fit.T_world_camera, fit.noise, stays, before.at_ns, None) if np.isfinite(fit.chi2) else before
    fit = fit_place(pinned, before.T_world_camera, ALONE_STEPS)
    known = before.noise / (1.0 - FORGET)
    move = apart(before.T_world_camera, fit.T_world_camera)
    chi2 = _squared(move, known + fit.noise)
    kick = None
    if not chi2 < KICK:
        fit = _best(pinned, [before.T_world_camera, *_starts(plan, found, solutions)])
        if not np.isfinite(fit.chi2):
            return before
        move = apart(before.T_world_camera, fit.T_world_camera)
        known, kick = known + np.outer(move, move) + 1e2 * fit.noise, move
    elif chi2 > EXPECTED:
        known = known + (chi2 / EXPECTED - 1.0) * fit.noise
    gain = known @ np.linalg.inv(known + fit.noise)
    T = moved(before.T_world_camera, gain @ move)
    share = float(np.trace(gain)) / 6.0
    stays = (1.0 - share) * (before.covariance - before.noise) + share * (_with_survey(fit) + SHAKES * fit.noise)
    noise = (np.eye(6) - gain) @ known
    return _told(T, 0.5 * (noise + noise.T), stays, before.at_ns, kick)


def _told(T: Pose, noise: Floats, stays: Floats, at_ns: int, kick: Floats | None) -> Place:
    return Place(T, noise + stays, noise, at_ns, at_ns, kick)


def _with_survey(fit: PlaceFit) -> Floats:
    """What stays, with what the constellations contradict each other: a survey's error moves all LEDs of one alike."""
    return fit.stays * (1.0 + LEDS * max(fit.chi2 / fit.freedom - 1.0, 0.0))


def _best(pinned: Pinned, starts: list[Pose]) -> PlaceFit:
    """The best of the fits from several places; the first, unless another is clearly better: tilts are alike."""
    fits = [fit_place(pinned, start) for start in starts]
    best = min(fits, key=lambda fit: fit.chi2 if np.isfinite(fit.chi2) else np.inf)
    return fits[0] if fits[0].chi2 < best.chi2 + TILT_ODDS else best


def _squared(move: Floats, covariance: Floats) -> float:
    return float(move @ np.linalg.solve(covariance, move))


@lru_cache(maxsize=4)
def _standing(rig: Rig) -> dict[int, tuple[Floats, Pose]]:
    """Of constellations that stand still, by their number in the rig: LEDs in the world (6, 3) m, T_world_plane."""
    return {
        k: (robot.T_world_fixed.map(robot.leds), robot.T_world_fixed @ robot.T_robot_plane)
        for k, robot in enumerate(rig.robots)
        if robot.T_world_fixed is not None
    }


def _rows(plan: Plan, found: Matched, solutions: Solutions) -> list[tuple[int, int]]:
    """Rows of the matched robots that stand still and have a pose, with their numbers in the rig."""
    standing = _standing(plan.rig)
    robots, costs = found.robots.tolist(), solutions.costs.min(axis=1).tolist()
    return [(row, robot) for row, robot in enumerate(robots) if robot in standing and costs[row] < NO_SOLUTION]


def _pinned(plan: Plan, blobs: Blobs, seen: Rays, found: Matched, solutions: Solutions) -> Pinned | None:
    """The LEDs that stand still in this frame."""
    standing, parts = _standing(plan.rig), []
    for row, robot in _rows(plan, found, solutions):
        which = int(solutions.costs[row].argmin())
        leds = np.flatnonzero(found.assignment[row] >= 0)
        spots = found.assignment[row, leds]
        rotation, t = solutions.rotations[row, which], solutions.ts[row, which]
        predicted_px = blobs.centres_px[seen.rows[spots]] - solutions.residuals[row, which, leds]
        shift = _shift(plan, predicted_px, plan.layouts[robot][leds] @ rotation.T + t)
        misfit = max(float(solutions.learned[row]), float(solutions.misfits[row, MISFIT])) / t[2]
        own = seen.covariances[spots][:, [0, 1, 1, 2]].reshape(-1, 2, 2)
        stay = STAYS * own + misfit**2 * np.eye(2)
        parts.append((standing[robot][0][leds], seen.rays[spots] - shift, (1.0 - STAYS) * own, stay))
    return Pinned(*map(np.concatenate, zip(*parts, strict=True))) if parts else None


def _starts(plan: Plan, found: Matched, solutions: Solutions) -> list[Pose]:
    """The places of the camera that single constellations tell, by both their tilts."""
    standing = _standing(plan.rig)
    return [
        standing[robot][1] @ Pose.from_matrix(solutions.rotations[row, which], solutions.ts[row, which]).inverse()
        for row, robot in _rows(plan, found, solutions)
        for which in range(2)
        if solutions.costs[row, which] < NO_SOLUTION
    ]


def _shift(plan: Plan, predicted_px: Floats, points: Floats) -> Floats:
    """What shifts the spots of LEDs at points (n, 3) m of the camera's frame (n, 2), rays: the solver's predictions
    hold it.
    """
    rays, spreads = np.empty_like(predicted_px), np.zeros((len(predicted_px), 3))
    undistort(plan.lens, np.ascontiguousarray(predicted_px), spreads.copy(), rays, spreads)
    shift: Floats = rays - points[:, :2] / points[:, 2:]
    return shift


def carried_over(choices: Choices, before: Pose, place: Place) -> None:
    """Poses in the world as the camera's place ``before`` had them, as ``place`` has them; its covariance in theirs."""
    T = place.T_world_camera @ before.inverse()
    # Where there is no other tilt, its row holds anything.
    with np.errstate(all="ignore"):
        choices.positions[...] = choices.positions @ T.rotation.T + T.position
        turned = choices.quaternions @ _times(T.orientation).T
        choices.quaternions[...] = np.where(turned[..., 3:] < 0.0, -turned, turned)
    some = np.flatnonzero(choices.best >= 0)
    both = np.kron(np.eye(2), T.rotation)
    x, y, z = (choices.positions[some, 0] - place.T_world_camera.position).T
    by_place = np.tile(np.eye(6), (len(some), 1, 1))
    by_place[:, 0, 4], by_place[:, 0, 5] = z, -y
    by_place[:, 1, 3], by_place[:, 1, 5] = -z, x
    by_place[:, 2, 3], by_place[:, 2, 4] = y, -x
    own = both @ choices.covariances[some] @ both.T
    choices.covariances[some] = own + by_place @ place.covariance @ np.swapaxes(by_place, 1, 2)


def _times(quat: Floats) -> Floats:
    """The matrix (4, 4) that multiplies a quaternion x y z w by this one from the left."""
    x, y, z, w = quat.tolist()
    return np.array([[w, -z, y, x], [z, w, -x, y], [-y, x, w, z], [-x, -y, -z, w]])
