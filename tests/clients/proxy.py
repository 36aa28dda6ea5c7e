"""A TCP link that is slow, or stands still: between a client and its server, in threads of the test."""

import contextlib
import select
import socket
import threading
import time

CHUNK = 2048
BUFFER = 8192  # of the sockets: what waits, waits at the server


class Proxy:
    """Listens at ``endpoint`` and passes bytes on, at most ``rate`` a second towards the client. A context manager.

    ``buffer``: bytes, of its sockets; None: the kernel's own, which hold more than a short stall brings.
    """

    def __init__(self, server: str, rate: float = 1e12, buffer: int | None = BUFFER) -> None:
        host, port = server.removeprefix("tcp/").split(":")
        self._server = (host, int(port))
        self.rate = rate
        self._buffer = buffer
        self.flows = threading.Event()  # cleared: the link stands still
        self.flows.set()
        self._stop = threading.Event()
        self._threads: list[threading.Thread] = []
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"tcp/127.0.0.1:{self._listener.getsockname()[1]}"
        self._start(self._accept)

    def __enter__(self) -> "Proxy":
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self.flows.set()
        for thread in self._threads:
            thread.join()
        self._listener.close()

    def _start(self, work: object, *arguments: object) -> None:
        thread = threading.Thread(target=work, args=arguments)  # type: ignore[arg-type]
        self._threads.append(thread)
        thread.start()

    def _accept(self) -> None:
        while not self._stop.is_set():
            if not select.select([self._listener], [], [], 0.05)[0]:
                continue
            client = self._listener.accept()[0]
            server = socket.socket()
            for end in (client, server) if self._buffer else ():
                end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, self._buffer)
                end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, self._buffer)
            try:
                server.connect(self._server)
            except OSError:
                client.close()
                server.close()
                continue
            self._start(self._pass_on, client, server, False)
            self._start(self._pass_on, server, client, True)

    def _pass_on(self, source: socket.socket, to: socket.socket, throttled: bool) -> None:
        flows = self.flows  # of this connection: another event is for those that come later
        with contextlib.suppress(OSError), source:
            while not self._stop.is_set():
                if not select.select([source], [], [], 0.05)[0]:
                    continue
                data = source.recv(CHUNK)
                if not data:
                    break
                flows.wait()
                if throttled:
                    time.sleep(len(data) / self.rate)
                to.sendall(data)
        with contextlib.suppress(OSError):
            to.shutdown(socket.SHUT_RDWR)
