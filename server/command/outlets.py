"""Options of serve that show or hand on what it publishes in other programs' ways, and what each opens."""

import argparse
import os
from collections.abc import Callable
from contextlib import ExitStack
from typing import TYPE_CHECKING

from asterism.protocol.errors import InputError
from asterism.protocol.rig import Rig
from asterism.protocol.ros2 import names
from asterism.protocol.ros2.node import Node
from asterism.protocol.ros2.wire import owned_keys
from asterism.protocol.yaml_file import describe
from asterism.server.command.number_arguments import port
from asterism.server.command.shared_arguments import add_ros_domain
from asterism.server.service.on_air import OnAir
from asterism.server.service.outlets import Outlet
from asterism.server.service.say import say
from asterism.server.sources.foreign.ros_images import is_ros

if TYPE_CHECKING:
    from asterism.server.service.mavlink.endpoint import Endpoint

WEB_PORT = 9090  # rerun's own
FOXGLOVE_PORT = 8765  # what Foxglove and PlotJuggler propose


def add_outlets(part: argparse.ArgumentParser) -> None:
    """Which outlets there are to be."""
    part.add_argument("--rerun", action="store_true", help="show everything in the rerun viewer while it happens")
    part.add_argument(
        "--web",
        metavar="PORT",
        type=_port,
        nargs="?",
        const=WEB_PORT,
        help=f"show everything in a browser, at http://127.0.0.1:PORT (default: {WEB_PORT}; uses PORT + 1 too)",
    )
    part.add_argument(
        "--foxglove",
        metavar="PORT",
        type=_port,
        nargs="?",
        const=FOXGLOVE_PORT,
        help=f"for Foxglove and PlotJuggler, at ws://127.0.0.1:PORT (default: {FOXGLOVE_PORT})",
    )
    part.add_argument("--ros2", action="store_true", help="tell nodes of ROS 2 too, those with rmw_zenoh")
    part.add_argument("--dds", action="store_true", help="tell nodes of ROS 2 too, those with Fast DDS or Cyclone DDS")
    add_ros_domain(part)
    part.add_argument("--ros-namespace", metavar="NS", type=_namespace, help="before the robots' topics there")
    part.add_argument(
        "--mavlink",
        metavar="ROBOT=HOST:PORT",
        action="append",
        type=_flight_controller,
        default=[],
        help="send a robot's poses to its flight controller over UDP; may be given for several",
    )
    part.add_argument(
        "--natnet",
        metavar="ADDRESS",
        nargs="?",
        type=_natnet_address,
        const=("127.0.0.1", 1510),
        help="answer programs that read OptiTrack's Motive, there (default: 127.0.0.1:1510)",
    )


def ros_place(options: argparse.Namespace, rig: Rig) -> names.RosPlace | None:
    """Where in ROS's world to publish, or None where nobody asked. Raises InputError for what ROS has no name for."""
    if not (options.ros2 or options.dds):
        if options.ros_namespace is not None:
            raise InputError("--ros-namespace is for ROS 2; add --ros2 or --dds")
        if options.ros_domain is not None and not is_ros(options.source):
            raise InputError("--ros-domain is for ROS 2; add --ros2 or --dds, or take images from it: ros2:TOPIC")
        return None
    option = "--ros2" if options.ros2 else "--dds"
    for robot in rig.robots:
        if problem := names.part_problem(robot.id):
            raise InputError(
                f"{option}: the robot's id {robot.id!r} {problem}; it becomes part of its topics: rename it in the rig"
            )
        if robot.id in ("world", rig.camera.name):
            raise InputError(
                f"{option}: the robot {robot.id!r} has the name of a frame that is there, expected another: frames of "
                f"ROS are world, {rig.camera.name} and the robots"
            )
        topic = names.odom_topic(options.ros_namespace or "", robot.id)
        if len(topic) > names.LONGEST_TOPIC:
            raise InputError(
                f"{option}: the topic {topic} has {len(topic)} characters, expected at most {names.LONGEST_TOPIC}: "
                "give a shorter --ros-namespace, or rename the robot in the rig"
            )
    return names.RosPlace(options.ros_domain or 0, options.ros_namespace or "")


def ros_keys(options: argparse.Namespace, rig: Rig) -> tuple[str, ...] | None:
    """What of ROS's keys nobody but this server may speak under; None where no node of ROS 2 is to join it.

    Raises InputError as `ros_place` does.
    """
    place = ros_place(options, rig)
    if place is None or not options.ros2:
        return () if is_ros(options.source) else None
    return tuple(owned_keys(place, (robot.id for robot in rig.robots)))


def _port(text: str) -> int:
    """One that may be left out, before what may be taken for it."""
    try:
        return port(text)
    except argparse.ArgumentTypeError as error:
        raise argparse.ArgumentTypeError(f"{error}; RIG and SOURCE go before it") from None


def _namespace(text: str) -> str:
    if problem := names.namespace_problem(text):
        raise argparse.ArgumentTypeError(f"{describe(text)} {problem}")
    return names.clean_namespace(text)


def check_outlets(options: argparse.Namespace, rig: Rig) -> None:
    """Refuse what cannot be with this rig with an InputError, before anything is begun; raise ModuleNotFoundError for
    what is not installed.
    """
    _check_ports(options)
    _remark_domain(options)
    if options.dds:
        import cyclonedds  # noqa: F401
    if options.mavlink:
        from asterism.server.service.mavlink.endpoint import systems_of

        systems_of(options.mavlink, rig)


def _remark_domain(options: argparse.Namespace) -> None:
    # Who works with ROS has it set and takes it for granted; a server's poses must not depend on whose shell it was.
    told = os.environ.get("ROS_DOMAIN_ID", "")
    asked = options.ros2 or options.dds or is_ros(options.source)
    if asked and options.ros_domain is None and told not in ("", "0"):
        say(f"ROS_DOMAIN_ID is {describe(told)} here and not read: this is domain 0, another is --ros-domain N")


def _check_ports(options: argparse.Namespace) -> None:
    # The page's drawing process opens its ports only later: another outlet would take one from it.
    told = {"--foxglove": options.foxglove, "--metrics": options.metrics}
    taken = {} if options.web is None else {options.web: "--web", options.web + 1: "--web, which takes PORT + 1 too"}
    for option, wanted in told.items():
        if wanted in taken:
            raise InputError(f"{option} {wanted}: port {wanted} is that of {taken[wanted]}; expected a port of its own")
        if wanted is not None:
            taken[wanted] = option


def _flight_controller(text: str) -> "Endpoint":
    from asterism.server.service.mavlink.endpoint import endpoint

    return endpoint(text)


def _natnet_address(text: str) -> tuple[str, int]:
    from asterism.server.service.natnet.address import address

    return address(text)


def _open_ros(
    options: argparse.Namespace, place: names.RosPlace, rig: Rig, air: OnAir, add: Callable[[Outlet], None]
) -> None:
    from asterism.server.service.ros2.outlet import Ros2

    topics = f"topics {place.namespace}/ROBOT/pose and odom"
    if options.ros2:
        name = names.node_name(rig.camera.name)
        add(Ros2(Node(air.session, place, name), rig, place, air.publisher.clock))
        say(f"ROS 2, domain {place.domain}: node {place.namespace}/{name}, {topics}")
    if options.dds:
        from asterism.server.service.dds.node import DdsNode

        dds = DdsNode(place.domain)
        add(Ros2(dds, rig, place, air.publisher.clock, over := "ROS 2 over DDS"))
        say(f"{over}, domain {place.domain}, {dds.where}: {topics}")


def open_outlets(options: argparse.Namespace, rig: Rig, air: OnAir, stack: ExitStack) -> tuple[Outlet, ...]:
    """Open those that were asked for; ``stack`` closes them."""
    opened: list[Outlet] = []

    def add(outlet: Outlet) -> None:
        stack.callback(outlet.close)
        opened.append(outlet)

    if options.rerun or options.web is not None:
        from asterism.server.service.live_view import LiveView

        if options.rerun:
            add(LiveView(rig))
        if options.web is not None:
            add(LiveView(rig, str(options.web)))
    if (place := ros_place(options, rig)) is not None:
        _open_ros(options, place, rig, air, add)
    if options.mavlink:
        from asterism.server.service.mavlink.outlet import Mavlink

        add(Mavlink(rig, options.mavlink, air.publisher.clock))
    if options.natnet is not None:
        from asterism.server.service.natnet.outlet import NatNet

        add(NatNet(rig, *options.natnet))
    if options.foxglove is not None:
        from asterism.server.service.foxglove_outlet import FoxgloveOutlet

        add(FoxgloveOutlet(rig, options.foxglove))
    return tuple(opened)
