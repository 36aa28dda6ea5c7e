"""What we tell the kernel is what its own header says, by a C compiler."""

import ctypes
import shutil
import subprocess
from pathlib import Path

import pytest

from asterism.server.sources.v4l2 import abi

HEADER = Path("/usr/include/linux/videodev2.h")
STRUCTURES = {
    "v4l2_capability": (abi.Capability, {"device_caps": "device_caps"}),
    "v4l2_fmtdesc": (abi.FormatDescription, {"pixelformat": "pixelformat"}),
    "v4l2_frmsizeenum": (
        abi.FrameSize,
        {"type": "type", "discrete.width": "stepwise", "stepwise": "stepwise", "reserved": "reserved"},
    ),
    "v4l2_frmsize_discrete": (abi.Fraction, {"height": "denominator"}),
    "v4l2_frmsize_stepwise": (
        abi.SizeRange,
        {"max_width": "max_width", "min_height": "min_height", "step_height": "step_height"},
    ),
    "v4l2_frmivalenum": (
        abi.FrameInterval,
        {"width": "width", "discrete": "stepwise", "stepwise": "stepwise", "reserved": "reserved"},
    ),
    "v4l2_format": (abi.Format, {"fmt": "fmt"}),
    "v4l2_pix_format": (abi.PixelLayout, {"bytesperline": "bytesperline", "sizeimage": "sizeimage"}),
    "v4l2_streamparm": (abi.StreamParameters, {"parm": "parm"}),
    "v4l2_captureparm": (abi.CaptureParameters, {"timeperframe": "timeperframe"}),
    "v4l2_control": (abi.Control, {"value": "value"}),
    "v4l2_queryctrl": (abi.ControlQuery, {"minimum": "minimum", "step": "step", "flags": "flags"}),
    "v4l2_requestbuffers": (abi.BufferRequest, {"memory": "memory"}),
    "v4l2_buffer": (
        abi.Buffer,
        {
            "bytesused": "bytesused",
            "flags": "flags",
            "timestamp.tv_sec": "seconds",
            "timestamp.tv_usec": "microseconds",
            "sequence": "sequence",
            "memory": "memory",
            "m.offset": "m",
            "length": "length",
        },
    ),
}
REQUESTS = (
    *("QUERYCAP", "ENUM_FMT", "ENUM_FRAMESIZES", "ENUM_FRAMEINTERVALS", "G_FMT", "S_FMT", "G_PARM", "S_PARM"),
    *("QUERYCTRL", "G_CTRL", "S_CTRL", "REQBUFS", "QUERYBUF", "QBUF", "DQBUF", "STREAMON", "STREAMOFF"),
)
NUMBERS = {
    **{f"VIDIOC_{name}": getattr(abi, name) for name in REQUESTS},
    "V4L2_BUF_TYPE_VIDEO_CAPTURE": abi.CAPTURE,
    "V4L2_MEMORY_MMAP": abi.MMAP,
    "V4L2_FIELD_ANY": abi.ANY_FIELD,
    "V4L2_FRMSIZE_TYPE_DISCRETE": abi.DISCRETE,
    "V4L2_FRMIVAL_TYPE_DISCRETE": abi.DISCRETE,
    "V4L2_CAP_VIDEO_CAPTURE": abi.CAP_CAPTURE,
    "V4L2_CAP_VIDEO_CAPTURE_MPLANE": abi.CAP_CAPTURE_PLANES,
    "V4L2_CAP_VIDEO_M2M | V4L2_CAP_VIDEO_M2M_MPLANE": abi.CAP_MEM2MEM,
    "V4L2_CAP_STREAMING": abi.CAP_STREAMING,
    "V4L2_CAP_DEVICE_CAPS": abi.CAP_PER_NODE,
    "V4L2_CAP_TIMEPERFRAME": abi.CAP_TIMEPERFRAME,
    "V4L2_BUF_FLAG_ERROR": abi.BUF_ERROR,
    "V4L2_BUF_FLAG_TIMESTAMP_MASK": abi.STAMP_MASK,
    "V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC": abi.STAMP_MONOTONIC,
    "V4L2_BUF_FLAG_TSTAMP_SRC_MASK": abi.STAMP_AT_MASK,
    "V4L2_BUF_FLAG_TSTAMP_SRC_SOE": abi.STAMP_AT_START,
    "V4L2_CTRL_FLAG_DISABLED": abi.CONTROL_DISABLED,
    "V4L2_CTRL_FLAG_READ_ONLY": abi.CONTROL_READ_ONLY,
    "V4L2_CID_EXPOSURE_AUTO": abi.EXPOSURE_AUTO,
    "V4L2_CID_EXPOSURE_ABSOLUTE": abi.EXPOSURE_ABSOLUTE,
    "V4L2_CID_EXPOSURE_AUTO_PRIORITY": abi.EXPOSURE_AUTO_PRIORITY,
    "V4L2_EXPOSURE_MANUAL": abi.EXPOSURE_MANUAL,
    "V4L2_CID_AUTOGAIN": abi.AUTOGAIN,
    "V4L2_CID_GAIN": abi.GAIN,
    "V4L2_CID_ANALOGUE_GAIN": abi.ANALOGUE_GAIN,
    "V4L2_PIX_FMT_GREY": abi.fourcc("GREY"),
    "V4L2_PIX_FMT_Y10": abi.fourcc("Y10"),
    "V4L2_PIX_FMT_Y12": abi.fourcc("Y12"),
    "V4L2_PIX_FMT_Y14": abi.fourcc("Y14"),
    "V4L2_PIX_FMT_Y16": abi.fourcc("Y16"),
    "V4L2_PIX_FMT_YUYV": abi.fourcc("YUYV"),
    "V4L2_PIX_FMT_UYVY": abi.fourcc("UYVY"),
    "V4L2_PIX_FMT_NV12": abi.fourcc("NV12"),
    "V4L2_PIX_FMT_MJPEG": abi.fourcc("MJPG"),
}


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> dict[str, int]:
    """What the header says of everything above."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None or not HEADER.exists():
        pytest.skip("needs a C compiler and <linux/videodev2.h> (linux-libc-dev)")
    asked = [*NUMBERS]
    for name, (_, fields) in STRUCTURES.items():
        asked.append(f"sizeof(struct {name})")
        asked += [f"offsetof(struct {name}, {field})" for field in fields]
    lines = "".join(f'printf("%llu\\n", (unsigned long long)(unsigned int)({text}));' for text in asked)
    folder = tmp_path_factory.mktemp("header")
    (folder / "ask.c").write_text(
        "#include <linux/videodev2.h>\n#include <stddef.h>\n#include <stdio.h>\n"
        f"int main(void) {{ {lines} return 0; }}\n"
    )
    subprocess.run([compiler, "-o", str(folder / "ask"), str(folder / "ask.c")], check=True)
    answers = subprocess.run([str(folder / "ask")], check=True, capture_output=True, text=True).stdout.split()
    return dict(zip(asked, map(int, answers), strict=True))


def test_requests_flags_and_controls_have_the_headers_numbers(told: dict[str, int]) -> None:
    assert {name: told[name] for name in NUMBERS} == NUMBERS


@pytest.mark.parametrize("name", STRUCTURES)
def test_structures_lie_in_memory_as_the_headers_do(told: dict[str, int], name: str) -> None:
    kind, fields = STRUCTURES[name]
    assert ctypes.sizeof(kind) == told[f"sizeof(struct {name})"]
    for theirs, ours in fields.items():
        assert getattr(kind, ours).offset == told[f"offsetof(struct {name}, {theirs})"], theirs


def test_pixel_formats_go_by_their_names_without_blanks() -> None:
    for name in ("GREY", "Y16", "MJPG"):
        assert abi.fourcc_name(abi.fourcc(name)) == name
    assert abi.fourcc_name(abi.fourcc("Y16") | 1 << 31) == "Y16-BE"
