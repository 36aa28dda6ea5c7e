"""GigE Vision and USB3 Vision cameras as devices of a `Camera`."""

import contextlib
import threading
import time

from asterism.protocol.capture import SOFTWARE, Capture
from asterism.protocol.errors import InputError, WorldError
from asterism.protocol.messages import Clock
from asterism.protocol.rig import Rig
from asterism.server.sources.background import in_background
from asterism.server.sources.camera import Camera, Taken, Waiting
from asterism.server.sources.camera_clock import CameraClock
from asterism.server.sources.genicam.aravis import AravisError
from asterism.server.sources.genicam.aravis_camera import ArvCamera
from asterism.server.sources.genicam.aravis_stream import SUCCESS, ArvStream, Raw
from asterism.server.sources.genicam.camera_stamps import Stamps
from asterism.server.sources.genicam.frame_ids import missed_between
from asterism.server.sources.genicam.gvcp import sends_to, taken_by, who_is
from asterism.server.sources.genicam.listing import PREFIX, Place, find, find_again
from asterism.server.sources.genicam.lost_frames import LostFrames
from asterism.server.sources.genicam.pixel_formats import BY_NUMBER, unpacked
from asterism.server.sources.genicam.settings import Applied, apply_settings
from asterism.server.sources.source import Expected, Say

POP_S = 0.1
RETRY_S = 0.2  # while it is away
SILENT_S = 0.3  # without a frame, after which it is asked whether it is there
STUCK_S = 3.0  # a camera that runs by itself, is there, and delivers nothing for so long is opened anew
CLOSING_S = 1.0  # that letting go of a camera takes which answers
HELD_S = 3.5  # a camera is its program's after the last sign of life (GigE Vision's heartbeat: 3 s)
_LOOK_EVERY = 4  # times that it is not where it was, the whole network is asked
_PARTS = {"start": 0.5, "middle": 0.0, "end": -0.5}  # of the exposure, from the stamp to its middle


def genicam_camera(text: str, rig: Rig | None, say: Say) -> Camera:
    """The camera that ``text`` names, prefix and all. Raises as `GenicamCamera.open` does."""
    which = text.removeprefix(PREFIX)
    if not which:
        raise InputError(f"{text}: expected a camera's serial number, IP address or index behind it")
    expected = Expected(rig)
    return Camera(text, GenicamCamera(which, expected.capture, expected.size, say).open, rig, say, retry_s=RETRY_S)


class GenicamCamera:
    """A camera that is opened, and opened again where it was lost, with the same settings.

    ``text`` is what stands behind `genicam:`.
    """

    def __init__(self, text: str, capture: Capture, size: tuple[int, int] | None, say: Say) -> None:
        self.name = PREFIX + text
        self._text = text
        self._capture = capture
        self._size = size
        self._say = say
        self._place: Place | None = None
        self._device: GenicamDevice | None = None  # the last one
        self._away = 0

    def open(self) -> "GenicamDevice | None":
        """None while it is away. Raises WorldError where it is taken or Aravis is missing; InputError where there is
        none, or for settings that it refuses.
        """
        if self._device is not None:
            self._device.wait_until_free()
        if self._place is None:
            place = find(self._text)
        else:
            self._away += 1
            found = find_again(self._place, self._away % _LOOK_EVERY == 0)
            if found is None:
                return None
            place = found
        if place.address and (owner := self._owner(place.address)) is not None:
            raise self._taken_by(owner)
        try:
            return self._opened(place)
        except AravisError as problem:
            raise WorldError(f"{self.name}: the camera does not open ({problem})") from None

    def _taken_by(self, owner: str) -> WorldError:
        return WorldError(f"{self.name}: the camera is in use by {owner}; it serves one at a time")

    def _owner(self, address: str) -> str | None:
        """Which program has it. At the first start a little is waited for one that ended without a word."""
        owner = taken_by(address)
        if owner is None or self._place is not None:
            return owner
        time.sleep(HELD_S)  # some take every question for a sign of life
        return taken_by(address)

    def _opened(self, place: Place) -> "GenicamDevice":
        camera = ArvCamera(place.id, place.address)
        try:
            if not camera.is_ours():
                raise self._taken_by(camera.owner() or "another program")
            if camera.is_gige():
                with contextlib.suppress(AravisError):  # some cannot try; then what is set stays
                    camera.negotiate_packets()
            applied = apply_settings(camera, self._capture, self._size, self.name, self._say)
            device = GenicamDevice(camera, applied, self._capture, LostFrames(self.name, self._say))
        except BaseException:
            in_background(camera.close)
            raise
        self._place, self._away, self._device = place, 0, device
        return device


class GenicamDevice:
    """An open camera that delivers."""

    def __init__(self, camera: ArvCamera, applied: Applied, capture: Capture, lost: LostFrames) -> None:
        """Raises AravisError."""
        self._camera = camera
        self._applied = applied
        self._to_middle = _PARTS[capture.stamp]
        self._lost = lost
        self._trigger_every_s = 1.0 / capture.rate_hz if capture.rate_hz else 0.0
        self._trigger_due_s = self._newest_s = time.monotonic()
        self._started = self._pending = self._gone = False
        self._closing: threading.Thread | None = None
        self._id: int | None = None
        self._damaged = 0  # frames since the one of that number
        self._stamp_ns = self._mid_ns = 0
        self._packet_size = camera.packet_size() if camera.is_gige() else 0
        self._stamps = Stamps(camera)
        self._clock = CameraClock()
        self._stream = ArvStream(camera, camera.payload())

    def read(self) -> Taken | Waiting | None:
        """The next image, what came in its place, or nothing yet: in a fraction of a second. None when it is gone."""
        if not self._started and not self._start():
            return None
        if self._applied.trigger == SOFTWARE:
            self._fire()
        raw = self._stream.next(POP_S)
        if raw is not None:
            self._newest_s, self._pending = time.monotonic(), False
            return self._taken(raw)
        silent_s = time.monotonic() - self._newest_s
        if silent_s < SILENT_S:
            return Waiting()
        if not self._is_there():
            self._gone = True
            return None
        waits = self._applied.trigger
        if waits is None and silent_s > STUCK_S + 3.0 / (self._applied.rate_hz or 1.0):
            return None
        return Waiting(f"it waits for its trigger ({waits})" if waits and silent_s > STUCK_S else "")

    def _start(self) -> bool:
        """Not before somebody reads: Aravis would run out of memory for frames. False where the camera is gone."""
        try:
            self._clock = CameraClock(self._stamps.ask())
            self._camera.start()
        except AravisError:
            self._gone = True
            return False
        self._started, self._newest_s = True, time.monotonic()
        return True

    def close(self) -> None:
        """Let go of it, without waiting: Aravis takes seconds where the camera does not answer."""
        self._closing = in_background(self._close)

    def wait_until_free(self) -> None:
        """Until a camera that answers was let go of."""
        if self._closing is not None and not self._gone:
            self._closing.join(CLOSING_S)

    def _close(self) -> None:
        if not self._gone:
            with contextlib.suppress(AravisError):
                self._camera.stop()
        self._stamps.close()
        self._stream.close()
        self._camera.close()

    def _is_there(self) -> bool:
        """Asks without Aravis, which would wait for seconds."""
        address = self._camera.address
        if address:
            return who_is(address) is not None and sends_to(address, self._stream.port) and self._camera.is_ours()
        try:
            self._camera.register(0)
        except AravisError:
            return False
        return True

    def _fire(self) -> None:
        """The software's trigger, at the rate that was asked for, one frame after the other."""
        now_s = time.monotonic()
        if self._pending and now_s - self._newest_s < SILENT_S:
            return
        time.sleep(max(self._trigger_due_s - now_s, 0.0))
        self._trigger_due_s = max(self._trigger_due_s + self._trigger_every_s, time.monotonic())
        with contextlib.suppress(AravisError):  # a camera that is gone is found to be
            self._camera.trigger()
        self._pending = True

    def _taken(self, raw: Raw) -> Taken | Waiting:
        form = BY_NUMBER.get(raw.format)
        try:
            image = None if form is None else unpacked(raw.data, form, raw.width, raw.height, raw.padding)
        except ValueError:
            image = None
        if raw.status != SUCCESS or image is None or form is None:
            self._damaged += 1  # its number cannot be trusted: that comes in the frame's first packet
            self._say_lost(incomplete=1)
            return Waiting(unreadable=1)
        missed = max(missed_between(self._id, raw.frame_id) - self._damaged, 0)
        self._id, self._damaged = raw.frame_id, 0
        if missed:
            self._say_lost(missed=missed)
        if self._stream.is_short():
            image = image.copy()
        mid_ns = self._mid_exposure_ns(raw)
        clock = Clock.ARRIVAL if mid_ns is None else Clock.CAMERA
        return Taken(image, mid_ns, clock, form.bits, missed=missed)

    def _say_lost(self, incomplete: int = 0, missed: int = 0) -> None:
        packets = self._stream.missing_packets() if self._packet_size else 0
        self._lost.add(incomplete, missed, packets, self._packet_size)

    def _mid_exposure_ns(self, raw: Raw) -> int | None:
        """On the host's monotonic clock; None where the camera's does not run."""
        stamp = self._stamps.of(raw)
        before_ns, self._stamp_ns = self._stamp_ns, stamp.camera_ns
        if stamp.camera_ns in (0, before_ns):
            return None
        exposure_ns = self._applied.exposure_ns if stamp.exposure_ns is None else stamp.exposure_ns
        mid_ns = self._clock.host_ns(stamp.camera_ns, raw.began_ns) + round(self._to_middle * exposure_ns)
        # While the least delay is still being found, stamps come a little nearer: never back.
        self._mid_ns = max(mid_ns, self._mid_ns + 1)
        return self._mid_ns
