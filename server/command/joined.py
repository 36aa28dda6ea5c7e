"""Images of the network, in commands that publish nothing."""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager

from asterism.protocol.errors import InputError
from asterism.protocol.network import joins, open_server
from asterism.server.sources.foreign.arriving import ArrivingImages
from asterism.server.sources.foreign.ros_images import RosImages
from asterism.server.sources.source import Source


@contextmanager
def joined(source: Source, options: argparse.Namespace) -> Iterator[None]:
    """Images of the network come from where `serve` would take them: its own listener, or what it joins."""
    place = (options.listen, options.connect, options.zenoh)
    if options.ros_domain is not None and not isinstance(source, RosImages):
        raise InputError("--ros-domain: is for images of ROS 2, ros2:TOPIC")
    if not isinstance(source, ArrivingImages):
        if any(place):
            raise InputError("--listen, --connect, --zenoh: are for images from the network, zenoh:KEY or ros2:TOPIC")
        yield
        return
    if options.listen and options.connect:
        raise InputError("--listen and --connect exclude each other; --connect joins what is there as a client")
    with open_server(*place, () if isinstance(source, RosImages) else None) as session:
        source.join(session, listens=not joins(options.connect, options.zenoh))
        try:
            yield
        finally:
            source.close()
