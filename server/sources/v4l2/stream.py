"""A V4L2 camera's buffers, shared with its driver, and the frames that come in them."""

import errno
import mmap
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from ctypes import c_int32

from asterism.server.sources.v4l2 import abi
from asterism.server.sources.v4l2.node import Node

BUFFERS = 4  # frames that the driver keeps while one is looked at


class Stream:
    """A camera that runs. Raises OSError as the driver has it."""

    def __init__(self, node: Node) -> None:
        """Ask the driver for buffers, and begin."""
        self._node = node
        self._memory: list[mmap.mmap] = []
        asked = abi.BufferRequest(count=BUFFERS, type=abi.CAPTURE, memory=abi.MMAP)
        node.ioctl(abi.REQBUFS, asked)
        try:
            for index in range(asked.count):
                buffer = abi.Buffer(index=index, type=abi.CAPTURE, memory=abi.MMAP)
                node.ioctl(abi.QUERYBUF, buffer)
                self._memory.append(node.system.map(node.handle, buffer.length, buffer.m.offset))
                node.ioctl(abi.QBUF, buffer)
            node.ioctl(abi.STREAMON, c_int32(abi.CAPTURE))
        except BaseException:
            self.close()
            raise

    def waits(self) -> bool:
        """Whether a buffer is filled already."""
        return self._node.system.wait(self._node.handle, 0.0)

    @contextmanager
    def next(self, timeout_s: float) -> Iterator[tuple[abi.Buffer, memoryview] | None]:
        """The next buffer and what is used of it, for as long as the block runs; None: nothing came in that time."""
        buffer = self._filled(timeout_s)
        if buffer is None:
            yield None
            return
        with memoryview(self._memory[buffer.index]) as whole, whole[: buffer.bytesused] as used:
            yield buffer, used
        self._node.ioctl(abi.QBUF, abi.Buffer(index=buffer.index, type=abi.CAPTURE, memory=abi.MMAP))

    def close(self) -> None:
        """End the stream and give the buffers back."""
        with suppress(OSError):  # of a camera that is gone
            self._node.ioctl(abi.STREAMOFF, c_int32(abi.CAPTURE))
        for memory in self._memory:
            memory.close()
        with suppress(OSError):
            self._node.ioctl(abi.REQBUFS, abi.BufferRequest(count=0, type=abi.CAPTURE, memory=abi.MMAP))

    def _filled(self, timeout_s: float) -> abi.Buffer | None:
        while self._node.system.wait(self._node.handle, timeout_s):
            buffer = abi.Buffer(type=abi.CAPTURE, memory=abi.MMAP)
            try:
                self._node.ioctl(abi.DQBUF, buffer)
            except OSError as error:
                if error.errno != errno.EAGAIN:
                    raise
                continue
            return buffer
        return None
