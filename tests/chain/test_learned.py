"""What frames tell of how far off the rig is: learned per robot, told with every frame, begun with anywhere."""

from dataclasses import replace

import numpy as np

from asterism.protocol.geometry import Floats, Pose, exp_rotation
from asterism.protocol.rig import load_rig
from asterism.server import Frame, Tracks, localize
from asterism.server.chain.report import frame_report
from asterism.server.pose.track import BLOCK_NS
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.simulation.simulate import Scene
from tests.chain.frames import poses_apart
from tests.measure.ruler import ROBOTS, Drawn, draw_rig, located, rays_of

RIG = load_rig(DEMO_RIG)
STEP_NS = 50_000_000
FIRST = 20 * BLOCK_NS


def film(drawn: Drawn, tracks: Tracks, frames: range) -> list[tuple[Floats, dict[int, Floats]]]:
    """Of every frame what was learned before it, and every robot's covariance; the tracks are written."""
    still = poses_apart(drawn.true, np.random.default_rng(5), depth_m=(1.15, 1.45), tilt_deg=(20.0, 40.0))
    told = []
    for frame in frames:
        swing = exp_rotation(0.2 * np.sin(0.15 * frame) * np.array([1.0, 0.0, 1.0]))
        poses = {name: pose @ Pose.from_matrix(swing, np.zeros(3)) for name, pose in still.items()}
        seen, centres, _ = rays_of(drawn, poses, np.random.default_rng([frame, 6]))
        now = FIRST + frame * STEP_NS
        learned = tracks.learned_at(now)
        found, _, choices = located(seen, centres, drawn.plan, tracks, now)
        told.append((learned, dict(zip(found.robots.tolist(), choices.covariances, strict=True))))
    return told


def test_one_bad_plate_is_learned_and_does_not_loosen_the_others() -> None:
    good, bad = draw_rig(0, 0.5e-3, bad=0), draw_rig(0, 0.5e-3, bad=1)
    blocks = range(2 * BLOCK_NS // STEP_NS)
    told, beside = film(bad, Tracks.none(ROBOTS), blocks)[-1], film(good, Tracks.none(ROBOTS), blocks)[-1]
    assert 0.15e-3 < told[0][0] < 1.0e-3
    assert told[0][1:].max() < 0.03e-3
    for robot in range(1, ROBOTS):
        np.testing.assert_allclose(told[1][robot], beside[1][robot], rtol=1e-6, atol=1e-15)
    assert np.trace(told[1][0]) > 20.0 * np.trace(beside[1][0])


def test_who_begins_anywhere_with_what_was_learned_agrees_a_block_later() -> None:
    drawn, block = draw_rig(1, 0.4e-3), BLOCK_NS // STEP_NS
    whole = film(drawn, Tracks.none(ROBOTS), range(3 * block + 1))
    middle = block + block // 2
    part = film(drawn, Tracks.knowing(whole[middle][0]), range(middle, 3 * block + 1))
    assert np.array_equal(part[0][0], whole[middle][0])
    np.testing.assert_allclose(part[-1][0], whole[-1][0], rtol=0.02)
    again = film(drawn, Tracks.none(ROBOTS), range(block + 1))
    assert np.array_equal(again[-1][0], whole[block][0])


def test_the_frame_report_tells_what_a_frame_was_solved_with() -> None:
    scene = Scene(RIG, 2)
    frame = Frame(scene.render(0, scene.truth(0, 0.0)), FIRST, 0)
    learned = np.arange(len(RIG.robots)) * 1e-4
    before = Tracks.knowing(learned)
    result, tracks = localize(frame, RIG, before)
    assert np.array_equal(result.learned, learned)
    assert list(frame_report(frame, result, RIG, 0).learned.led_misfit) == learned.tolist()
    assert np.array_equal(before.misfits[:, 0], learned)
    assert np.array_equal(tracks.learned_at(FIRST), learned)
    alone, _ = localize(replace(frame), RIG, Tracks.none())
    assert not alone.learned.any()
