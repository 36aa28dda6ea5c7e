"""A headless Chromium that opens one page, by its DevTools protocol: what the page asks for, what it looks like."""

import base64
import contextlib
import json
import os
import shutil
import signal
import subprocess
import time
import urllib.request
from pathlib import Path
from types import TracebackType
from typing import Any

from websockets.sync.client import connect

PROGRAM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
WIDTH, HEIGHT = 900, 600
OPTIONS = (
    "--headless",
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--remote-debugging-port=0",
)


class Browser:
    """Opens ``url`` with a new profile in ``folder``. A context manager."""

    def __init__(self, url: str, folder: Path) -> None:
        assert PROGRAM is not None, "Chromium is not installed"
        self.requested: list[str] = []  # every address that the page asked for, refused ones too
        self.refused: list[str] = []  # what the browser says of those it did not let out
        self._process = subprocess.Popen(
            [PROGRAM, *OPTIONS, f"--window-size={WIDTH},{HEIGHT}", f"--user-data-dir={folder}", "about:blank"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        self._calls = 0
        self._kept = contextlib.ExitStack()
        self._kept.callback(self._end)
        try:
            self._socket = self._kept.enter_context(connect(_page(folder / "DevToolsActivePort"), max_size=None))
            for domain in ("Network", "Log", "Page"):
                self.call(f"{domain}.enable")
            whole = {"width": WIDTH, "height": HEIGHT, "deviceScaleFactor": 1, "mobile": False}
            self.call("Emulation.setDeviceMetricsOverride", **whole)
            self.call("Page.navigate", url=url)
        except BaseException:
            self._kept.close()
            raise

    def call(self, method: str, timeout_s: float = 120.0, **parameters: Any) -> dict[str, Any]:
        """What the browser answers."""
        self._calls += 1
        self._socket.send(json.dumps({"id": self._calls, "method": method, "params": parameters}))
        until = time.monotonic() + timeout_s
        while (told := self._next(until)).get("id") != self._calls:
            pass
        result: dict[str, Any] = told["result"]
        return result

    def wait_for_request(self, part: str, timeout_s: float = 120.0) -> None:
        """Until the page has asked for an address with these letters."""
        until = time.monotonic() + timeout_s
        while not any(part in address for address in self.requested):
            self._next(until)

    def look_on(self, seconds: float) -> None:
        """Let so much time pass."""
        with contextlib.suppress(TimeoutError):
            until = time.monotonic() + seconds
            while True:
                self._next(until)

    def screenshot(self) -> bytes:
        """The page as PNG."""
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])

    def stop(self) -> None:
        """Stop it where it is, as a debugger would; it stays connected."""
        os.killpg(self._process.pid, signal.SIGSTOP)

    def __enter__(self) -> "Browser":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end()  # one that is stopped closes no socket
        self._kept.close()

    def _end(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()

    def _next(self, until: float) -> dict[str, Any]:
        told: dict[str, Any] = json.loads(self._socket.recv(timeout=max(until - time.monotonic(), 0.0)))
        if told.get("method") == "Network.requestWillBeSent":
            self.requested.append(told["params"]["request"]["url"])
        elif told.get("method") == "Log.entryAdded" and "Content Security Policy" in told["params"]["entry"]["text"]:
            self.refused.append(told["params"]["entry"]["text"])
        return told


def _page(active: Path) -> str:
    """The address of the first tab's socket, once there is one."""
    until = time.monotonic() + 60.0
    while True:
        with contextlib.suppress(OSError, IndexError, StopIteration, ValueError):
            port = active.read_text().split()[0]
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/json", timeout=10.0) as answer:
                tabs = json.load(answer)
            address: str = next(tab["webSocketDebuggerUrl"] for tab in tabs if tab["type"] == "page")
            return address
        assert time.monotonic() < until, "the browser did not start"
        time.sleep(0.1)
