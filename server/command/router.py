"""asterism router: a zenoh router with our defaults, where cameras, robots and desks of several hosts meet."""

import argparse
import json
import time
from datetime import timedelta

from asterism.protocol.network import endpoints_of, open_router, router_config
from asterism.server.command.shared_arguments import add_zenoh
from asterism.server.service.router import Visitors, remark
from asterism.server.service.say import say
from asterism.server.service.stop import Stop, stop_on_signals
from asterism.server.service.systemd import Systemd

EXAMPLES = (
    "asterism router\n"
    "asterism router --listen tcp/192.168.1.2:7447\n"
    "asterism router --zenoh router.json5\n"
    "asterism router --listen tcp/10.0.0.2:7447 --connect tcp/192.168.1.2:7447\n"
)


def add_arguments(part: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    part.add_argument(
        "--listen",
        metavar="EP",
        action="append",
        default=[],
        help="listen there instead of tcp/127.0.0.1:7447; may be given for several",
    )
    part.add_argument(
        "--connect",
        metavar="EP",
        action="append",
        default=[],
        help="link to the router there; may be given for several",
    )
    add_zenoh(part)


def run(options: argparse.Namespace) -> int:
    """Pass messages on until Ctrl-C."""
    config = router_config(options.listen, options.connect, options.zenoh)
    listen, linked = endpoints_of(config, "listen"), endpoints_of(config, "connect")
    is_ruled = json.loads(config.get_json("access_control"))["enabled"]
    stop, systemd, began_s = Stop(), Systemd(), time.monotonic()
    with stop_on_signals(stop), open_router(config) as session:
        say(f"router at {', '.join(listen)}; Ctrl-C ends it")
        if warning := remark(listen, is_ruled):
            say(warning)
        visitors = Visitors(session, linked, say)
        systemd.ready()
        try:
            while not stop():
                visitors.step()
                systemd.alive()
        finally:
            systemd.stopping()
            visitors.close()
    say(f"stopped after {timedelta(seconds=round(time.monotonic() - began_s))}")
    for line in visitors.summary():
        say(line)
    return 0
