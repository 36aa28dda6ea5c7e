"""What viewers draw into the images: a circle around every spot, names beside LEDs.

There are dozens in every frame, alike but for some numbers. Protobuf encodes one of each kind, with a mark where these
numbers go; the others are its bytes with other numbers. That takes a quarter of the time of setting every field.
"""

import struct

from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.TextAnnotation_pb2 import TextAnnotation
from google.protobuf.timestamp_pb2 import Timestamp

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import timestamp, to_bytes, varint

_MARK = 4.9406564584124654e-310  # a number that nothing else has
_MARK_BYTES = struct.pack("<d", _MARK)
_COLOURS = {pb.LED: (0.2, 1.0, 0.3, 1.0), pb.UNEXPLAINED: (1.0, 0.8, 0.1, 1.0)}
_OTHER = (1.0, 0.2, 0.2, 0.7)
_TEXT_TAG = bytes([TextAnnotation.TEXT_FIELD_NUMBER << 3 | 2])
_TEXTS_TAG = bytes([ImageAnnotations.TEXTS_FIELD_NUMBER << 3 | 2])


def encode_annotations(time_ns: int, report: "pb.FrameReport") -> bytes:
    """foxglove.ImageAnnotations of a report's spots: a circle for each, green for LEDs, red for the rejected, and
    the robot's id beside its first LED.
    """
    stamp, spots = timestamp(time_ns), report.spots
    circles = {fate: _circle(stamp, colour) for fate, colour in _COLOURS.items()}
    other = _circle(stamp, _OTHER)
    pack = struct.Struct(f"<{len(other[0])}sdcdcd{len(other[3])}s").pack
    drawn = []
    for x, y, radius, fate in zip(spots.x, spots.y, spots.radius, spots.fate, strict=True):
        head, to_y, to_diameter, tail = circles.get(fate, other)
        drawn.append(pack(head, x, to_y, y, to_diameter, 2 * radius + 6, tail))
    return b"".join(drawn + _texts(stamp, report))


def _texts(stamp: Timestamp, report: "pb.FrameReport") -> list[bytes]:
    spots = report.spots
    ids = [robot.id for robot in report.robots]
    head, to_y, tail = to_bytes(_label(stamp)).split(_MARK_BYTES)
    pack = struct.Struct(f"<{len(head)}sdcd").pack
    size = len(head) + len(tail) + 17
    named: set[int] = set()
    texts: list[bytes] = []
    for x, y, radius, robot, led in zip(spots.x, spots.y, spots.radius, spots.robot, spots.led, strict=True):
        if robot < 0:
            continue
        text = (str(led) if robot in named else f"{ids[robot]} {led}").encode()
        named.add(robot)
        told = _TEXT_TAG + varint(len(text)) + text
        # The text is the field behind the position, and before all others.
        texts += (_TEXTS_TAG, varint(size + len(told)), pack(head, x + radius + 5, to_y, y), told, tail)
    return texts


def _circle(stamp: Timestamp, colour: tuple[float, float, float, float]) -> list[bytes]:
    """One of them, encoded, in four parts: x, y and the diameter go between these."""
    drawing = ImageAnnotations()
    circle = drawing.circles.add(timestamp=stamp, diameter=_MARK, thickness=1.0)
    line = circle.outline_color
    line.r, line.g, line.b, line.a = colour
    circle.fill_color.SetInParent()
    circle.position.x = circle.position.y = _MARK
    return to_bytes(drawing).split(_MARK_BYTES)


def _label(stamp: Timestamp) -> TextAnnotation:
    label = TextAnnotation(timestamp=stamp, font_size=14.0)
    label.position.x = label.position.y = _MARK
    colour = label.text_color
    colour.r, colour.g, colour.b, colour.a = 0.2, 1.0, 0.3, 1.0
    label.background_color.SetInParent()
    return label
