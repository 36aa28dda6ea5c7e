"""rerun's web viewer as a page on loopback that asks no other host for anything.

The page that the rerun program hosts itself loads a font from one host, looks for a newer version at a second, for
examples at a third, and reports its use to a fourth. So its files are handed on from here, with a header by which the
browser keeps the page to this machine (Content-Security-Policy), and without what the header does not reach.
"""

import contextlib
import http.client
import re
import socketserver
import threading
import time
from http.server import BaseHTTPRequestHandler
from urllib.parse import quote

from asterism.protocol.errors import InputError
from asterism.server.service.loopback import HOST, free_port, why_taken
from asterism.server.service.rerun_program import Rerun

SERVER_MEMORY = "64MiB"  # of what it keeps for browsers that come later: some 20 s
STARTS_S = 30.0  # the program is large: that long until it answers, on a machine that is busy
_PIECE = 1 << 18
_FOREIGN = re.compile(rb'<link\b[^>]*"https://[^>]*>')  # connections in advance are not under the header


class WebPage:
    """rerun's page at ``port``, what it shows at the next one. Raises InputError for ports that cannot be had,
    ModuleNotFoundError where rerun is not installed.
    """

    def __init__(self, port: int) -> None:
        self.address = f"http://{HOST}:{port}"
        for needed in (port, port + 1):
            if why := why_taken(needed):
                raise InputError(
                    f"--web {port}: port {needed} cannot be listened on at {HOST} ({why}); expected two free ports, "
                    "PORT for the page and PORT + 1 for what it shows"
                )
        self._server = _Server((HOST, port), _Handler)
        try:
            files = free_port()
            self._rerun = Rerun(
                port + 1, "--serve-web", "--web-viewer-port", str(files), "--server-memory-limit", SERVER_MEMORY
            )
        except BaseException:
            self._server.server_close()
            raise
        self.url = self._rerun.url
        self._server.hands_on(files, self._rerun)
        self._thread = threading.Thread(target=self._server.serve_forever, name="web-page", daemon=True)
        self._thread.start()

    @property
    def ended(self) -> bool:
        """Whether the rerun program is gone."""
        return self._rerun.ended

    def close(self) -> None:
        """Answer no more."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
        self._rerun.close()


class _Server(socketserver.ThreadingTCPServer):
    allow_reuse_address = True
    daemon_threads = True
    block_on_close = False

    def hands_on(self, port: int, rerun: Rerun) -> None:
        """From where the files come, and what the page then connects to."""
        self.files_port, self.rerun = port, rerun
        http_url = rerun.url.removeprefix("rerun+").removesuffix("/proxy")
        self.start = f"/?url={quote(rerun.url, safe='')}&hide_welcome_screen&theme=dark"
        self.policy = (
            f"default-src 'self' data: blob:; connect-src 'self' {http_url} data: blob:; "
            "script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval' blob:; style-src 'self' 'unsafe-inline'; "
            "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
        )

    def handle_error(self, *_: object) -> None:
        """Who hangs up is nobody's trouble."""


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    timeout = 60.0  # a browser that is stopped keeps no thread for ever

    def do_GET(self) -> None:
        if self.path == "/":
            self.send_response(302)
            self.send_header("Location", self.server.start)
            self.send_header("Content-Length", "0")
            self.end_headers()
            return
        with contextlib.closing(http.client.HTTPConnection(HOST, self.server.files_port, timeout=10.0)) as files:
            if not self._reached(files):
                self.send_error(502, "the rerun viewer has ended", "Stop asterism serve and start it anew.")
                return
            files.request("GET", self.path.partition("?")[0])
            self._hand_on(files.getresponse())

    def _reached(self, files: http.client.HTTPConnection) -> bool:
        """Whether the program answers; at its start that takes a moment."""
        until = time.monotonic() + STARTS_S
        while time.monotonic() < until and not self.server.rerun.ended:
            with contextlib.suppress(ConnectionRefusedError):
                files.connect()
                return True
            time.sleep(0.05)
        return False

    def _hand_on(self, answer: http.client.HTTPResponse) -> None:
        kind = answer.headers.get("Content-Type", "application/octet-stream")
        page = _FOREIGN.sub(b"", answer.read()) if kind.startswith("text/html") else None
        length = str(len(page)) if page is not None else answer.headers.get("rerun-final-length")
        self.send_response(answer.status)
        for name, value in (
            ("Content-Type", kind),
            ("Content-Security-Policy", self.server.policy),
            ("Referrer-Policy", "no-referrer"),
            *((name, length) for name in ("Content-Length", "rerun-final-length") if length),
        ):
            self.send_header(name, value)
        self.end_headers()
        if page is not None:
            self.wfile.write(page)
            return
        while piece := answer.read(_PIECE):
            self.wfile.write(piece)

    def log_message(self, *_: object) -> None:
        """Nobody wants to read it."""
