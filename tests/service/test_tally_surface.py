"""What the end of a run says of the surface: how many poses rest on it, how many not, and why."""

from collections.abc import Sequence
from typing import cast

import numpy as np

from asterism.server.centres.blobs import Blobs
from asterism.server.chain.frame import Frame, FrameResult
from asterism.server.pose.solve import Lost, OnSurface, PoseEstimate
from asterism.server.service.tally import Tally


def lines(standings: Sequence[tuple[str, str] | None]) -> list[str]:
    """Of a run in which robot a stood so, frame by frame, and robot b stands on nothing."""
    tally = Tally(["a", "b"])
    at, nothing = np.zeros(3), np.zeros((0, 2))
    turn = np.array([0.0, 0.0, 0.0, 1.0])
    for index, standing in enumerate(standings):
        plain = PoseEstimate(at, turn, np.eye(6), (), (), nothing, 0.0, None)
        told = None if standing is None else OnSurface(*standing, 0.0, 1.0, 0.0, 1.0)
        answers: dict[str, PoseEstimate | Lost] = {
            "a": PoseEstimate(at, turn, np.eye(6), (), (), nothing, 0.0, None, surface=told),
            "b": plain,
        }
        frame = Frame(np.zeros((8, 8), np.uint8), index, index)
        # Nobody looks at spots of robots with fewer than six LEDs.
        tally.add(frame, FrameResult(index, index, cast(Blobs, None), answers, np.zeros(2)))
    return tally.lines()


def test_poses_are_counted_by_how_robots_stand_with_the_reason() -> None:
    on, up = ("ON_SURFACE", ""), ("LIFTED", "1.02 mm above")
    assert lines([on, on, up, up, ("BEYOND", "no surface there")]) == [
        "a  5 TRACKED; 2 rest on the surface, not 2 LIFTED, 1 BEYOND: 1.02 mm above",
        "b  5 TRACKED",
    ]


def test_where_all_is_well_nothing_more_is_said() -> None:
    assert lines([("ON_SURFACE", "")] * 3)[0] == "a  3 TRACKED; 3 rest on the surface"
    assert lines([None])[0] == "a  1 TRACKED"
