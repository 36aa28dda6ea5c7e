"""Pictures whose blocks were drawn from the picture before, as H.264 does: perfect spots, a little off, owned up to."""

import numpy as np

from asterism.protocol.geometry import Floats, log_rotation
from tests.chain.frames import alone, draw, estimates, poses_apart
from tests.rigs import FOCAL_PX, make_rig

OFF_PX = 0.05  # one sigma, of a spot


def test_spots_that_are_off_together_with_their_blocks_widen_all_poses(rng: np.random.Generator) -> None:
    nees = []
    for frame in range(6):
        rig = make_rig(4, seed=frame)
        poses = poses_apart(rig, rng, depth_m=(0.9, 1.4))

        def moved(led: Floats, axis: Floats) -> Floats:
            return led + np.append(rng.normal(scale=OFF_PX / FOCAL_PX * led[2], size=2), 0.0)

        # No noise is left in such a picture.
        image = draw(rig, poses, apparent=moved).expose()
        for name, answer in estimates(alone(image, rig)).items():
            turned = log_rotation(answer.pose.rotation @ poses[name].rotation.T)
            error = np.concatenate([answer.position - poses[name].position, turned])
            nees.append(float(error @ np.linalg.solve(answer.covariance, error)))
    assert len(nees) == 24
    assert 3.0 < np.mean(nees) < 12.0
