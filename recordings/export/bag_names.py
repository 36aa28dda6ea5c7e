"""What robots and cameras are called in a ROS 2 bag, whose topics may hold fewer characters than their ids."""

import re
from collections.abc import Iterable

from asterism.protocol.errors import InputError
from asterism.protocol.ros2.names import part_problem


class RosNames:
    """The parts of topics by id; ``renamed`` are the ids that ROS has no topic for, with what they are called."""

    def __init__(self, ids: Iterable[str]) -> None:
        self.renamed: dict[str, str] = {}
        taken: dict[str, str] = {}
        for name in dict.fromkeys(ids):
            part = self.of(name)
            if part in taken:
                raise InputError(
                    f"robots {taken[part]!r} and {name!r} would both be /{part} in a bag, expected ids that differ in "
                    "letters A-Z a-z, digits or underscores"
                )
            taken[part] = name

    def of(self, name: str) -> str:
        """``name`` itself where ROS takes it, else with underscores for what it does not."""
        if part_problem(name) is None:
            return name
        part = re.sub(r"[^A-Za-z0-9_]", "_", name)
        self.renamed[name] = f"id_{part}" if part[0].isdecimal() else part
        return self.renamed[name]
