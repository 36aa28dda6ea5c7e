"""`asterism cameras`: what there is, by the name to use, in the terminal's width; where nothing is, where it looked."""

import errno

import pytest

from asterism.server.command import cameras
from asterism.server.sources import listing
from asterism.server.sources.genicam import listing as genicam_listing
from asterism.server.sources.listing import Found, v4l2_cameras
from asterism.server.sources.v4l2 import abi as v4l2_abi
from tests.sources.v4l2.stand_in import StandInCamera, StandInSystem

VGA, HD, FULL = (640, 480), (1280, 720), (1920, 1080)
WEBCAM = StandInCamera(
    card="HD Pro Webcam C920",
    formats={
        "YUYV": {VGA: [30.0, 24.0], (800, 448): [30.0], HD: [10.0, 5.0], FULL: [5.0]},
        "MJPG": {VGA: [30.0], HD: [30.0], FULL: [30.0]},
        "H264": {FULL: [30.0]},
    },
)
METADATA = StandInCamera(capabilities=0x00800000 | v4l2_abi.CAP_STREAMING)


def test_every_camera_is_told_with_formats_sizes_and_rates() -> None:
    ranged = StandInCamera(
        card="Sensor", formats={name: {(1280, 1024): [120.0]} for name in ("Y10", "Y12")}, span=(8, 1280, 8, 8, 1024, 2)
    )
    locked = StandInCamera(open_errno=errno.EACCES)
    system = StandInSystem(video0=WEBCAM, video1=METADATA, video2=ranged, video4=locked)
    assert v4l2_cameras(system) == [
        Found(
            "/dev/video0",
            "HD Pro Webcam C920, V4L2, /dev/video0",
            (
                "YUYV: 800x448 640x480 at up to 30 Hz; 1280x720 at up to 10 Hz; 1920x1080 at up to 5 Hz",
                "MJPG: 1920x1080 1280x720 640x480 at up to 30 Hz",
                "not read: H264",
            ),
        ),
        Found("/dev/video2", "Sensor, V4L2, /dev/video2", ("Y10 Y12: 8x8 to 1280x1024 at up to 120 Hz",)),
        Found(
            "/dev/video4",
            "V4L2, /dev/video4",
            problem="no permission for /dev/video4; as root: usermod -aG video USER, then log in anew",
        ),
    ]
    assert not system.opened


def test_it_fits_the_terminal_but_never_breaks_a_name() -> None:
    name = "/dev/v4l/by-id/usb-046d_HD_Pro_Webcam_C920_0123456789ABCDEF0123456789ABCDEF-video-index0"
    found = v4l2_cameras(StandInSystem(video0=WEBCAM))[0]._replace(name=name)
    lines = cameras.told([found], [], "", 80)
    assert lines[0] == name
    assert all(len(line) <= 80 for line in lines if name not in line)
    assert any(name in line and "serve rig.yaml" in line for line in lines)
    assert "no GenICam camera" in "\n".join(lines)


def test_where_there_is_none_it_says_where_it_looked_and_succeeds(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(listing.KERNEL, "nodes", list)
    monkeypatch.setattr(cameras, "genicam_cameras", lambda: ([], "libaravis is not installed"))
    from asterism.server.__main__ import main

    assert main(["cameras"]) == 0
    told = capsys.readouterr().out
    assert "no V4L2 camera: there is no /dev/video* that gives images" in told
    assert "no GenICam camera: libaravis is not installed" in told
    assert all(len(line) <= 80 for line in told.splitlines())


def test_genicam_cameras_are_told_with_their_names(monkeypatch: pytest.MonkeyPatch) -> None:
    place = genicam_listing.Place("Maker-SN1", "10.0.0.2", "SN1")
    camera = genicam_listing.FoundCamera("genicam:SN1", "Maker", "Model", "SN1", place)
    monkeypatch.setattr(listing, "offers_of", lambda which, address: ((f"Mono8 of {which} at {address}",), ""))
    monkeypatch.setattr(listing, "list_genicam", lambda: genicam_listing.Found([camera]))
    found, problem = listing.genicam_cameras()
    what, gives = "Maker Model, serial SN1, 10.0.0.2, GenICam", "Mono8 of Maker-SN1 at 10.0.0.2"
    assert found == [Found("genicam:SN1", what, (gives,))]
    assert cameras.told([], found, problem, 80)[:3] == ["genicam:SN1", f"  {what}", f"  {gives}"]


def test_a_camera_that_cannot_be_used_is_none_to_serve() -> None:
    broken = Found("/dev/video0", "V4L2, /dev/video0", problem="another program has it")
    genicam = Found("genicam:SN1", "Maker Model, serial SN1, 10.0.0.2, GenICam")
    assert "serve rig.yaml" not in "\n".join(cameras.told([broken], [], "", 80))
    assert cameras.told([broken], [genicam], "", 80)[-1].endswith("serve rig.yaml genicam:SN1")
