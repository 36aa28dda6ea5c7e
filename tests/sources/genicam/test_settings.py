"""What is set in a camera and what it tells of time, with a stand-in in the place of Aravis' camera."""

import threading
from typing import Any

import numpy as np
import pytest

from asterism.protocol.capture import Capture
from asterism.protocol.errors import InputError
from asterism.server.sources.genicam import offers
from asterism.server.sources.genicam.aravis import AravisError
from asterism.server.sources.genicam.aravis_camera import EXPOSURE, GAIN, RATE, Steps
from asterism.server.sources.genicam.aravis_stream import Raw
from asterism.server.sources.genicam.camera_stamps import Stamps
from asterism.server.sources.genicam.gvcp import taken_by, who_is
from asterism.server.sources.genicam.lost_frames import LostFrames
from asterism.server.sources.genicam.settings import apply_settings

SENSOR = (2448, 2048)


class StandIn:
    """A camera with a mind of its own: steps of 16 px, exposures in steps of 20 us, automatic everything."""

    def __init__(self, **features: Any) -> None:
        self.address, self.pointer = "", 0
        self.features = {"ExposureAuto": "Continuous", "GainAuto": "Continuous"} | features
        self.values = {EXPOSURE: 10_000.0, GAIN: 0.0, RATE: 75.0}
        self.limits = {EXPOSURE: (20.0, 1e6), GAIN: (0.0, 24.0), RATE: (1.0, 75.0)}
        self.at = (160, 96, 640, 480)
        self.format, self.source = "BayerRG8", ""
        self.entries: dict[str, list[str]] = {}
        self.done: list[str] = []

    def has(self, name: str) -> bool:
        return name in self.features

    def offers(self, name: str, entry: str) -> bool:
        return entry in self.entries.get(name, [])

    def whole(self, name: str) -> int:
        value = self.features[name]
        return value() if callable(value) else value

    def set_text(self, name: str, value: str) -> None:
        self.features[name] = value

    set_whole = set_flag = set_text

    def run(self, command: str) -> None:
        self.done.append(command)

    def can(self, what: str) -> bool:
        return what in self.limits

    def value(self, what: str) -> float:
        return self.values[what]

    def bounds(self, what: str) -> tuple[float, float]:
        return self.limits[what]

    def set_value(self, what: str, value: float) -> None:
        self.values[what] = round(value / 20) * 20.0 if what == EXPOSURE else value

    def steps(self, what: str) -> Steps:
        x, y, width, height = self.at
        most = {"width": SENSOR[0] - x, "height": SENSOR[1] - y}
        most |= {"x_offset": SENSOR[0] - width, "y_offset": SENSOR[1] - height}
        return Steps(0 if "offset" in what else 16, most[what], 16)

    def can_offset(self) -> bool:
        return True

    def region(self) -> tuple[int, int, int, int]:
        return self.at

    def set_region(self, *asked: int) -> None:
        self.at = tuple(before if value < 0 else value for before, value in zip(self.at, asked, strict=True))

    def close(self) -> None:
        self.done.append("close")

    def pixel_formats(self) -> list[str]:
        return ["BayerRG8", "Mono8", "Mono12p"]

    def pixel_format(self) -> str:
        return self.format

    def set_pixel_format(self, name: str) -> None:
        self.format = name

    def trigger_sources(self) -> list[str]:
        return ["Software", "Line1", "Line3", "Action1"]

    def set_trigger(self, source: str) -> None:
        if source == "Line3":
            raise AravisError("it is an output")
        self.source = source

    def clear_triggers(self) -> None:
        self.source = ""

    def is_gige(self) -> bool:
        return bool(self.address)

    def payload(self) -> int:
        return self.at[2] * self.at[3]

    def packet_size(self) -> int:
        return 1400


def apply(camera: StandIn, calibrated: tuple[int, int] | None = None, **capture: Any) -> tuple[Any, list[str]]:
    said: list[str] = []
    settings = Capture(**capture)
    return apply_settings(camera, settings, settings.size or calibrated, "cam", said.append), said  # type: ignore[arg-type]


def test_all_of_it_is_set_and_what_was_automatic_is_not_any_more() -> None:
    camera = StandIn()
    camera.source = "Line1"  # of whoever had it before
    applied, said = apply(
        camera, size=(1280, 1024), offset=(320, 160), exposure_us=500.0, gain=3.0, rate_hz=60.0, pixel_format="Mono12p"
    )
    assert camera.at == (320, 160, 1280, 1024)
    assert applied == (1280, 1024, "Mono12p", 500_000, 60.0, None)
    assert (camera.features["ExposureAuto"], camera.features["GainAuto"], camera.source) == ("Off", "Off", "")
    assert said == []


def test_the_cameras_own_offset_stays_where_it_can() -> None:
    camera = StandIn()
    apply(camera, (1280, 1024))
    assert camera.at == (160, 96, 1280, 1024)
    apply(camera, SENSOR)
    assert camera.at == (0, 0, *SENSOR)


def test_what_nobody_asked_for_stays_but_for_colour() -> None:
    """The chain reads grey."""
    camera = StandIn()
    applied, _ = apply(camera)
    assert camera.at == (160, 96, 640, 480)
    assert (camera.values[EXPOSURE], camera.features["ExposureAuto"]) == (10_000.0, "Continuous")
    assert applied.pixel_format == "Mono8"


def test_a_little_rounding_is_said() -> None:
    applied, said = apply(StandIn(), exposure_us=1_990.0)
    assert applied.exposure_ns == 2_000_000
    assert said == ["cam: capture.exposure_us 1990 is 2000 us in this camera"]


@pytest.mark.parametrize(
    ("capture", "words"),
    [
        (
            {"size": (1281, 1024)},
            r"^cam: capture.size \[1281, 1024\]: the camera's width is 16 to 2448 in steps of 16 px$",
        ),
        (
            {"size": (2048, 2048), "offset": (480, 0)},
            r"^cam: capture.offset \[480, 0\]: the camera's x is 0 to 400 in steps of 16 px with this size$",
        ),
        ({"exposure_us": 31.0}, "^cam: capture.exposure_us 31: the camera made 40 us of it$"),
        ({"rate_hz": 80.0}, "^cam: capture.rate 80: the camera accepts 1 to 75 Hz as it is set$"),
        ({"pixel_format": "BayerRG8"}, "BayerRG8: is no grey that can be read; it has Mono8, Mono12p$"),
        ({"trigger": "Line2"}, "Line2: is none of the camera's; it accepts free, software, action, Line1, Line3$"),
        ({"trigger": "Line3"}, r"Line3: the camera does not take it \(it is an output\)$"),
    ],
)
def test_every_refusal_is_a_sentence(capture: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        apply(StandIn(), **capture)


def test_binning_is_set_before_the_region_and_the_offset_is_of_the_sensor() -> None:
    camera = StandIn(BinningHorizontal=1, BinningVertical=1)
    applied, _ = apply(camera, binning=2, size=(640, 480), offset=(320, 192))
    assert (camera.features["BinningHorizontal"], camera.features["BinningVertical"]) == (2, 2)
    assert camera.at == (160, 96, 640, 480)
    assert (applied.width, applied.height) == (640, 480)


def test_a_camera_that_does_not_bin_is_not_taken_for_one_that_does() -> None:
    with pytest.raises(InputError, match=r"^cam: capture.binning 2: the camera has no such setting \(BinningHor"):
        apply(StandIn(), binning=2, size=(640, 480))
    apply(StandIn(), binning=1, size=(640, 480))
    with pytest.raises(InputError, match=r"^cam: capture.offset \[320, 161\]: expected multiples of the binning, 2$"):
        apply(StandIn(BinningHorizontal=1, BinningVertical=1), binning=2, size=(640, 480), offset=(320, 161))


def test_what_a_camera_gives_is_listed_with_what_is_not_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(offers, "ArvCamera", lambda *_: StandIn(WidthMax=SENSOR[0], HeightMax=SENSOR[1]))
    lines, problem = offers.offers_of("SN1", "")
    assert lines == ("Mono8 Mono12p: up to 2448x2048 at up to 75 Hz as it is set", "not read: BayerRG8")
    assert problem == ""


def test_a_camera_that_cannot_be_asked_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(offers, "taken_by", lambda _: "a program on 10.0.0.9")
    assert offers.offers_of("SN1", "10.0.0.2") == ((), "in use by a program on 10.0.0.9")

    def broken(*_: str) -> StandIn:
        raise AravisError("it does not answer")

    monkeypatch.setattr(offers, "ArvCamera", broken)
    assert offers.offers_of("SN1", "") == ((), "does not open (it does not answer)")


def test_the_calibrations_size_is_called_that() -> None:
    with pytest.raises(
        InputError, match=r"cam: the calibration's size \[4000, 1024\]: the camera's width is 16 to 2448"
    ):
        apply(StandIn(), (4000, 1024))


def test_a_setting_that_is_missing_is_refused_where_it_is_asked_for() -> None:
    camera = StandIn()
    del camera.limits[GAIN]
    with pytest.raises(InputError, match=r"cam: capture\.gain 2: the camera has no such setting"):
        apply(camera, gain=2.0)
    apply(camera)


@pytest.mark.parametrize(
    ("asked", "source", "waits"),
    [
        ("free", "", None),
        ("software", "Software", "software"),
        ("Line1", "Line1", "Line1"),
        ("action", "Action1", "action"),
    ],
)
def test_triggers(asked: str, source: str, waits: str | None) -> None:
    camera = StandIn(ActionDeviceKey=0, ActionGroupKey=0, ActionGroupMask=0)
    applied, _ = apply(camera, trigger=asked, rate_hz=60.0)
    assert (camera.source, applied.trigger, applied.rate_hz) == (source, waits, None if waits else 60.0)
    assert camera.features["ActionGroupKey"] == (1 if asked == "action" else 0)


def test_a_rate_beyond_the_link_is_refused_before_it_is_set() -> None:
    camera = StandIn(GevLinkSpeed=1000)
    camera.address = "127.0.0.1"
    camera.limits[RATE] = (1.0, 1000.0)
    words = "capture.rate 500: a frame has 0.31 MB, and the camera's link carries 119 MB/s: 386 Hz at most; a smaller"
    with pytest.raises(InputError, match=words):
        apply(camera, rate_hz=500.0)
    assert camera.values[RATE] == 75.0
    apply(camera, rate_hz=380.0)


def raw(stamp_ns: int) -> Raw:
    return Raw(0, 1, stamp_ns, 0, 1, 1, 0, 0, np.empty(0, np.uint8), 0)


def test_ptp_is_switched_on_and_a_camera_that_can_be_asked_is_asked() -> None:
    """In ticks, as the first version of GigE Vision has it: 8 ns each."""
    ticks = iter(range(125_000_000, 1_000_000_000, 1000))
    camera = StandIn(
        GevIEEE1588=False,
        GevTimestampTickFrequency=125_000_000,
        GevTimestampControlLatch=0,
        GevTimestampValue=lambda: next(ticks),
    )
    stamps = Stamps(camera)  # type: ignore[arg-type]
    assert camera.features["GevIEEE1588"] is True
    asked = stamps.ask()
    assert asked is not None
    assert 1_000_000_000 <= asked[0] < 1_000_100_000
    assert set(camera.done) == {"GevTimestampControlLatch"}
    assert stamps.of(raw(77)) == (77, None)
    assert Stamps(StandIn()).ask() is None  # type: ignore[arg-type]


def test_chunks_tell_the_stamp_and_the_exposure_of_their_own_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    from asterism.server.sources.genicam import camera_stamps

    told: dict[bytes, float] = {b"ChunkTimestamp": 125_000, b"ChunkExposureTime": 480.5}

    def read(_parser: int, _buffer: int, name: bytes) -> float:
        if name not in told:
            raise AravisError("no such chunk")
        return told[name]

    monkeypatch.setattr(camera_stamps, "function", lambda *_: lambda *_: 1)
    monkeypatch.setattr(camera_stamps, "checked", lambda *_: read)
    camera = StandIn(ChunkModeActive=False, GevTimestampTickFrequency=125_000_000)
    camera.entries["ChunkSelector"] = ["Image", "Timestamp", "ExposureTime"]
    stamps = Stamps(camera)  # type: ignore[arg-type]
    assert (camera.features["ChunkModeActive"], camera.features["ChunkEnable"]) == (True, True)
    assert stamps.of(raw(77)) == (1_000_000, 480_500)
    del told[b"ChunkTimestamp"]  # promised, but not in the frame: the frame's own is there
    assert stamps.of(raw(78)) == (78, None)
    assert stamps.of(raw(79)) == (79, None)


def test_lost_frames_are_said_once_a_minute_with_what_to_do() -> None:
    said: list[str] = []
    now = [0.0]
    lost = LostFrames("cam", said.append, lambda: now[0])
    for k in range(130):
        now[0] = float(k)
        lost.add(1, k % 2, 2 * k, 1400)
    assert len(said) == 3
    assert said[1].startswith(
        "cam: frames are lost: 61 came incomplete (120 packets missing) and 30 did not come; none of "
    )
    assert lost.incomplete == 130
    lost = LostFrames("usb", said.append, lambda: 0.0)
    lost.add(0, 1)
    assert said[-1].endswith("Give the camera a USB 3 port of its own, with a cable of 3 m or less, or a lower rate")


def test_where_nobody_answers_no_camera_is_found_and_nobody_waits_long() -> None:
    done = threading.Event()

    def ask() -> None:
        assert who_is("127.0.0.9") is None
        assert taken_by("127.0.0.9") is None
        done.set()

    threading.Thread(target=ask, daemon=True).start()
    assert done.wait(20.0)
