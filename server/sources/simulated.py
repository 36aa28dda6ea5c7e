"""Frames of the simulated camera."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from asterism.protocol.rig import Rig
from asterism.server.chain.frame import Frame
from asterism.server.sources.source import DEFAULT_RATE_HZ

if TYPE_CHECKING:
    from asterism.server.simulation.simulate import Look


class Simulated:
    """The simulated camera; ``count`` frames, or no end."""

    live = False

    def __init__(self, rig: Rig, seed: int = 0, count: int | None = None, look: "Look | None" = None) -> None:
        from asterism.server.simulation.simulate import Scene

        self.name = "sim"
        self.rate_hz = rig.capture.rate_hz or DEFAULT_RATE_HZ
        self.unreadable = 0
        self.length = count
        self._scene = Scene(rig, seed, look)

    def frames(self) -> Iterator[Frame]:
        """Frame after frame, rendered when asked for."""
        index = 0
        while self.length is None or index < self.length:
            exposed_ns = round(index * 1e9 / self.rate_hz)
            image = self._scene.render(index, self._scene.truth(index, index / self.rate_hz))
            yield Frame(image, exposed_ns, index, f"{index:06d}", exposed_ns)
            index += 1
