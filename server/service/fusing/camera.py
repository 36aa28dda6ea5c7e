"""What is known of one camera that is heard: its session, its rig, why it is not taken."""

from collections.abc import Sequence
from dataclasses import dataclass

from asterism.server.fusing.fleet import View
from asterism.server.service.fusing.answer import Answer, Texts

SECOND_NS = 1_000_000_000
QUIET_NS = SECOND_NS // 4  # after so long without a report of its session another one takes its place
RIVAL_NS = 2 * SECOND_NS  # a second camera of the name is gone when it was not heard for so long
ASK_AGAIN_NS = 10 * SECOND_NS  # also where nobody told of another rig
SOON_NS = SECOND_NS // 2  # while one is waited for
SILENT_NS = SECOND_NS
LEAST_APART_NS = 200_000  # no camera has more than 5000 frames a second
UNTOLD_NS = 3 * SECOND_NS  # without an answer for its rig that is said


@dataclass(slots=True)
class _Other:
    """Another session under the same name: when it was heard first and last, and who serves it."""

    first_ns: int
    last_ns: int
    who: str = "another server"


class HeardCamera:
    """One camera, by its name. One thread feeds it; times are of the monotonic clock, ns."""

    def __init__(self, name: str, ear: int, now_ns: int) -> None:
        self.name = name
        self.ear = ear
        self.view: View | None = None
        self.texts: Texts = ()  # of its rig, as it is taken
        self.session = 0  # whose reports are taken; 0 before there is one
        self.problem = ""  # why it is not taken
        self.alive = True
        self.heard_ns = now_ns  # the newest report of its session
        self._newest_ns = -LEAST_APART_NS  # exposure
        self._others: dict[int, _Other] = {}
        self._who = "a server"
        self._wanted_ns: int | None = now_ns  # since when its rig is waited for
        self._asked_ns = now_ns - ASK_AGAIN_NS
        self._rig_from: int | None = None  # the frame from which on another one is in force, that is not here yet

    def takes(self, session: int, sequence: int, exposed_ns: int, now_ns: int) -> bool:
        """Whether a report is one to go by: of the session in force, newer than all before, by the rig that is here."""
        if session != self.session and not self._changes_to(session, now_ns):
            return False
        self.heard_ns, self.alive = now_ns, True
        if exposed_ns < self._newest_ns + LEAST_APART_NS:  # heard through another connection already
            return False
        self._newest_ns = exposed_ns
        if self.view is None or (self._rig_from is None and self._wanted_ns is not None):
            return False
        return self._rig_from is None or sequence < self._rig_from

    def _changes_to(self, session: int, now_ns: int) -> bool:
        """Whether another session takes the place of that in force, because nothing comes of that any more."""
        if self.session:
            other = self._others.setdefault(session, _Other(now_ns, now_ns))
            other.last_ns = now_ns
            if now_ns - self.heard_ns < QUIET_NS:
                return False
        self.session, self._newest_ns = session, -LEAST_APART_NS
        self._others.clear()
        self.want(now_ns)
        return True

    def want(self, now_ns: int, from_sequence: int | None = None) -> None:
        """Its rig is to be asked for; that of before, if there is one, holds up to that frame."""
        self._wanted_ns, self._rig_from = now_ns, from_sequence
        self._asked_ns = now_ns - ASK_AGAIN_NS

    def asks(self, now_ns: int) -> bool:
        """Whether it is to be asked for its rig now."""
        soon = self._wanted_ns is not None and self.alive
        if now_ns - self._asked_ns < (SOON_NS if soon else ASK_AGAIN_NS):
            return False
        self._asked_ns = now_ns
        return True

    def answered(self, answers: Sequence[Answer]) -> Answer | None:
        """The answer that is this camera's, of those that came; None where nothing follows from it."""
        for answer in answers:
            if answer.session in self._others:
                self._others[answer.session].who = answer.who
        mine = next((one for one in answers if one.session == self.session), None)
        if mine is None:
            return None
        self._who, self._wanted_ns, self._rig_from = mine.who, None, None
        return mine if mine.view is not None or mine.problem else None

    def problems(self, now_ns: int) -> list[str]:
        """What is wrong with it now, in sentences."""
        told = [self.problem] if self.problem else []
        silent_s = (now_ns - self.heard_ns) / SECOND_NS
        if not self.alive:
            told.append(f"camera '{self.name}' is gone, for {silent_s:.0f} s")
        elif now_ns - self.heard_ns > SILENT_NS:
            told.append(f"camera '{self.name}' tells of no frames, for {silent_s:.0f} s")
        elif self._wanted_ns is not None and now_ns - self._wanted_ns > UNTOLD_NS:
            told.append(f"camera '{self.name}' does not tell its rig; without one nothing of it can be joined")
        return told

    def rivals(self, now_ns: int) -> list[str]:
        """Other cameras that are heard under its name, in sentences."""
        others = list(self._others.items())  # another thread may add one
        self._others = {one: other for one, other in others if now_ns - other.last_ns < RIVAL_NS}
        return [
            f"two cameras are called '{self.name}': that of {self._who} was heard first and is taken, that of "
            f"{other.who} is not: give one of them another camera_name"
            for _, other in others
            if now_ns - other.last_ns < RIVAL_NS and min(self.heard_ns, other.last_ns) - other.first_ns > SILENT_NS
        ]
