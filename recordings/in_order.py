"""Messages of the network in the order in which their server records them: each kind has a queue of its own."""

from collections.abc import Callable

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.messages import FRAME_REPORT, ODOMETRY, STATUS
from asterism.recordings.from_network import Arrived

LATE_S = 0.5  # so long a frame's report is waited for


class InOrder:
    """Holds poses and events until their frame's report is there. Pure: times are this machine's, s."""

    def __init__(self) -> None:
        self._held: list[tuple[float, Arrived]] = []
        self._newest = -1  # number of the newest frame's report

    def add(self, arrived: Arrived, now_s: float) -> list[Arrived]:
        """What can be written now that this one has arrived: poses, then the report of their frame, then its events; an
        event of another rig before the poses.
        """
        kind, number = arrived.message.kind, arrived.message.sequence
        if kind is FRAME_REPORT:
            self._newest = number
            due = self._take(lambda _, held: held.message.sequence <= number)
            before = [held for held in due if _comes_first(held)]
            return [*before, arrived, *(held for held in due if not _comes_first(held))]
        if kind is STATUS or number <= self._newest:
            return [arrived]
        self._held.append((now_s, arrived))
        return self._take(lambda since_s, _: now_s - since_s > LATE_S)

    def rest(self) -> list[Arrived]:
        """All that is still held."""
        return self._take(lambda *_: True)

    def _take(self, is_due: Callable[[float, Arrived], bool]) -> list[Arrived]:
        due = [held for since_s, held in self._held if is_due(since_s, held)]
        self._held = [entry for entry in self._held if not is_due(*entry)]
        return due


def _comes_first(held: Arrived) -> bool:
    told = held.told
    return held.message.kind is ODOMETRY or (isinstance(told, pb.Event) and not told.robot)
