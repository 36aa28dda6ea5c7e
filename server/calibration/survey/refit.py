"""The physical refit of a rig from robots seen at surveyed poses: lens, LED positions and, where it has one, its world.

Every parameter has a prior about what the rig says, wide against what a good calibration leaves and narrow against
nonsense, so that what the poses do not determine stays. Kept only where held-out poses gain.
"""

from dataclasses import dataclass, replace

import numpy as np

from asterism.protocol.camera import Camera
from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.protocol.rig import Rig
from asterism.server.calibration.leds.labelled import solve_sightings
from asterism.server.calibration.survey.surveyed import Pairs
from asterism.server.calibration.survey.surveyed_fit import (
    NUMBERS,
    Model,
    SurveyedFit,
    Table,
    by_pose,
    chi2_of,
    errors_of,
    fit,
    table_of,
)
from asterism.server.pose.fit import LEDS

# Priors, one sigma: logarithms of the focal length and of fx / fy, principal point px, radial and tangential
# coefficients, LEDs m, shift m and turn rad of the camera in the world.
FOCAL, ASPECT, CENTRE_PX, RADIAL, TANGENTIAL = 0.01, 0.001, 10.0, 0.05, 0.002
LED_M, WORLD_M, WORLD_RAD = 0.3e-3, 5e-3, 5e-3
HIGHER, HELD = 4, 1e-9  # the first coefficient that many calibrations hold at 0, and its prior then
LENS = 4  # parameters before the coefficients
FOLDS = 5
LED_STEP_M, STEP = 1e-5, 1e-3  # of numeric derivatives: m, and sigmas of the prior


@dataclass(frozen=True, slots=True, eq=False)
class Refit:
    """``rig`` is the refitted one, ``fit`` tells parameters and what was used of the n sightings.

    ``better``: whether held-out poses gain, so that the refit is worth having. ``before`` and ``after``: errors (n, 3)
    m and (n,) rad, camera's axes, of poses by the rig as it was and, held out, by the refit. ``lens_sigmas`` and
    ``lens_priors``: one sigma of f, cx, cy px and the coefficients, after and before; ``lens_covariance`` (p, p) of fx,
    fy, cx, cy and the coefficients; ``led_sigmas``: by robot, of an LED's coordinate, m.
    """

    rig: Rig
    fit: SurveyedFit
    better: bool
    before: tuple[Floats, Floats]
    after: tuple[Floats, Floats]
    lens_sigmas: Floats
    lens_priors: Floats
    lens_covariance: Floats
    led_sigmas: dict[str, float]


def refit(rig: Rig, pairs: Pairs) -> Refit:
    """Refit the rig; distortion of higher order that its camera does without stays 0."""
    table = table_of(pairs, rig)
    layout = _Layout(rig, table)
    model = _model(rig, layout)
    full = fit(model, table, layout.priors)
    folds = np.arange(len(table)) % FOLDS
    gain = np.zeros(len(table))
    before = errors_of(pairs, rig, solve_sightings(rig, [s for s, _ in pairs]))
    away, turned = np.full((len(pairs), 3), np.nan), np.full(len(pairs), np.nan)
    for fold in range(FOLDS):
        out = folds == fold
        found = fit(model, table[~out & full.used], layout.priors, full.sigmas).parameters
        gain[out] = _chi2(model, np.zeros_like(found), table[out], full) - _chi2(model, found, table[out], full)
        rows = np.flatnonzero(out)
        here = [pairs[k] for k in rows]
        tried = refitted(rig, layout, found)
        away[rows], turned[rows] = errors_of(here, tried, solve_sightings(tried, [s for s, _ in here]))
    gain = gain[full.used]
    worth = float(gain.sum()) > float(gain.std()) * np.sqrt(len(gain))
    rms = [float(np.sqrt(np.nanmean(errors[full.used, 2] ** 2))) for errors in (before[0], away)]
    camera = rig.camera
    lens_sigmas, lens_priors = (
        np.concatenate([[sigmas[0] * camera.focal_px], sigmas[2 : layout.lens]])
        for sigmas in (np.sqrt(np.diag(full.covariance)), layout.priors)
    )
    better = worth and rms[1] < rms[0]
    new = refitted(rig, layout, full.parameters)
    return Refit(
        new, full, better, before, (away, turned), lens_sigmas, lens_priors,
        layout.lens_covariance(new.camera, full.covariance), layout.led_sigmas(rig, full.covariance),
    )  # fmt: skip


class _Layout:
    """Which parameter is which: the lens, six times three numbers of every surveyed robot, the world."""

    def __init__(self, rig: Rig, table: Table) -> None:
        camera = rig.camera
        held = (np.arange(len(camera.distortion)) >= HIGHER) & (camera.distortion == 0.0)
        radial = np.full(len(camera.distortion), RADIAL)
        if camera.model != "equidistant":
            radial[2:4] = TANGENTIAL
        lens = np.concatenate([[FOCAL, ASPECT, CENTRE_PX, CENTRE_PX], np.where(held, HELD, radial)])
        self.lens = len(lens)
        self.robots = np.unique(table.robots)
        self.world = self.lens + 3 * LEDS * len(self.robots)
        world = np.repeat([WORLD_M, WORLD_RAD], 3) if rig.T_world_camera is not None else np.zeros(0)
        self.priors: Floats = np.concatenate([lens, np.full(self.world - self.lens, LED_M), world])

    def camera(self, camera: Camera, parameters: Floats) -> Camera:
        """The camera with other parameters."""
        focal, aspect, x, y = parameters[:LENS]
        matrix = camera.matrix.copy()
        matrix[0, 0] *= np.exp(focal + 0.5 * aspect)
        matrix[1, 1] *= np.exp(focal - 0.5 * aspect)
        matrix[:2, 2] += x, y
        return replace(camera, matrix=matrix, distortion=camera.distortion + parameters[LENS : self.lens])

    def lens_covariance(self, camera: Camera, covariance: Floats) -> Floats:
        """Covariance (lens, lens) of fx, fy, cx, cy and coefficients, of that of all parameters."""
        fx, fy = camera.matrix[[0, 1], [0, 1]]
        change = np.eye(self.lens)
        change[:2, :2] = [[fx, 0.5 * fx], [fy, -0.5 * fy]]
        told: Floats = change @ covariance[: self.lens, : self.lens] @ change.T
        return told

    def led_sigmas(self, rig: Rig, covariance: Floats) -> dict[str, float]:
        """One sigma of an LED's coordinate, m, of every surveyed robot (RMS)."""
        variances = np.diag(covariance)[self.lens : self.world].reshape(len(self.robots), -1).mean(axis=1)
        ids = [rig.robots[index].id for index in self.robots.tolist()]
        return dict(zip(ids, np.sqrt(variances).tolist(), strict=True))

    def leds(self, parameters: Floats) -> Floats:
        """Displacements (robots, 6, 3) m of the surveyed robots' LEDs in their planes' frames."""
        displaced: Floats = parameters[self.lens : self.world].reshape(-1, LEDS, 3)
        return displaced

    def turn(self, parameters: Floats) -> tuple[Floats, Floats]:
        """Rotation (3, 3) and shift (3,) by which the camera sees all poses moved."""
        if len(parameters) == self.world:
            return np.eye(3), np.zeros(3)
        return exp_rotation(parameters[self.world + 3 :]), parameters[self.world : self.world + 3]


def refitted(rig: Rig, layout: _Layout, parameters: Floats) -> Rig:
    """The rig with these parameters."""
    robots = list(rig.robots)
    for index, displaced in zip(layout.robots.tolist(), layout.leds(parameters), strict=True):
        robot = robots[index]
        robots[index] = replace(robot, leds=robot.T_robot_plane.map(robot.leds_plane + displaced))
    world = rig.T_world_camera
    if world is not None:
        world = world @ Pose.from_matrix(*layout.turn(parameters)).inverse()
    return replace(
        rig, camera=layout.camera(rig.camera, parameters), robots=tuple(robots), T_world_camera=world, z_correction=None
    )


def _model(rig: Rig, layout: _Layout) -> Model:
    rows = {robot: k for k, robot in enumerate(layout.robots.tolist())}

    def placed(parameters: Floats, table: Table) -> tuple[Camera, Floats, Floats, Floats, Floats]:
        turn, shift = layout.turn(parameters)
        which = np.array([rows[robot] for robot in table.robots.tolist()])
        return (
            layout.camera(rig.camera, parameters),
            table.layouts + layout.leds(parameters)[which],
            table.optics,
            turn @ table.rotations,
            table.ts @ turn.T + shift,
        )

    def model(parameters: Floats, table: Table) -> tuple[Floats, Floats, Floats]:
        here = placed(parameters, table)
        derivatives = np.zeros((len(table), NUMBERS, len(parameters)))
        for k in [*range(layout.lens), *range(layout.world, len(parameters))]:
            step = np.zeros(len(parameters))
            step[k] = STEP * layout.priors[k]
            up, down = (table.spots(*placed(moved, table)) for moved in (parameters + step, parameters - step))
            derivatives[:, :, k] = (up - down) / (2 * step[k])
        camera, layouts, optics, rotations, ts = here
        for axis in range(3):
            step = np.zeros(3)
            step[axis] = LED_STEP_M
            up, down = (table.spots(camera, layouts + d, optics, rotations, ts) for d in (step, -step))
            # An LED's spot depends on its own place alone.
            change = ((up - down) / (2 * LED_STEP_M)).reshape(-1, LEDS, 2)
            for robot, row in rows.items():
                of = np.flatnonzero(table.robots == robot)
                for led in range(LEDS):
                    column = layout.lens + 3 * LEDS * row + 3 * led + axis
                    derivatives[of, 2 * led, column] = change[of, led, 0]
                    derivatives[of, 2 * led + 1, column] = change[of, led, 1]
        return table.spots(*here), derivatives, by_pose(table, *here)

    return model


def _chi2(model: Model, parameters: Floats, table: Table, full: SurveyedFit) -> Floats:
    predicted, _, jacobian = model(parameters, table)
    return chi2_of(table, table.centres.reshape(len(table), NUMBERS) - predicted, jacobian, full.sigmas)
