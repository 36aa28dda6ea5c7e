"""The kernel's side of V4L2: structures, requests and flags of <linux/videodev2.h>, as far as cameras need them.

Names and layouts are the header's, in the machine's own sizes; a test compares them with it.
"""

import ctypes
from ctypes import Structure, Union, c_int32, c_long, c_uint8, c_uint32, c_ulong

CAPTURE = 1  # V4L2_BUF_TYPE_VIDEO_CAPTURE
MMAP = 1  # V4L2_MEMORY_MMAP
ANY_FIELD = 0  # V4L2_FIELD_ANY
DISCRETE = 1  # of V4L2_FRMSIZE_TYPE_ and V4L2_FRMIVAL_TYPE_; 2 and 3 are ranges

CAP_CAPTURE, CAP_CAPTURE_PLANES = 0x1, 0x1000
CAP_MEM2MEM = 0x4000 | 0x8000
CAP_STREAMING, CAP_PER_NODE = 0x04000000, 0x80000000
CAP_TIMEPERFRAME = 0x1000

BUF_ERROR = 0x40
STAMP_MASK, STAMP_MONOTONIC = 0xE000, 0x2000
STAMP_AT_MASK, STAMP_AT_START = 0x70000, 0x10000

CONTROL_DISABLED, CONTROL_READ_ONLY = 0x1, 0x4
EXPOSURE_AUTO, EXPOSURE_ABSOLUTE, EXPOSURE_AUTO_PRIORITY = 0x9A0901, 0x9A0902, 0x9A0903
AUTOGAIN, GAIN, ANALOGUE_GAIN = 0x980912, 0x980913, 0x9E0903
EXPOSURE_MANUAL = 1  # of EXPOSURE_AUTO
EXPOSURE_UNIT_US = 100.0  # of EXPOSURE_ABSOLUTE


class Capability(Structure):
    """struct v4l2_capability: what a device node is."""

    _fields_ = (
        ("driver", c_uint8 * 16),
        ("card", c_uint8 * 32),
        ("bus_info", c_uint8 * 32),
        ("version", c_uint32),
        ("capabilities", c_uint32),
        ("device_caps", c_uint32),
        ("reserved", c_uint32 * 3),
    )


class FormatDescription(Structure):
    """struct v4l2_fmtdesc."""

    _fields_ = (
        ("index", c_uint32),
        ("type", c_uint32),
        ("flags", c_uint32),
        ("description", c_uint8 * 32),
        ("pixelformat", c_uint32),
        ("mbus_code", c_uint32),
        ("reserved", c_uint32 * 3),
    )


class SizeRange(Structure):
    """struct v4l2_frmsize_stepwise; of a discrete size, width and height are the first two."""

    _fields_ = (
        ("min_width", c_uint32),
        ("max_width", c_uint32),
        ("step_width", c_uint32),
        ("min_height", c_uint32),
        ("max_height", c_uint32),
        ("step_height", c_uint32),
    )


class FrameSize(Structure):
    """struct v4l2_frmsizeenum."""

    _fields_ = (
        ("index", c_uint32),
        ("pixel_format", c_uint32),
        ("type", c_uint32),
        ("stepwise", SizeRange),
        ("reserved", c_uint32 * 2),
    )


class Fraction(Structure):
    """struct v4l2_fract."""

    _fields_ = (("numerator", c_uint32), ("denominator", c_uint32))


class FrameInterval(Structure):
    """struct v4l2_frmivalenum; a discrete interval is the first of the three fractions, else least, most, step."""

    _fields_ = (
        ("index", c_uint32),
        ("pixel_format", c_uint32),
        ("width", c_uint32),
        ("height", c_uint32),
        ("type", c_uint32),
        ("stepwise", Fraction * 3),
        ("reserved", c_uint32 * 2),
    )


class PixelLayout(Structure):
    """struct v4l2_pix_format."""

    _fields_ = (
        ("width", c_uint32),
        ("height", c_uint32),
        ("pixelformat", c_uint32),
        ("field", c_uint32),
        ("bytesperline", c_uint32),
        ("sizeimage", c_uint32),
        ("rest", c_uint32 * 6),  # colours, which nobody here asks for
    )


class _FormatUnion(Union):
    # The header's union has members with pointers, which set where it begins.
    _fields_ = (("pix", PixelLayout), ("raw_data", c_uint8 * 200), ("pointer", ctypes.c_void_p))


class Format(Structure):
    """struct v4l2_format."""

    _fields_ = (("type", c_uint32), ("fmt", _FormatUnion))


class CaptureParameters(Structure):
    """struct v4l2_captureparm."""

    _fields_ = (
        ("capability", c_uint32),
        ("capturemode", c_uint32),
        ("timeperframe", Fraction),
        ("extendedmode", c_uint32),
        ("readbuffers", c_uint32),
        ("reserved", c_uint32 * 4),
    )


class _ParameterUnion(Union):
    _fields_ = (("capture", CaptureParameters), ("raw_data", c_uint8 * 200))


class StreamParameters(Structure):
    """struct v4l2_streamparm."""

    _fields_ = (("type", c_uint32), ("parm", _ParameterUnion))


class Control(Structure):
    """struct v4l2_control."""

    _fields_ = (("id", c_uint32), ("value", c_int32))


class ControlQuery(Structure):
    """struct v4l2_queryctrl."""

    _fields_ = (
        ("id", c_uint32),
        ("type", c_uint32),
        ("name", c_uint8 * 32),
        ("minimum", c_int32),
        ("maximum", c_int32),
        ("step", c_int32),
        ("default_value", c_int32),
        ("flags", c_uint32),
        ("reserved", c_uint32 * 2),
    )


class BufferRequest(Structure):
    """struct v4l2_requestbuffers."""

    _fields_ = (
        ("count", c_uint32),
        ("type", c_uint32),
        ("memory", c_uint32),
        ("capabilities", c_uint32),
        ("flags", c_uint8),
        ("reserved", c_uint8 * 3),
    )


class _Place(Union):
    _fields_ = (("offset", c_uint32), ("userptr", c_ulong))


class Buffer(Structure):
    """struct v4l2_buffer."""

    _fields_ = (
        ("index", c_uint32),
        ("type", c_uint32),
        ("bytesused", c_uint32),
        ("flags", c_uint32),
        ("field", c_uint32),
        ("seconds", c_long),  # timestamp
        ("microseconds", c_long),
        ("timecode", c_uint32 * 4),
        ("sequence", c_uint32),
        ("memory", c_uint32),
        ("m", _Place),
        ("length", c_uint32),
        ("reserved2", c_uint32),
        ("reserved", c_uint32),
    )


def _request(direction: int, number: int, kind: type) -> int:
    """_IOC of <asm-generic/ioctl.h>: 1 writes to the kernel, 2 reads from it."""
    return direction << 30 | ctypes.sizeof(kind) << 16 | ord("V") << 8 | number


QUERYCAP = _request(2, 0, Capability)
ENUM_FMT = _request(3, 2, FormatDescription)
G_FMT = _request(3, 4, Format)
S_FMT = _request(3, 5, Format)
REQBUFS = _request(3, 8, BufferRequest)
QUERYBUF = _request(3, 9, Buffer)
QBUF = _request(3, 15, Buffer)
DQBUF = _request(3, 17, Buffer)
STREAMON = _request(1, 18, c_int32)
STREAMOFF = _request(1, 19, c_int32)
G_PARM = _request(3, 21, StreamParameters)
S_PARM = _request(3, 22, StreamParameters)
G_CTRL = _request(3, 27, Control)
S_CTRL = _request(3, 28, Control)
QUERYCTRL = _request(3, 36, ControlQuery)
ENUM_FRAMESIZES = _request(3, 74, FrameSize)
ENUM_FRAMEINTERVALS = _request(3, 75, FrameInterval)


def fourcc(text: str) -> int:
    """The number of a pixel format by its name of up to four letters: `Y16` is `Y16 `."""
    return int.from_bytes(text.ljust(4).encode("ascii"), "little")


def fourcc_name(number: int) -> str:
    """And back, without the blanks; the top bit (big-endian pixels) shows as `-BE`, as the kernel writes it."""
    letters = (number & 0x7FFFFFFF).to_bytes(4, "little").decode("latin-1").rstrip()
    return letters + ("-BE" if number >> 31 else "")


def text(field: "ctypes.Array[c_uint8]") -> str:
    """The text in an array of bytes that ends with a zero."""
    return bytes(field).partition(b"\0")[0].decode("utf-8", "replace")
