"""Options of serve that show or hand on what it publishes in other programs' ways, and what each opens."""

import argparse
from contextlib import ExitStack

from asterism.protocol.errors import InputError
from asterism.protocol.rig import Rig
from asterism.protocol.ros2 import names
from asterism.protocol.ros2.wire import owned_keys
from asterism.protocol.yaml_file import describe
from asterism.server.command.shared_arguments import add_ros_domain
from asterism.server.service.on_air import OnAir
from asterism.server.service.outlets import Outlet
from asterism.server.service.say import say
from asterism.server.sources.foreign.ros_images import is_ros


def add_outlets(part: argparse.ArgumentParser) -> None:
    """Which outlets there are to be."""
    part.add_argument("--rerun", action="store_true", help="show everything in the rerun viewer while it happens")
    part.add_argument("--ros2", action="store_true", help="tell nodes of ROS 2 too, those with rmw_zenoh")
    add_ros_domain(part)
    part.add_argument("--ros-namespace", metavar="NS", type=_namespace, help="before the robots' topics there")


def ros_place(options: argparse.Namespace, rig: Rig) -> names.RosPlace | None:
    """Where in ROS's world to publish, or None where nobody asked. Raises InputError for what ROS has no name for."""
    if not options.ros2:
        if options.ros_namespace is not None:
            raise InputError("--ros-namespace is for ROS 2; add --ros2")
        if options.ros_domain is not None and not is_ros(options.source):
            raise InputError("--ros-domain is for ROS 2; add --ros2, or take images from it: ros2:TOPIC")
        return None
    for robot in rig.robots:
        if problem := names.part_problem(robot.id):
            raise InputError(
                f"--ros2: the robot's id {robot.id!r} {problem}; it becomes part of its topics: rename it in the rig"
            )
        if robot.id in ("world", rig.camera.name):
            raise InputError(
                f"--ros2: the robot {robot.id!r} has the name of a frame that is there, expected another: frames of "
                f"ROS are world, {rig.camera.name} and the robots"
            )
        topic = names.odom_topic(options.ros_namespace or "", robot.id)
        if len(topic) > names.LONGEST_TOPIC:
            raise InputError(
                f"--ros2: the topic {topic} has {len(topic)} characters, expected at most {names.LONGEST_TOPIC}: give "
                "a shorter --ros-namespace, or rename the robot in the rig"
            )
    return names.RosPlace(options.ros_domain or 0, options.ros_namespace or "")


def ros_keys(options: argparse.Namespace, rig: Rig) -> tuple[str, ...] | None:
    """What of ROS's keys nobody but this server may speak under; None where no node of ROS 2 is to join it.

    Raises InputError as `ros_place` does.
    """
    place = ros_place(options, rig)
    if place is None:
        return () if is_ros(options.source) else None
    return tuple(owned_keys(place, (robot.id for robot in rig.robots)))


def _namespace(text: str) -> str:
    if problem := names.namespace_problem(text):
        raise argparse.ArgumentTypeError(f"{describe(text)} {problem}")
    return names.clean_namespace(text)


def open_outlets(options: argparse.Namespace, rig: Rig, air: OnAir, stack: ExitStack) -> tuple[Outlet, ...]:
    """Open those that were asked for; ``stack`` closes them."""
    opened: list[Outlet] = []

    def add(outlet: Outlet) -> None:
        stack.callback(outlet.close)
        opened.append(outlet)

    if options.rerun:
        from asterism.server.service.live_view import LiveView

        add(LiveView(rig))
    if (place := ros_place(options, rig)) is not None:
        from asterism.server.service.ros2.outlet import Ros2

        outlet = Ros2(air.session, rig, place, air.publisher.clock)
        add(outlet)
        say(f"ROS 2, domain {place.domain}: node {outlet.node}, topics {place.namespace}/ROBOT/pose and odom")
    return tuple(opened)
