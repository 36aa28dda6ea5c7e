"""Why a robot is missing: from frames in which one thing is wrong."""

from dataclasses import replace

import numpy as np

from asterism.protocol.rig import Rig
from asterism.server.identity.identify import identify
from asterism.server.identity.plan import plan_for
from asterism.server.identity.rays import Rays
from asterism.server.pose.track import Tracks
from tests.helpers import facing_pose
from tests.identity.test_identification import cold, spots_of
from tests.identity.test_loose import measured
from tests.rigs import make_rig

RIG = make_rig(3, seed=4)


def seen(rng: np.random.Generator, rig: Rig = RIG, depth_m: float = 1.3, tilt: float = 30.0, **kinds: object) -> Rays:
    """The rig's first robot, alone."""
    pose = facing_pose(rng, (depth_m, depth_m), (tilt, tilt))
    return spots_of(plan_for(rig), {0: pose}, rng, **kinds)[0]  # type: ignore[arg-type]


def reason(spots: Rays, rig: Rig) -> str:
    matches = cold(spots, rig)
    assert 0 not in matches.found.robots
    return matches.doubts.get(0, "") or matches.reasons.get(0, "")


def test_a_robot_beyond_the_range_says_how_far_it_is(rng: np.random.Generator) -> None:
    near, far = replace(RIG, range_m=(1.8, 3.0)), replace(RIG, range_m=(0.5, 0.9))
    assert reason(seen(rng), near).startswith("its constellation is seen at 1.3 m, nearer than range (1.8 m)")
    assert reason(seen(rng), far).startswith("its constellation is seen at 1.3 m, farther than range (0.9 m)")


def test_a_mirrored_image_is_named(rng: np.random.Generator) -> None:
    spots, mirror = seen(rng), np.array([-1.0, 1.0])
    told = reason(spots._replace(flat=spots.flat * mirror, rays=spots.rays * mirror), RIG)
    assert told.startswith("its constellation is seen mirrored: the image is flipped")


def test_spots_that_are_too_far_off_say_by_how_much_and_what_to_run(rng: np.random.Generator) -> None:
    told = []
    for _ in range(12):
        matches = cold(seen(rng, measured(RIG, rng, 2.5e-3)), RIG)
        if 0 not in matches.found.robots:
            told.append(matches.doubts.get(0, "") or matches.reasons.get(0, ""))
    named = [text for text in told if text.startswith("six spots fit but for ")]
    assert len(told) >= 6
    assert len(named) >= len(told) // 2
    assert all("px" in text and text.endswith("calibrate leds") for text in named)


def test_spots_that_are_not_alike_are_named(rng: np.random.Generator) -> None:
    spots = seen(rng)
    heights = spots.heights.copy()
    heights[[0, 1]] *= 0.08
    assert reason(spots._replace(heights=heights), RIG).startswith("six spots fit, but they are not alike")


def test_two_leds_that_look_like_one_are_named(rng: np.random.Generator) -> None:
    """Drawn near each other, so that the one spot lies between them."""
    leds = RIG.robots[0].leds.copy()
    leds[1] = leds[0] + [0.004, 0.0, 0.0]
    rig = replace(RIG, robots=(replace(RIG.robots[0], leds=leds), *RIG.robots[1:]))
    spots = seen(rng, rig, hidden={0: [0, 1]})
    assert reason(spots, rig).startswith("four of its LEDs fit, and two look like one")


def test_nothing_is_said_where_nothing_explains_it(rng: np.random.Generator) -> None:
    for _ in range(10):
        spots, _ = spots_of(plan_for(RIG), {}, rng, clutter=12)
        matches = cold(spots, RIG)
        assert not any(text.startswith(("its const", "six spots fit, but")) for text in matches.reasons.values())


def test_a_reason_holds_for_half_a_second_without_a_search_and_ends_when_the_robot_is_back(
    rng: np.random.Generator,
) -> None:
    plan, tracks = plan_for(replace(RIG, range_m=(1.8, 3.0))), Tracks.none(3)
    first = identify(seen(rng), plan, tracks, 10_000_000_000)
    empty = seen(rng, hidden={0: [0, 1, 2, 3, 4, 5]})
    again = identify(empty, plan, tracks, 10_400_000_000)
    assert first.reasons[0] == again.reasons[0]
    later = identify(empty, plan, tracks, 10_600_000_000)
    assert later.reasons == {}
    identify(seen(rng), plan, tracks, 20_000_000_000)
    identify(seen(rng, depth_m=2.0), plan, tracks, 20_100_000_000)
    assert identify(empty, plan, tracks, 20_200_000_000).reasons == {}
