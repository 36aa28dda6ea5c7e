"""Which GenICam cameras there are, and which one a person means."""

import ipaddress
from typing import NamedTuple

from asterism.protocol.errors import InputError, WorldError
from asterism.server.sources.genicam.aravis import Listed, listed
from asterism.server.sources.genicam.gvcp import who_is

PREFIX = "genicam:"
_GIGE = "GigEVision"


class FoundCamera(NamedTuple):
    """A camera that answers; ``name`` is what it is called as SOURCE."""

    name: str
    vendor: str
    model: str
    serial: str
    place: "Place"


class Found(NamedTuple):
    """The cameras that answer, or why none could be asked."""

    cameras: list[FoundCamera]
    problem: str = ""


class Place(NamedTuple):
    """Where a camera is: what Aravis opens, the IP of a GigE Vision camera ('' on USB), and who it is."""

    id: str
    address: str
    serial: str


def list_genicam() -> Found:
    """Asks for a second. Without the library there are none, and `problem` says why."""
    try:
        cameras = listed()
    except WorldError as problem:
        return Found([], str(problem))
    names = (_name(one, k, cameras) for k, one in enumerate(cameras))
    told = zip(names, cameras, strict=True)
    return Found([FoundCamera(name, one.vendor, one.model, one.serial, _place(one)) for name, one in told])


def _name(one: Listed, index: int, cameras: list[Listed]) -> str:
    """By serial number where that is enough."""
    alone = bool(one.serial) and [other.serial for other in cameras].count(one.serial) == 1
    return f"{PREFIX}{one.serial if alone else one.id or index}"


def find(text: str) -> Place:
    """The camera that ``text``, behind the prefix, names: its serial number, IP address, or place among those found.

    Raises InputError, with what there is, where none answers to it; WorldError where the library is missing.
    """
    address = _ip(text)
    if address:
        answer = who_is(address)
        if answer is None:
            raise InputError(f"{PREFIX}{text}: no camera answers at this address; {_there_is(listed())}")
        return Place(address, address, answer.serial)
    cameras = listed()
    for one in cameras:
        if text in (one.serial, one.id):
            return _place(one)
    if text.isdecimal() and int(text) < len(cameras):
        return _place(cameras[int(text)])
    raise InputError(f"{PREFIX}{text}: there is no such camera; {_there_is(cameras)}")


def find_again(place: Place, look: bool) -> Place | None:
    """The same camera after it was away, also at another address; None where it does not answer.

    ``look`` asks the whole network, which takes a second; without, only where it was.
    """
    if place.address:
        answer = who_is(place.address)
        if answer is not None and answer.serial == place.serial:
            return place
    if not look and place.address:
        return None
    return next((_place(one) for one in listed() if one.serial == place.serial), None)


def _place(one: Listed) -> Place:
    address = _ip(one.address) if one.protocol == _GIGE else ""
    return Place(address or one.id, address, one.serial)


def _ip(text: str) -> str:
    try:
        return str(ipaddress.IPv4Address(text))
    except ValueError:
        return ""


def _there_is(cameras: list[Listed]) -> str:
    if not cameras:
        return "none was found on the network or on USB (is it powered, and in this host's subnet?)"
    told = (
        f"{k} {one.vendor} {one.model}, serial {one.serial or '?'}, at {one.address}" for k, one in enumerate(cameras)
    )
    return "there is " + "; ".join(told)
