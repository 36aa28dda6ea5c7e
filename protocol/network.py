"""Zenoh sessions with Asterism's defaults: loopback, no multicast scouting, queues that do not lose poses.

The server is a peer that listens; robots and desks are clients of it, or of any zenoh router. One with the same
defaults is here too.
"""

import json
import re
from collections.abc import Sequence
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING

from asterism.protocol.errors import InputError, WorldError
from asterism.protocol.keys import PREFIX, REPLAY
from asterism.protocol.text_file import read_text

if TYPE_CHECKING:
    import zenoh

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
FUSED_ENDPOINT = "tcp/127.0.0.1:7448"  # of `asterism fuse`

PROTOCOLS = ("tcp", "udp", "tls", "quic", "ws", "unixsock-stream")  # that zenoh's Python package speaks
_HOST_AND_PORT = PROTOCOLS[:5]
_PICTURE = re.compile(r"--> (\d+):\d+\n.*= (expected .*)", re.DOTALL)  # of what its JSON5 parser did not understand
_DEEPEST = 100  # levels of a configuration; zenoh's own has six

# With the default of 2 a publisher loses messages when the processor is busy; 16 lost none (measured).
_TX_QUEUE = 16
# Odometry has a queue of its own, so short that over a slow link it is dropped rather than told late: two batches, and
# what the kernel holds for a socket (twice the number given to it). On a fast link nothing was lost (measured).
ODOMETRY_PRIORITY = "INTERACTIVE_HIGH"
_ODOMETRY_QUEUE = 2
# Events have a queue of their own too, which they cannot fill, and come before frame reports.
EVENT_PRIORITY = "DATA_HIGH"
_BATCH_BYTES = 16_384
_SOCKET_BYTES = 32_768
# Who opens a connection and says nothing holds one of the places of those that wait; by default new clients wait 10 s.
_ACCEPT_TIMEOUT_MS = 1500
_ACCEPT_PENDING = 1000
_OWN_KEYS = (f"{PREFIX}/**", f"{REPLAY}{PREFIX}/**")
# A server that is started again is found at once: trying costs a packet.
_RETRY = {"period_init_ms": 100, "period_max_ms": 200, "period_increase_factor": 2}


def server_config(
    listen: str | None = None,
    connect: str | None = None,
    options: Path | None = None,
    ros_keys: Sequence[str] | None = None,
) -> "zenoh.Config":
    """A peer that listens on ``listen`` (default: loopback), or a client of ``connect``.

    ``options`` is a JSON5 file of zenoh options; what it says holds, unless an argument says otherwise. Through its own
    listener nobody else can speak under Asterism's keys, unless the file has an `access_control` of its own. With
    ``ros_keys``, key expressions that are its own as well, nodes of ROS 2 join it: it is a router, by which they find
    each other, and its messages have times, which their late joiners ask for. Raises InputError for a file that is no
    zenoh configuration.
    """
    config = _base(options)
    if ros_keys is not None:
        _default(config, "timestamping/enabled", True)
    _hold_no_poses_back(config)
    if connect is not None:
        _set(config, "mode", "client")
        _set(config, "connect/endpoints", [connect])
        _set(config, "listen/endpoints", [])
        return config
    _default(config, "mode", "peer" if ros_keys is None else "router")
    if listen is not None:
        _set(config, "listen/endpoints", [listen])
    elif config.get_json("mode") == '"client"':
        _default(config, "listen/endpoints", [])
    else:
        _default(config, "listen/endpoints", [DEFAULT_ENDPOINT])
    if config.get_json("mode") != '"client"':
        _default(config, "access_control", _only_the_server_speaks([*_OWN_KEYS, *(ros_keys or ())]))
        _let_nobody_wait(config)
    return config


def router_config(
    listen: Sequence[str] = (), connect: Sequence[str] = (), options: Path | None = None
) -> "zenoh.Config":
    """A zenoh router that listens on ``listen`` (default: loopback) and links to the routers at ``connect``.

    ``options`` is a JSON5 file of zenoh options; what it says holds, unless an argument says otherwise. It says who may
    speak, too: without an `access_control` there, everybody may. Raises InputError for a malformed endpoint, for a file
    that is no zenoh configuration, or one of something else than a router.
    """
    for endpoint in (*listen, *connect):
        check_endpoint(endpoint)
    config = _base(options)
    mode = json.loads(config.get_json("mode"))
    if mode not in (None, "router"):
        raise InputError(f'{options}: mode is {json.dumps(mode)}, expected "router", or none')
    _set(config, "mode", "router")
    _hold_no_poses_back(config)
    _let_nobody_wait(config)
    if listen:
        _set(config, "listen/endpoints", list(listen))
    else:
        _default(config, "listen/endpoints", [DEFAULT_ENDPOINT])
    if connect:
        _set(config, "connect/endpoints", list(connect))
    return config


def endpoints_of(config: "zenoh.Config", kind: str) -> list[str]:
    """Where a session of that configuration listens ("listen"), or what it joins ("connect"), as endpoints."""
    told = json.loads(config.get_json(f"{kind}/endpoints"))
    if isinstance(told, dict):  # zenoh has a form with endpoints by mode
        told = told.get(json.loads(config.get_json("mode")), [])
    return [told] if isinstance(told, str) else list(told)


def _hold_no_poses_back(config: "zenoh.Config") -> None:
    """Over a link that is too slow, poses are dropped rather than told late."""
    _default(config, f"transport/link/tx/queue/size/{ODOMETRY_PRIORITY.lower()}", _ODOMETRY_QUEUE, _TX_QUEUE)
    _default(config, "transport/link/tx/batch_size", _BATCH_BYTES)


def _let_nobody_wait(config: "zenoh.Config") -> None:
    """For those that open a connection and say nothing."""
    _default(config, "transport/unicast/accept_timeout", _ACCEPT_TIMEOUT_MS)
    _default(config, "transport/unicast/accept_pending", _ACCEPT_PENDING)


def _only_the_server_speaks(keys: list[str]) -> dict[str, object]:
    """What comes in through a server's own listener is never told under its keys: everything else passes."""
    rule = {
        "id": "only the server speaks",
        "permission": "deny",
        "flows": ["ingress"],
        "messages": ["put", "delete", "declare_queryable", "reply", "liveliness_token"],
        "key_exprs": keys,
    }
    return {
        "enabled": True,
        "default_permission": "allow",
        "rules": [rule],
        "subjects": [{"id": "everybody"}],
        "policies": [{"rules": [rule["id"]], "subjects": ["everybody"]}],
    }


def short_of_buffer(endpoint: str) -> str:
    """The endpoint with a small buffer for sending, where it says nothing of it itself."""
    if endpoint.partition("/")[0] not in ("tcp", "tls") or "so_sndbuf" in endpoint:
        return endpoint
    return f"{endpoint}{';' if '#' in endpoint else '#'}so_sndbuf={_SOCKET_BYTES}"


def joins(connect: str | None, options: Path | None) -> bool:
    """Whether a server with these arguments joins what is there, instead of listening itself."""
    return connect is not None or server_config(None, None, options).get_json("mode") == '"client"'


def client_config(connect: str | None = None, options: Path | None = None) -> "zenoh.Config":
    """A client of ``connect`` (default: loopback) that finds its server again by itself.

    Raises InputError as `server_config` does.
    """
    config = _base(options)
    _default(config, "mode", "client")
    _default(config, "listen/endpoints", [])
    if connect is not None:
        _set(config, "connect/endpoints", [connect])
    else:
        _default(config, "connect/endpoints", [DEFAULT_ENDPOINT])
    return config


def _base(options: Path | None) -> "zenoh.Config":
    import zenoh

    if options is None:
        config = zenoh.Config()
    else:
        try:
            text = read_text(options, "a zenoh configuration in JSON5")
            if _depth(text) > _DEEPEST:  # its parser would end the process
                raise InputError(f"{options}: is nested too deeply, expected a zenoh configuration in JSON5")
            config = zenoh.Config.from_json5(text)
        except zenoh.ZError as error:
            raise InputError(f"{options}: is no zenoh configuration in JSON5 ({_short(error)})") from None
    _default(config, "scouting/multicast/enabled", False)
    _default(config, "connect/retry", _RETRY)
    for priority in ("real_time", "interactive_high", "interactive_low", "data_high", "data"):
        _default(config, f"transport/link/tx/queue/size/{priority}", _TX_QUEUE)
    return config


def _depth(text: str) -> int:
    """How deep the brackets of a JSON text go."""
    return max(accumulate(text, lambda depth, char: depth + (char in "[{") - (char in "]}"), initial=0))


def _default(config: "zenoh.Config", key: str, value: object, ours: object = None) -> None:
    """Set what the user's file left as zenoh has it, or what is ``ours`` already."""
    import zenoh

    if config.get_json(key) in (zenoh.Config().get_json(key), json.dumps(ours)):
        _set(config, key, value)


def _set(config: "zenoh.Config", key: str, value: object) -> None:
    config.insert_json5(key, json.dumps(value))


def _short(error: Exception) -> str:
    """A zenoh error in one line: without the places in its sources, without the picture of a file's line."""
    text = str(error).split(" at /")[0]
    if place := _PICTURE.search(text):
        return f"line {place[1]}: {' '.join(place[2].split())}"
    return " ".join(text.split())


def open_server(
    listen: str | None = None,
    connect: str | None = None,
    options: Path | None = None,
    ros_keys: Sequence[str] | None = None,
    joining: str = "--connect",
) -> "zenoh.Session":
    """Open the server's session, as `server_config` has it; ``joining`` is the option that gives ``connect``.

    Raises InputError when an endpoint is malformed or in use, WorldError when the infrastructure cannot be reached.
    """
    import zenoh

    for endpoint in (listen, connect):
        if endpoint is not None:
            check_endpoint(endpoint)
    config = server_config(listen, connect, options, ros_keys)
    _shorten_buffers(config)
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        text = _short(error)
        where = connect or listen or (str(options) if options else DEFAULT_ENDPOINT)
        if "Address already in use" in str(error):
            raise InputError(
                f"{where}: the endpoint is already in use (another server or a zenoh router?); expected a free one: "
                f"--listen tcp/127.0.0.1:PORT, or {joining} {where} to join what is there as a client"
            ) from None
        if connect is not None and "Unable to connect" in str(error):
            raise WorldError(f"{connect}: nothing answers there; start the zenoh router or server first") from None
        raise InputError(f"{where}: zenoh cannot use this endpoint: {text}") from None


def open_router(config: "zenoh.Config") -> "zenoh.Session":
    """Open a router, as `router_config` has it. Routers that it is to link to may be started later.

    Raises InputError when an endpoint is malformed or cannot be listened on, or when a file that the configuration
    names cannot be used.
    """
    import zenoh

    listen = endpoints_of(config, "listen")
    for endpoint in (*listen, *endpoints_of(config, "connect")):
        check_endpoint(endpoint)
    _shorten_buffers(config)
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        where, text = ", ".join(listen), _short(error)
        if "Address already in use" in str(error):
            raise InputError(
                f"{where}: the endpoint is already in use (a server, or another router?); expected a free one: "
                "--listen tcp/ADDRESS:PORT"
            ) from None
        if "Cannot assign requested address" in str(error):
            raise InputError(
                f"{where}: this machine does not have that address; expected one of its own, or tcp/0.0.0.0:PORT for "
                "all of them"
            ) from None
        raise InputError(f"{where}: zenoh cannot be a router there: {text}") from None


def _shorten_buffers(config: "zenoh.Config") -> None:
    for kind in ("listen", "connect"):
        _set(config, f"{kind}/endpoints", [short_of_buffer(endpoint) for endpoint in endpoints_of(config, kind)])


def check_endpoint(endpoint: str) -> None:
    """Refuse what is no zenoh endpoint with an InputError."""
    protocol, slash, address = endpoint.partition("/")
    if not (protocol.isascii() and protocol.replace("-", "").isalnum() and slash and address):
        raise InputError(f"endpoint {endpoint!r}: expected PROTOCOL/ADDRESS such as tcp/127.0.0.1:7447")
    if protocol not in PROTOCOLS:
        raise InputError(f"endpoint {endpoint!r}: protocol {protocol!r}, expected one of {', '.join(PROTOCOLS)}")
    if protocol in _HOST_AND_PORT:
        host, colon, port = address.split("?")[0].split("#")[0].rpartition(":")
        if not (host and colon and port.isdecimal() and len(port) <= 5 and int(port) < 65_536):
            raise InputError(f"endpoint {endpoint!r}: expected {protocol}/HOST:PORT such as tcp/127.0.0.1:7447")
