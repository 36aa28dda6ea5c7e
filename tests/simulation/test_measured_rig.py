"""The example's rig: its errors are those of the tools that it names, every seed has its own."""

import numpy as np
import pytest

from asterism.server.calibration.leds.calibration import check_distance
from asterism.server.simulation.measured_rig import (
    BOARD,
    CALIPERS_M,
    CALIPERS_MARK_M,
    FOCAL_PX,
    FOCAL_SHARE,
    PLATE_HEIGHT_M,
    RULER_M,
    RULER_MARK_M,
    SOLDERED_M,
    MeasuredRig,
    draw_rig,
)

SEEDS = 300


@pytest.fixture(scope="module")
def rigs() -> list[MeasuredRig]:
    return [draw_rig(seed) for seed in range(SEEDS)]


def test_a_seed_is_a_rig() -> None:
    first, again, other = draw_rig(5), draw_rig(5), draw_rig(6)
    np.testing.assert_array_equal(first.ruler, again.ruler)
    np.testing.assert_array_equal(first.true.camera.matrix, again.true.camera.matrix)
    assert first.calipers == again.calipers
    assert (first.true.robots[0].leds != other.true.robots[0].leds).any()
    assert first.true.camera.focal_px != other.true.camera.focal_px


def test_tools_are_as_good_as_they_are(rigs: list[MeasuredRig]) -> None:
    """Rounding to a mark adds a twelfth of its square to the variance."""

    def spread(values: list[np.ndarray]) -> float:
        return float(np.sqrt(np.square(np.array(values)).mean()))

    ruled = spread([rig.ruler[:, :2] - rig.true.robots[0].leds[:, :2] for rig in rigs])
    assert ruled == pytest.approx(np.hypot(RULER_M, RULER_MARK_M / np.sqrt(12)), rel=0.05)
    assert ruled == pytest.approx(0.4e-3, abs=0.03e-3)  # what README.md says
    soldered = spread([rig.board.leds[:, :2] - np.array(BOARD) for rig in rigs])
    assert soldered == pytest.approx(SOLDERED_M, rel=0.05)
    off = []
    for rig in rigs:
        first, second, metres = rig.calipers
        leds = rig.true.robots[0].leds
        off.append(np.array(metres - np.linalg.norm(leds[first] - leds[second])))
        assert metres / CALIPERS_MARK_M == pytest.approx(round(metres / CALIPERS_MARK_M), abs=1e-6)
    assert spread(off) == pytest.approx(np.hypot(CALIPERS_M, CALIPERS_MARK_M / np.sqrt(12)), rel=0.15)
    focal = spread([np.array(rig.true.camera.focal_px / FOCAL_PX - 1.0) for rig in rigs])
    assert focal == pytest.approx(FOCAL_SHARE, rel=0.15)


def test_a_ruler_has_marks_and_a_plate_is_flat(rigs: list[MeasuredRig]) -> None:
    for rig in rigs:
        np.testing.assert_allclose(rig.ruler / RULER_MARK_M, np.rint(rig.ruler / RULER_MARK_M), atol=1e-9)
        assert len(set(rig.ruler[:, 2])) == 1
        assert rig.ruler[0, 2] == pytest.approx(PLATE_HEIGHT_M, abs=1e-3)


def test_calibrations_believe_the_calipers(rigs: list[MeasuredRig]) -> None:
    for rig in rigs:
        alpha = rig.true.robots[0]
        check_distance(type(alpha)("alpha", rig.ruler), rig.calipers)
