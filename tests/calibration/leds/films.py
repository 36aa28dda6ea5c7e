"""Films of one robot moved about by hand in front of the camera, with truth."""

from pathlib import Path

import cv2
import numpy as np

from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.protocol.rig import Rig, load_rig
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.simulation.simulate import Look, Scene, Truth
from tests.rigs import random_layouts

DEPTHS_M = (0.8, 1.5)
MOTIONS = ("about", "shifted", "turned flat", "one axis")


def hand_poses(count: int, seed: int, motion: str = "about", depths_m: tuple[float, float] = DEPTHS_M) -> list[Pose]:
    """T_camera_plane of a plate that a hand moves about, tilted by up to 45 degrees in all directions and turned; or
    only ``shifted``, only turned about its normal (``turned flat``), only tilted about ``one axis``.
    """
    assert motion in MOTIONS
    start = np.random.default_rng([seed, 77]).uniform(0, 2 * np.pi, 6)
    middle, swing = np.mean(depths_m), 0.5 * np.ptp(depths_m)
    poses = []
    for s in np.arange(count) / count * 2 * np.pi:
        z = middle + swing * np.sin(3 * s + start[0])
        position = z * np.array([0.28 * np.sin(5 * s + start[1]), 0.2 * np.sin(7 * s + start[2]), 1.0])
        tilts = np.radians(33.0) * np.array([np.sin(4 * s + start[3]), np.sin(6 * s + start[4])])
        spin = start[5] + 5 * s
        if motion != "about":
            # No hand holds perfectly still.
            shake = np.radians(0.7) * np.array([np.sin(9 * s), np.cos(11 * s)])
            tilts = shake + ([tilts[0], 0.0] if motion == "one axis" else 0.0)
            spin = spin if motion == "turned flat" else start[5]
        turn = exp_rotation(np.array([tilts[0], 0.0, 0.0])) @ exp_rotation(np.array([0.0, tilts[1], 0.0]))
        facing = turn @ np.diag([1.0, -1.0, -1.0]) @ exp_rotation(np.array([0.0, 0.0, spin]))
        poses.append(Pose.from_matrix(facing, position))
    return poses


def off_by(rng: np.random.Generator, size_m: float) -> Floats:
    """Six displacements (6, 3) of that length in random directions."""
    off = rng.normal(size=(6, 3))
    displaced: Floats = size_m * off / np.linalg.norm(off, axis=1, keepdims=True)
    return displaced


def write_film(
    folder: Path, frames: int, seed: int, motion: str = "about", look: Look | None = None, off_m: float = 1e-3
) -> Rig:
    """A rendered film of robot alpha: ``frames/``, ``camera.yaml``, ``rig.yaml`` whose positions are off by ``off_m``
    each, ``true.yaml`` whose positions are true (and off the common plane by 0.2 mm); returns the true rig.
    """
    (folder / "frames").mkdir(parents=True)
    (folder / "camera.yaml").write_text((DEMO_RIG.parent / "camera.yaml").read_text())
    rng = np.random.default_rng([seed, 78])
    leds = np.column_stack([random_layouts(1, seed)[0], 0.012 + 2e-4 * rng.standard_normal(6)])
    for name, values in (("true.yaml", leds), ("rig.yaml", leds + off_by(rng, off_m))):
        rows = "".join(
            f"      - [{x:.6f}, {y:.6f}, {z:.6f}]   # LED {k}\n" for k, (x, y, z) in enumerate(values.tolist())
        )
        (folder / name).write_text(
            "# measured with a ruler\ncamera: camera.yaml   # the 12 mm lens\nrange: [0.70, 1.8]\nrobots:\n"
            f"  alpha:   # the first one\n    leds:\n{rows}    led: {{radius: 2.5e-3}}\n"
        )
    rig = load_rig(folder / "true.yaml")
    scene = Scene(rig, seed, look)
    T_plane_robot = rig.robots[0].T_robot_plane.inverse()
    for index, pose in enumerate(hand_poses(frames, seed, motion)):
        lit = tuple((np.random.default_rng([seed, 79, index]).random(6) >= scene.look.hidden).tolist())
        image = scene.render(index, [Truth("alpha", pose @ T_plane_robot, lit)])
        assert cv2.imwrite(str(folder / "frames" / f"{index:05d}.png"), image)
    return rig
