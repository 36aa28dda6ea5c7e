"""Is the error budget true? `python -m tests.measure.budget [FRAMES]`.

Every frame has a camera, LED positions and an angular offset of its own, drawn from what the budget assumes to be
unknown, is rendered with them, and located alone by the nominal rig. Printed per distance and component: RMS error
over the budget's prediction at the very same poses (1 where it is true), and its own sampling error; poses with the
wrong one of both tilts are counted, and left out.
"""

import sys
from dataclasses import replace

import numpy as np
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

from asterism.protocol.geometry import Pose, log_rotation
from asterism.server import Frame, PoseEstimate, Tracks, localize
from asterism.server.budget.budget import COMPONENTS, TILTS, Light, covariances_of, poses_at
from asterism.server.budget.uncertainty import Uncertainty
from asterism.server.simulation.simulate import Scene, Truth
from tests.budget.error_sources import Errors
from tests.chain.judging import TILTED_RAD
from tests.rigs import make_rig

DISTANCES = (0.8, 1.2, 1.9)  # m
PLACES = np.array([[x, y] for x in (250.0, 640.0, 1030.0) for y in (220.0, 512.0, 804.0)])


def main(count: int) -> None:
    """Measure and print."""
    rig, uncertainty = make_rig(1, seed=3), Uncertainty()
    robot = rig.robots[0]
    table = Table(title="RMS error over the budget's prediction", box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("m", "frames", "lost", "wrong tilt", *COMPONENTS, "+-", "weighted"):
        table.add_column(heading, justify="right")
    every, every_weighted = [], []
    for distance in DISTANCES:
        rng = np.random.default_rng([7, round(10 * distance)])
        poses, _ = poses_at(rig, robot, distance, PLACES, TILTS)
        chosen = rng.permutation(len(poses))[np.arange(count // len(DISTANCES)) % len(poses)]
        predicted = covariances_of(rig, robot, poses, uncertainty, Light.assumed(rig.centre)).sum(axis=1)
        ratios, weighted, lost, wrong = [], [], 0, 0
        for number, k in enumerate(track(chosen, description=f"{distance} m", transient=True)):
            pose = Pose.from_matrix(poses.rotations[k], poses.ts[k])
            errors = Errors.drawn(uncertainty, rng)
            real = replace(robot, leds=errors.seen_leds(robot, pose))
            scene = Scene(replace(rig, camera=errors.camera(rig.camera), robots=(real,)), number)
            image = scene.render(number, [Truth(robot.id, pose, (True,) * 6)])
            answer = localize(Frame(image, exposed_ns=1, index=number), rig, Tracks.none())[0].answers[robot.id]
            if not isinstance(answer, PoseEstimate):
                lost += 1
                continue
            error = np.concatenate(
                [answer.position - pose.position, log_rotation(answer.pose.rotation @ pose.rotation.T)]
            )
            if np.linalg.norm(error[3:]) > TILTED_RAD:
                wrong += 1
                continue
            ratios.append(error / np.sqrt(np.diag(predicted[k])))
            weighted.append(error @ np.linalg.solve(predicted[k], error))
        every += ratios
        every_weighted += weighted
        rms = np.sqrt(np.mean(np.square(ratios), axis=0))
        table.add_row(
            f"{distance:.1f}", str(len(ratios)), str(lost), str(wrong), *(f"{value:.3f}" for value in rms),
            f"{1 / np.sqrt(2 * len(ratios)):.3f}", f"{np.mean(weighted):.2f}",
        )  # fmt: skip
    table.add_section()
    rms = np.sqrt(np.mean(np.square(every), axis=0))
    table.add_row(
        "all", str(len(every)), "", "", *(f"{value:.3f}" for value in rms), f"{1 / np.sqrt(2 * len(every)):.3f}",
        f"{np.mean(every_weighted):.2f}",
    )  # fmt: skip
    Console(width=120).print(table)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1500)
