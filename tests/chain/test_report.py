"""A frame's messages: poses first, and none waits for what comes behind it."""

import pytest

from asterism.protocol.messages import FRAME_REPORT, ODOMETRY
from asterism.protocol.rig import load_rig
from asterism.server import Frame, Tracks, localize
from asterism.server.chain import report as module
from asterism.server.simulation.demo_rig import DEMO_RIG
from asterism.server.simulation.simulate import Scene


def test_poses_go_out_before_the_frame_report_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = load_rig(DEMO_RIG)
    scene = Scene(rig, 0)
    frame = Frame(scene.render(0, scene.truth(0, 0.0)), 1, 0)
    result, _ = localize(frame, rig, Tracks.none())
    made = []
    whole = module.frame_report
    monkeypatch.setattr(module, "frame_report", lambda *told: made.append(told) or whole(*told))
    messages = module.report(frame, result, rig, 2)
    for robot in rig.robots:
        message = next(messages)
        assert (message.kind, made) == (ODOMETRY, [])
        assert message.key.endswith(f"/{robot.id}/odometry")
    assert next(messages).kind is FRAME_REPORT
    assert next(messages, None) is None
