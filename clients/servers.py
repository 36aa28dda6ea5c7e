"""All servers that a client has heard of, by camera."""

import threading

from asterism.clients.link_state import Link, LinkState, best
from asterism.clients.server_state import ServerState

MOST_CAMERAS = 32  # the one heard of longest ago is forgotten


class Servers:
    """Safe to use from any thread. ``wanted`` is set where somebody waits for a server's clock."""

    def __init__(self, endpoint: str) -> None:
        self.wanted = threading.Event()
        self._endpoint = endpoint
        self._lock = threading.Lock()
        self._states: dict[str, ServerState] = {}

    def __getitem__(self, camera: str) -> ServerState:
        with self._lock:
            state = self._states.pop(camera, None) or ServerState(camera, self.wanted)
            self._states[camera] = state
            if len(self._states) > MOST_CAMERAS:
                del self._states[next(iter(self._states))]
            return state

    def all(self) -> list[ServerState]:
        """Every one."""
        with self._lock:
            return list(self._states.values())

    def robots(self) -> list[str]:
        """Those of all rigs, sorted; none while a server has not told its rig."""
        told = [state.points.keys() for state in self.all()]
        return sorted(set().union(*told)) if all(told) else []

    def links(self, now_ns: int) -> dict[str, Link]:
        """How things stand with each, by camera."""
        return {state.camera: state.link(now_ns) for state in self.all()}

    def link(self, now_ns: int) -> Link:
        """How things stand with the one that serves best."""
        links = list(self.links(now_ns).values())
        return best(links) if links else Link(LinkState.WAITING, f"no server at {self._endpoint} has been found yet")
