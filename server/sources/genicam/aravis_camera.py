"""A camera as Aravis has it: its features by name, and what Aravis knows how to set whatever the camera calls it."""

from collections.abc import Callable
from ctypes import POINTER, byref, c_char_p, c_double, c_int, c_int64, c_uint, c_uint32, c_void_p
from ctypes import cast as c_cast
from typing import Any, NamedTuple

from asterism.server.sources.genicam.aravis import GLIB, AravisError, checked, function, unref

# What Aravis finds under its names of all generations.
EXPOSURE, GAIN, RATE = "exposure_time", "gain", "frame_rate"
_NO_PACKET_SOCKET = 1  # ARV_GV_STREAM_OPTION_PACKET_SOCKET_DISABLED
_OWNER_REGISTER = 0x0A14  # GigE Vision 2.0: address of the primary application


class Steps(NamedTuple):
    """What a whole number may be: from, to, in steps of."""

    least: int
    most: int
    step: int


class ArvCamera:
    """An open camera. All methods raise AravisError for what the camera refuses."""

    def __init__(self, which: str, address: str = "") -> None:
        """``which`` is an IP address or the id that `listed` gives, ``address`` the IP of a GigE Vision camera."""
        self.address = address
        self.pointer: int = checked("arv_camera_new", c_void_p, c_char_p)(which.encode())

    def close(self) -> None:
        """Let go of it; of a camera that does not answer this takes seconds."""
        unref(self.pointer)

    # Features by their names

    def has(self, feature: str) -> bool:
        """Whether it can be used now."""
        try:
            return bool(self._call("is_feature_available", c_int, c_char_p)(feature.encode()))
        except AravisError:
            return False

    def offers(self, feature: str, entry: str) -> bool:
        """Whether an enumeration has that entry."""
        return self.has(feature) and entry in self._names(
            self._call("dup_available_enumerations_as_strings", c_void_p, c_char_p, POINTER(c_uint)), feature.encode()
        )

    def text(self, feature: str) -> str:
        """Its value."""
        return bytes(self._call("get_string", c_char_p, c_char_p)(feature.encode()) or b"").decode(errors="replace")

    def set_text(self, feature: str, value: str) -> None:
        """Also of an enumeration."""
        self._call("set_string", None, c_char_p, c_char_p)(feature.encode(), value.encode())

    def whole(self, feature: str) -> int:
        """Its value."""
        return int(self._call("get_integer", c_int64, c_char_p)(feature.encode()))

    def set_whole(self, feature: str, value: int) -> None:
        """Set it."""
        self._call("set_integer", None, c_char_p, c_int64)(feature.encode(), value)

    def set_flag(self, feature: str, value: bool) -> None:
        """Set it."""
        self._call("set_boolean", None, c_char_p, c_int)(feature.encode(), value)

    def run(self, command: str) -> None:
        """Execute it."""
        self._call("execute_command", None, c_char_p)(command.encode())

    # What has another name in every generation

    def can(self, what: str) -> bool:
        """Whether EXPOSURE, GAIN or RATE can be set."""
        return bool(self._call(f"is_{what}_available", c_int)())

    def value(self, what: str) -> float:
        """EXPOSURE in us, GAIN in the camera's unit, or RATE in Hz."""
        return float(self._call(f"get_{what}", c_double)())

    def bounds(self, what: str) -> tuple[float, float]:
        """Least and most that the camera takes, as it is set now."""
        least, most = c_double(), c_double()
        self._call(f"get_{what}_bounds", None, POINTER(c_double), POINTER(c_double))(byref(least), byref(most))
        return least.value, most.value

    def set_value(self, what: str, value: float) -> None:
        """Set it."""
        self._call(f"set_{what}", None, c_double)(value)

    def steps(self, what: str) -> Steps:
        """What `width`, `height`, `x_offset` or `y_offset` may be, as the camera is set now."""
        least, most = c_int(), c_int()
        self._call(f"get_{what}_bounds", None, POINTER(c_int), POINTER(c_int))(byref(least), byref(most))
        return Steps(least.value, most.value, max(int(self._call(f"get_{what}_increment", c_int)()), 1))

    def can_offset(self) -> bool:
        """Whether the image can begin elsewhere on the sensor."""
        return bool(self._call("is_region_offset_available", c_int)())

    def region(self) -> tuple[int, int, int, int]:
        """x, y, width, height, px."""
        found = [c_int() for _ in range(4)]
        self._call("get_region", None, *[POINTER(c_int)] * 4)(*map(byref, found))
        x, y, width, height = (one.value for one in found)
        return x, y, width, height

    def set_region(self, x: int, y: int, width: int, height: int) -> None:
        """Set it; a negative offset is left as it is."""
        self._call("set_region", None, *[c_int] * 4)(x, y, width, height)

    def pixel_formats(self) -> list[str]:
        """Those that it has."""
        return self._names(self._call("dup_available_pixel_formats_as_strings", c_void_p, POINTER(c_uint)))

    def pixel_format(self) -> str:
        """The one in force."""
        return bytes(self._call("get_pixel_format_as_string", c_char_p)() or b"").decode(errors="replace")

    def set_pixel_format(self, name: str) -> None:
        """Set it."""
        self._call("set_pixel_format_from_string", None, c_char_p)(name.encode())

    def trigger_sources(self) -> list[str]:
        """Those that it has."""
        return self._names(self._call("dup_available_trigger_sources", c_void_p, POINTER(c_uint)))

    def set_trigger(self, source: str) -> None:
        """Every frame waits for it from now on."""
        self._call("set_trigger", None, c_char_p)(source.encode())

    def clear_triggers(self) -> None:
        """Frames come by themselves from now on."""
        self._call("clear_triggers", None)()

    def trigger(self) -> None:
        """The software's trigger."""
        self._call("software_trigger", None)()

    # The stream

    def payload(self) -> int:
        """Bytes of a frame."""
        return int(self._call("get_payload", c_uint)())

    def start(self) -> None:
        """Begin to deliver."""
        self._call("start_acquisition", None)()

    def stop(self) -> None:
        """End it."""
        self._call("stop_acquisition", None)()

    # GigE Vision

    def is_gige(self) -> bool:
        """Whether it is a GigE Vision camera."""
        return bool(function("arv_camera_is_gv_device", c_int, c_void_p)(self.pointer))

    def negotiate_packets(self) -> int:
        """Find the largest packets that the way to the camera carries; returns their size, bytes."""
        return int(self._call("gv_auto_packet_size", c_uint)())

    def use_plain_sockets(self) -> None:
        """For its next stream. As root Aravis would listen to the whole card, and take packets of anybody that come
        before its filter is set for frames.
        """
        set_options = function("arv_gv_device_set_stream_options", None, c_void_p, c_int)
        set_options(self._device(), _NO_PACKET_SOCKET)

    def packet_size(self) -> int:
        """Bytes."""
        return int(self._call("gv_get_packet_size", c_uint)())

    def is_ours(self) -> bool:
        """Whether this program controls it; another's control is noticed within seconds."""
        return not self.is_gige() or bool(function("arv_gv_device_is_controller", c_int, c_void_p)(self._device()))

    def owner(self) -> str:
        """IP address of the program that controls it, '' where the camera does not tell."""
        try:
            told = self.register(_OWNER_REGISTER)
        except AravisError:
            return ""
        return ".".join(str(told >> shift & 255) for shift in (24, 16, 8, 0)) if told else ""

    def register(self, address: int) -> int:
        """What stands in one of its registers."""
        read, value = checked("arv_device_read_register", c_int, c_void_p, c_uint, POINTER(c_uint32)), c_uint32()
        read(self._device(), address, byref(value))
        return value.value

    def _device(self) -> int:
        return int(function("arv_camera_get_device", c_void_p, c_void_p)(self.pointer))

    def _call(self, name: str, result: Any, *arguments: Any) -> Callable[..., Any]:
        call = checked(f"arv_camera_{name}", result, c_void_p, *arguments)
        return lambda *values: call(self.pointer, *values)

    def _names(self, call: Callable[..., Any], *arguments: bytes) -> list[str]:
        count = c_uint()
        found = call(*arguments, byref(count))
        names = c_cast(found, POINTER(c_char_p))
        told = [(names[k] or b"").decode(errors="replace") for k in range(count.value)]
        if found:
            function("g_free", None, c_void_p, library=GLIB)(found)  # the words themselves are the camera's
        return told
