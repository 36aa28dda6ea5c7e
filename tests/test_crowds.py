"""Crowds, reflections and strangers, rendered: nobody is taken for somebody else, and no pose is wrong in silence."""

import pytest

from tests.measure.identity import look_at

# Frames that once went wrong, and some that did not.
FRAMES = [
    *[("crowd 8", k) for k in (0, 1, 2, 519)],
    *[("crowd 20", k) for k in (0, 25, 53)],
    ("crowd 50", 13),
    *[("polished floor", k) for k in (0, 5, 105)],
    *[("polished, robot lacks 1", k) for k in (3, 15, 20, 72)],
    *[("polished, robot lacks 2", k) for k in (0, 1, 15, 16, 20)],
    *[("strangers", k) for k in (0, 1, 2)],
    *[("touching pairs", k) for k in (0, 1)],
    *[("clutter alone", k) for k in range(6)],
]


@pytest.mark.parametrize(("scene", "number"), FRAMES)
def test_nobody_is_taken_for_somebody_else(scene: str, number: int) -> None:
    sightings, _ = look_at(scene, number)
    assert sightings
    bad = [str(sighting) for sighting in sightings if sighting.bad in ("wrong", "tilt")]
    assert not bad, bad


def test_visible_robots_are_found_side_by_side_and_among_strangers() -> None:
    for scene in ("touching pairs", "strangers", "polished floor"):
        sightings, _ = look_at(scene, 3)
        visible = [sighting for sighting in sightings if sighting.judged.visible >= 5]
        assert visible
        assert all(sighting.judged.answer is not None for sighting in visible), scene
