"""Smoothing for evaluation, forwards and backwards: what came after a frame tells of its poses as well.

The filter of `smooth` runs forwards; from its end what it believed is gone over backwards (Rauch, Tung, Striebel), in
every manner of moving for itself: what is known of the next frame is mixed by how likely each manner led there. A robot
out of sight for long, a jump and the other tilt end a stretch, as they do forwards: nothing is carried over them.

So that an hour goes through in little memory, frames are told as soon as `LAG_S` came after them, in blocks of
`BLOCK_S`: what comes later still changes nothing that counts.

Source: Koch, "Fixed-interval retrodiction approach to Bayesian IMM-MHT for maneuvering multiple targets", IEEE Trans.
Aerospace and Electronic Systems 36(1), 2000; Nadarajah, Tharmarasa, McDonald, Kirubarajan, "IMM forward filtering and
backward smoothing for maneuvering target tracking", the same 48(3), 2012, of mixing per manner.
"""

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, TypeVar

import numpy as np

from asterism.protocol.geometry import Floats, Pose
from asterism.protocol.messages import Velocity
from asterism.protocol.rig import Rig
from asterism.server.chain.belief import LEAST, Belief, Step, mix
from asterism.server.chain.frame import FrameResult
from asterism.server.chain.manners import changes, moved_on, unforeseen
from asterism.server.chain.smooth import FILTER, Motion, Seen, estimates, follow, seen_in, smoothed
from asterism.server.pose.solve import Lost, PoseEstimate

BOTH = f"{FILTER}, forwards and backwards"
LAG_S = 2.0
BLOCK_S = 4.0
MOST_HELD = 4000  # frames, however close together they are
COUNTS = 1e-3  # likely a manner is that counts

Estimate = tuple[Pose, Floats, Velocity]
T = TypeVar("T")


class Look(NamedTuple):
    """What a frame showed: when, of which robots, and of each its row of ``seen``, which is None of no robot."""

    exposed_ns: int
    robots: Sequence[str]
    seen: Seen | None


class Link(NamedTuple):
    """A ``robot`` in a frame: where its answer belongs, what was believed by then, how that came from the link before
    (None at the begin of a stretch), and what of its covariance ``stays`` (1, 6, 6).
    """

    robot: str
    answers: dict[str, Estimate]
    exposed_ns: int
    belief: Belief
    step: Step | None
    stays: Floats


@dataclass
class Held:
    """What waits for what comes after it: of every frame its time and its answers, of every robot its stretch."""

    frames: deque[tuple[int, dict[str, Estimate]]] = field(default_factory=deque)
    stretches: dict[str, list[Link]] = field(default_factory=dict)
    motions: dict[str, Motion] = field(default_factory=dict)

    def add(self, look: Look) -> None:
        """One more frame."""
        answers: dict[str, Estimate] = {}
        self.frames.append((look.exposed_ns, answers))
        if look.seen is None:
            return
        belief, steps = follow([self.motions.get(robot) for robot in look.robots], look.exposed_ns, look.seen)
        for k, robot in enumerate(look.robots):
            one = Belief(*(part[k : k + 1] for part in belief))
            self.motions[robot] = Motion(look.exposed_ns, look.seen.leds[k], *(part[k] for part in belief))
            if k not in steps:
                _tell(self.stretches.pop(robot, []))
            link = Link(robot, answers, look.exposed_ns, one, steps.get(k), look.seen.stays[k : k + 1])
            self.stretches.setdefault(robot, []).append(link)

    def take(self, until_ns: int | None) -> Iterator[dict[str, Estimate]]:
        """Go back over everything; the answers of frames before a time, which wait no longer, None for all."""
        for links in self.stretches.values():
            _tell(links)
            links[:] = [] if until_ns is None else [link for link in links if link.exposed_ns >= until_ns]
        self.stretches = {robot: links for robot, links in self.stretches.items() if links}
        while self.frames and (until_ns is None or self.frames[0][0] < until_ns):
            yield self.frames.popleft()[1]


def joined(looks: Iterable[Look]) -> Iterator[dict[str, Estimate]]:
    """Of every frame, in order, its robots' poses, covariances (6, 6) and velocities, by all that is around them."""
    held = Held()
    for look in looks:
        waits_s = (look.exposed_ns - held.frames[0][0]) * 1e-9 if held.frames else 0.0
        if not 0.0 <= waits_s < LAG_S + BLOCK_S or len(held.frames) >= MOST_HELD:
            in_order = waits_s >= 0.0 and len(held.frames) < MOST_HELD
            yield from held.take(look.exposed_ns - round(LAG_S * 1e9) if in_order else None)
        held.add(look)
    yield from held.take(None)


def smooth_both(frames: Iterable[tuple[T, FrameResult]], rig: Rig) -> Iterator[tuple[T, FrameResult]]:
    """Frames' results with their poses smoothed and labelled so, each with what came with it; some seconds later."""
    waiting: deque[tuple[T, FrameResult]] = deque()

    def looks() -> Iterator[Look]:
        for what, result in frames:
            waiting.append((what, result))
            robots = [robot for robot, answer in result.answers.items() if isinstance(answer, PoseEstimate)]
            yield Look(result.exposed_ns, robots, seen_in(result, rig) if robots else None)

    for told in joined(looks()):
        what, result = waiting.popleft()
        answers: dict[str, PoseEstimate | Lost] = dict(result.answers)
        for robot, estimate in told.items():
            seen = answers[robot]
            assert isinstance(seen, PoseEstimate)
            answers[robot] = smoothed(seen, *estimate, BOTH)
        yield what, replace(result, answers=answers)


def _tell(links: Sequence[Link]) -> None:
    """Write the answers of a stretch, from its end back."""
    later: Belief | None = None
    step: Step | None = None
    for link in reversed(links):
        later = link.belief if later is None or step is None else _before(link.belief, step, later)
        link.answers[link.robot] = estimates(later, link.stays)[0]
        step = link.step


def _before(belief: Belief, step: Step, later: Belief) -> Belief:
    """What is known of a robot (n = 1) in the frame before: ``belief`` by all up to it, ``step`` from there to the
    frame of which ``later`` is what is known by all frames.
    """
    some = np.flatnonzero(later.weights[0] > COUNTS)
    after, spread = later.states[:, some].copy(), later.covariances[:, some]
    after[..., 3:6] += step.shift[:, None]
    foreseen, by_state = moved_on(belief.states, step.turn, step.dt)
    noise = unforeseen(step.normals, step.speeds, step.dt)[:, some]
    noise[..., :6, :6] += step.wider[:, None]
    across = belief.covariances @ np.swapaxes(by_state, -1, -2)
    grown = by_state @ across
    joint = (changes(step.dt) * belief.weights[..., None])[..., some]
    led = _led(joint, after[:, None] - foreseen[:, :, None], grown[:, :, None] + noise[:, None])
    led = led * later.weights[:, None, some] + LEAST
    weights = led.sum(axis=2)
    shares = led / weights[..., None]
    states, covariances = mix(shares, after, spread)
    grown += (shares @ noise.reshape(1, len(some), 144)).reshape(grown.shape)
    gains = across @ np.linalg.inv(grown)
    states = belief.states + (gains @ (states - foreseen)[..., None])[..., 0]
    covariances = belief.covariances + gains @ (covariances - grown) @ np.swapaxes(gains, -1, -2)
    covariances = 0.5 * (covariances + np.swapaxes(covariances, -1, -2))
    return Belief(belief.rotations, states, covariances, weights / weights.sum())


def _led(joint: Floats, off: Floats, spreads: Floats) -> Floats:
    """How likely every manner (row) was before every one after (column), by how near it foresaw what is known."""
    halves = np.linalg.cholesky(spreads)
    away = np.linalg.solve(halves, off[..., None])[..., 0]
    volume = np.log(np.diagonal(halves, axis1=-2, axis2=-1)).sum(axis=-1)
    likely = np.log(np.maximum(joint, LEAST)) - 0.5 * np.sum(away * away, axis=-1) - volume
    led = np.exp(likely - likely.max(axis=1, keepdims=True))
    shares: Floats = led / led.sum(axis=1, keepdims=True)
    return shares
