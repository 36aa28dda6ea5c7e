"""libaravis, through ctypes: GigE Vision and USB3 Vision cameras of any maker, without a maker's software.

It is loaded when a camera is asked for. Calls let other threads run while they wait for the camera.
"""

import ctypes
from collections.abc import Callable
from ctypes import POINTER, byref, c_char_p, c_int, c_uint, c_uint32, c_void_p
from functools import cache
from typing import Any, NamedTuple

from asterism.protocol.errors import WorldError

LIBRARY = "libaravis-0.8.so.0"
GOBJECT = "libgobject-2.0.so.0"
GLIB = "libglib-2.0.so.0"
MISSING = "Aravis is not installed, which speaks to GenICam cameras: apt install libaravis-0.8-0"


class AravisError(Exception):
    """What Aravis, or the camera through it, said was wrong."""


class _GError(ctypes.Structure):
    _fields_ = (("domain", c_uint32), ("code", c_int), ("message", c_char_p))


class Listed(NamedTuple):
    """A camera that answers on the network or on USB."""

    id: str  # Aravis' own name for it
    vendor: str
    model: str
    serial: str
    address: str  # IP, or the place on the USB
    protocol: str  # GigEVision, USB3Vision


@cache
def _loaded(library: str) -> ctypes.CDLL:
    try:
        return ctypes.CDLL(library)
    except OSError:
        raise WorldError(MISSING) from None


@cache
def function(name: str, result: Any, *arguments: Any, library: str = LIBRARY) -> Callable[..., Any]:
    """A function of the library. Raises WorldError, with what to install, where the library is missing."""
    found = getattr(_loaded(library), name)
    # Of its own: one function may be asked for with other types elsewhere.
    prototype = ctypes.CFUNCTYPE(result, *arguments)
    address = ctypes.cast(found, c_void_p).value
    assert address is not None
    return prototype(address)


@cache
def checked(name: str, result: Any, *arguments: Any) -> Callable[..., Any]:
    """A function of the library whose last argument is a `GError**`: it raises AravisError instead."""
    plain = function(name, result, *arguments, POINTER(POINTER(_GError)))

    def call(*values: Any) -> Any:
        error = POINTER(_GError)()
        answer = plain(*values, byref(error))
        if not error:
            return answer
        told = (error.contents.message or b"").decode(errors="replace")
        function("g_error_free", None, c_void_p, library=GLIB)(ctypes.cast(error, c_void_p))
        raise AravisError(told)

    return call


def unref(pointer: int) -> None:
    """Let go of an object; of a camera or stream that does not answer this takes seconds."""
    function("g_object_unref", None, c_void_p, library=GOBJECT)(pointer)


def set_property(pointer: int, name: str, kind: Any, value: int) -> None:
    """Set a property of an object; ``kind`` is the value's C type."""
    # The function takes any number of arguments: those are passed in another way on some processors.
    setter = _loaded(GOBJECT).g_object_set
    setter.restype = None
    setter.argtypes = [c_void_p, c_char_p]
    setter(pointer, name.encode(), kind(value), c_void_p(None))


def listed() -> list[Listed]:
    """The cameras that answer within a second, sorted. Raises WorldError where the library is missing."""
    function("arv_update_device_list", None)()
    count = function("arv_get_n_devices", c_uint)()
    return sorted(one for one in map(_one, range(count)) if one.protocol in ("GigEVision", "USB3Vision"))


def _one(index: int) -> Listed:
    def text(what: str) -> str:
        told = function(f"arv_get_device_{what}", c_char_p, c_uint)(index)
        return (told or b"").decode(errors="replace")

    return Listed(text("id"), text("vendor"), text("model"), text("serial_nbr"), text("address"), text("protocol"))
