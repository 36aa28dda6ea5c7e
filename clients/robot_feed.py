"""What programs ask for: the poses of one robot, and those of all."""

from collections.abc import Callable, Collection, Iterable

from asterism.clients.feed import Feed
from asterism.clients.link_state import FRESH_S, Link, LinkState
from asterism.clients.received_pose import ReceivedPose


class RobotFeed(Feed):
    """One robot's poses, from whichever camera sees it. Made by `PoseClient`; safe to use from any thread."""

    def __init__(self, robot: str, link: Callable[[], Link], known: Callable[[], Collection[str]] = tuple) -> None:
        super().__init__()
        self.robot = robot
        self._link = link
        self._known = known  # the robots that there are, none while that is not known
        self._visible_by: set[str] = set()

    def latest(self, max_age_s: float) -> ReceivedPose | None:
        """The newest pose, or None when there is none of at most that age."""
        with self._changed:
            poses = [held.pose for held in self._held.values()]
        return min(_fresh(poses, max_age_s), key=lambda pose: pose.age_s, default=None)

    @property
    def visible(self) -> bool:
        """Whether a living server sees the robot at this moment."""
        return bool(self._visible_by) and self._link().state is not LinkState.SILENT

    @property
    def link(self) -> Link:
        """How things stand with the robot's pose: LIVE while there is one of the last 100 ms."""
        link = self._link()
        if link.state is not LinkState.LIVE or self.latest(FRESH_S) is not None:
            return link
        with self._changed:
            ages = [held.pose.age_s for held in self._held.values()]
        told = f"no pose for {min(ages):.1f} s" if ages else "no pose yet"
        if not ages and (known := self._known()) and self.robot not in known:
            told = f"no rig here has it, there are: {', '.join(known)}"
        if (event := self.event) is not None and event.lost:
            told += f" ({event.reason})"
        return Link(LinkState.NO_POSE, f"robot {self.robot!r}: {told}; {link.sentence}")

    def _show(self, key: str, is_visible: bool) -> None:
        (self._visible_by.add if is_visible else self._visible_by.discard)(key)


class AllRobots(Feed):
    """Every robot's poses, through one subscription. Iteration and callbacks give those of all as they come."""

    def latest(self, max_age_s: float) -> dict[str, ReceivedPose]:
        """The newest pose of every robot that has one of at most that age, by its id."""
        with self._changed:
            poses = [held.pose for held in self._held.values()]
        newest: dict[str, ReceivedPose] = {}
        for pose in _fresh(poses, max_age_s):
            if pose.robot not in newest or pose.age_s < newest[pose.robot].age_s:
                newest[pose.robot] = pose
        return newest


def _fresh(poses: Iterable[ReceivedPose], max_age_s: float) -> list[ReceivedPose]:
    return [pose for pose in poses if pose.age_s <= max_age_s]
