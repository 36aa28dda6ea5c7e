"""What files of other programs hold: topics, each with messages of one type."""

from collections.abc import Collection, Iterator
from typing import NamedTuple, Protocol

from asterism.protocol.errors import InputError
from asterism.protocol.yaml_file import shortened

MOST_TOLD = 20  # topics in a sentence


class Topic(NamedTuple):
    """A topic; ``type`` by ROS 2's names where it is ROS', ``encoding`` that of its messages: protobuf, cdr, ros1."""

    name: str
    type: str
    encoding: str
    held: int | None = None  # messages, where that is known

    def __str__(self) -> str:
        return f"{shown(self.name)} ({shown(type_name(self.type))})"


class Topics(Protocol):
    """Files that hold topics."""

    name: str

    def topics(self) -> list[Topic]:
        """All topics. Raises InputError for files that are damaged."""
        ...

    def messages(self, topic: Topic) -> Iterator[tuple[int, bytes | memoryview]]:
        """When each message of a topic was written, ns, and its bytes, in that order. Raises InputError likewise."""
        ...


def shown(name: str) -> str:
    """A name as sentences have it: nothing in it moves a terminal's cursor."""
    return shortened(name if name.isprintable() else repr(name))


def ros2_name(name: str) -> str:
    """A type by its ROS 2 name: ROS 1 leaves the middle out."""
    package, _, rest = name.partition("/")
    return f"{package}/msg/{rest}" if rest and "/" not in rest else name


def type_name(name: str) -> str:
    """A type as people call it."""
    return name.replace("/msg/", "/")


def chosen(files: Topics, wanted: str | None, accepted: Collection[tuple[str, str]], what: str, types: str) -> Topic:
    """The topic that is ``wanted``, or without that the only one of a type and encoding that are ``accepted``.

    ``what`` names what is looked for and ``types`` its types, for sentences. Raises InputError where there is none,
    where there are several, or where the one that is wanted is missing or of another type.
    """
    topics = sorted(files.topics())
    fitting = [topic for topic in topics if (topic.type, topic.encoding) in accepted]
    if wanted is not None:
        named = [topic for topic in topics if topic.name == wanted]
        if not named:
            raise InputError(f"{files.name}: has no topic {wanted}; it has {_listed(topics)}")
        found = [topic for topic in named if topic in fitting]
        if not found:
            other = named[0]
            kind = f"{shown(type_name(other.type) or 'a type that nobody told')} ({shown(other.encoding)})"
            raise InputError(f"{files.name}: topic {wanted} is {kind}, expected {what}: {types}")
        return found[0]
    if not fitting:
        raise InputError(f"{files.name}: has no topic with {what} ({types}); it has {_listed(topics)}")
    if len(fitting) > 1:
        raise InputError(f"{files.name}: has several topics with {what}; choose by --topic: {_listed(fitting)}")
    return fitting[0]


def _listed(topics: list[Topic]) -> str:
    if not topics:
        return "no topics"
    more = f" and {len(topics) - MOST_TOLD} more" if len(topics) > MOST_TOLD else ""
    return ", ".join(map(str, topics[:MOST_TOLD])) + more
