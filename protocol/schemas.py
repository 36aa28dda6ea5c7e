"""The schemas of all messages, as recordings carry them."""

from functools import cache

from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import Default

import asterism.protocol.codec  # noqa: F401  (fills the default pool with every schema in use)


@cache
def descriptor_set(schema: str) -> bytes:
    """The serialized FileDescriptorSet of a schema with all it depends on, dependencies first."""
    found = FileDescriptorSet()
    seen: set[str] = set()

    def add(file: object) -> None:
        for dependency in file.dependencies:  # type: ignore[attr-defined]
            add(dependency)
        if file.name not in seen:  # type: ignore[attr-defined]
            seen.add(file.name)  # type: ignore[attr-defined]
            file.CopyToProto(found.file.add())  # type: ignore[attr-defined]

    add(Default().FindMessageTypeByName(schema).file)
    return found.SerializeToString(deterministic=True)
