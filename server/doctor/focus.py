"""Is the lens in focus, are spots as large as the rig says, are they streaks."""

import math
from collections.abc import Sequence

import numpy as np

from asterism.protocol.geometry import Floats
from asterism.protocol.rig import Rig
from asterism.server.doctor.blur import Blur, centre_cost, fit_blur
from asterism.server.doctor.cuts import UNKNOWN, Cut, pixels_by_plane
from asterism.server.doctor.finding import Finding, Verdict, graded
from asterism.server.doctor.gather import Gathered, Sightings

# Centres that are twice as uncertain as under a sharp lens cost what half the distance would give; four times, a robot.
LOOK_COST, WRONG_COST = 2.0, 4.0
SIZE_LOOK, SIZE_WRONG = 1.2, 1.8  # times larger or smaller than led.radius says
LEAST_DIAMETER_PX = 3.0  # docs/hardware.md: below that centres are noisier than light demands
STREAK_LOOK, STREAK_WRONG = 0.6, 2.0  # of the spot's width; up to the first the chain loses nothing that was measured
BEYOND = 1.1  # times the rig's range, before it is called wrong: robots are found a little farther
FEWEST = 5  # frames of a robot for its median to tell


def blurs(cuts: Sequence[Cut], rig: Rig) -> dict[int, Blur]:
    """The blur and size of every robot's spots, by its number; of nobody's spots under UNKNOWN."""
    found = {}
    for robot in sorted({cut.robot for cut in cuts}):
        radius = rig.robots[robot].led_radius if robot != UNKNOWN else None
        fitted = fit_blur([cut for cut in cuts if cut.robot == robot], radius)
        if fitted is not None:
            found[robot] = fitted
    return found


def check_focus(found: dict[int, Blur], rig: Rig) -> Finding:
    """By what the blur costs: how much less sure centres are than a sharp lens would leave them."""
    named = {robot: blur for robot, blur in found.items() if robot != UNKNOWN} or found
    if not named:
        return Finding("focus", Verdict.UNTOLD, "no spot to tell it by", "Show the camera a robot with its LEDs on.")
    costs = {robot: centre_cost(blur.radius_px, blur.blur_px) for robot, blur in named.items()}
    middle = float(np.median(list(costs.values())))
    blur, radius = (float(np.median([getattr(b, key) for b in named.values()])) for key in ("blur_px", "radius_px"))
    worst = max(costs, key=lambda robot: costs[robot])
    verdict = graded(middle, LOOK_COST, WRONG_COST)
    told = f"blur {blur:.2f} px, spots {2 * radius:.1f} px wide: centres {middle:.1f} times as uncertain as sharp"
    if verdict > Verdict.GOOD:
        return Finding("focus", verdict, told, "Turn the lens until the blur is least: --watch shows it as you turn.")
    if worst != UNKNOWN and costs[worst] >= LOOK_COST:
        name = rig.robots[worst].id
        advice = f"{name} is out of focus, others are not: focus at the middle of the range, or close the aperture."
        return Finding("focus", Verdict.LOOK, f"{told}; {name} {costs[worst]:.1f} times", advice)
    return Finding("focus", verdict, told)


def check_sizes(found: dict[int, Blur], gathered: Gathered) -> Finding:
    """The lights' radius against led.radius, their spots' width, and distances against the rig's range."""
    rig, seen = gathered.rig, gathered.sightings
    named = {robot: blur for robot, blur in found.items() if robot != UNKNOWN}
    if not named:
        return Finding("spot sizes", Verdict.UNTOLD, "no robot was found")
    # Along the camera's axis: in a corner of the image a robot on the floor is farther away than the floor.
    away = [float(pose.position[2]) for pose in seen.poses]
    near, far = float(np.quantile(away, 0.02)), float(np.quantile(away, 0.98))
    widths = [2.0 * blur.radius_px for blur in named.values()]
    told = f"{min(widths):.1f} to {max(widths):.1f} px wide at {near:.2f} to {far:.2f} m"
    if off := _over_told(named, rig):
        worst = max(off, key=lambda robot: abs(math.log(off[robot])))
        apart, robot = math.exp(abs(math.log(off[worst]))), rig.robots[worst].id
        told += f", {off[worst]:.2f} times led.radius"
        if apart >= SIZE_LOOK:
            advice = f"Measure the light of {robot}'s LEDs: it looks like led.radius: {named[worst].radius_m:.4f}."
            return Finding("spot sizes", graded(apart, SIZE_LOOK, SIZE_WRONG), f"{told} ({robot})", advice)
    if rig.range_m is not None and (near * BEYOND < rig.range_m[0] or far > BEYOND * rig.range_m[1]):
        advice = f"Set the rig's range to where robots are: it is {rig.range_m[0]:g} to {rig.range_m[1]:g} m."
        return Finding("spot sizes", Verdict.LOOK, told, advice)
    if min(widths) < LEAST_DIAMETER_PX:
        advice = f"Larger lights, a longer lens or less distance: {LEAST_DIAMETER_PX:g} px at least."
        return Finding("spot sizes", Verdict.LOOK, told, advice)
    return Finding("spot sizes", Verdict.GOOD, told)


def _over_told(named: dict[int, Blur], rig: Rig) -> dict[int, float]:
    """The lights' radii over those of the rig. Under a blur wider than the light nothing is left of its size."""
    told = {robot: rig.robots[robot].led_radius for robot, blur in named.items() if blur.blur_px < blur.radius_px}
    return {robot: named[robot].radius_m / radius for robot, radius in told.items() if radius is not None}


def check_streaks(gathered: Gathered, found: dict[int, Blur]) -> Finding:
    """How far spots are drawn out in a direction that their robots' tilt does not explain."""
    seen, rig = gathered.sightings, gathered.rig
    lengths: dict[str, float] = {}
    for robot, blur in found.items():
        mine = seen.of(robot) if robot != UNKNOWN else None
        if mine is not None and len(mine.frames) >= FEWEST:
            drawn = np.quantile(streak_lengths(rig, mine, blur.radius_m), 0.9)
            lengths[rig.robots[robot].id] = float(drawn) / (2.0 * blur.radius_px)
    if not lengths:
        return Finding("motion streaks", Verdict.UNTOLD, "no robot was found")
    worst = max(lengths, key=lambda name: lengths[name])
    verdict = graded(lengths[worst], STREAK_LOOK, STREAK_WRONG)
    told = f"spots drawn out by up to {lengths[worst]:.1f} of their width ({worst})"
    if verdict == Verdict.GOOD:
        return Finding("motion streaks", verdict, "none that matter" if lengths[worst] < 0.3 else told)
    return Finding("motion streaks", verdict, told, "Expose for a shorter time, or let nothing shake the camera.")


def streak_lengths(rig: Rig, seen: Sightings, radius_m: float) -> Floats:
    """By how many px (m,) the spots of one robot's sightings are drawn out: a streak of length d has d^2 / 12 in the
    second moments of its light, along one direction, beside the disc's quarter of the squared semi-axes.
    """
    robot = rig.robots[int(seen.robots[0])]
    axes = robot.T_robot_plane.rotation[:, :2]
    doubled = 2.0 * seen.shapes[..., 2]
    uneven = 0.125 * (seen.shapes[..., 0] ** 2 - seen.shapes[..., 1] ** 2)
    # Half the difference of the two principal moments, as a vector at twice the angle.
    across = np.stack([np.nanmean(uneven * np.cos(doubled), 1), np.nanmean(uneven * np.sin(doubled), 1)], axis=-1)
    lengths = np.empty(len(seen.frames))
    for k, pose in enumerate(seen.poses):
        disc = radius_m * pixels_by_plane(rig, pose.map(robot.leds.mean(axis=0)), pose.rotation @ axes)
        flat = disc @ disc.T
        left = across[k] - np.array([0.125 * (flat[0, 0] - flat[1, 1]), 0.25 * flat[0, 1]])
        lengths[k] = math.sqrt(24.0 * float(np.hypot(*left)))
    return lengths
