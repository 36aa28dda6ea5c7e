"""The documentation's picture of `asterism serve --web`, and what its page asks for.

`python -m tests.page_picture OUT.png` serves the demo rig, opens the page in a headless Chromium, waits until frames
have come for a while, and takes a picture.
"""

import sys
import tempfile
from pathlib import Path
from urllib.parse import urlsplit

from asterism.server.service.loopback import free_port
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.browser import Browser
from tests.servers import free_endpoint, running, wait_for_line

RATE_HZ = 5  # a browser that draws without a graphics card is slow


def main(out: Path, seconds: float = 60.0) -> None:
    """Take the picture."""
    port = free_port()
    options = ("--rate", str(RATE_HZ), "--web", str(port), "--listen", free_endpoint())
    with tempfile.TemporaryDirectory() as folder, running("serve", DEMO_RIG, "sim", *options) as server:
        wait_for_line(server, "serving")
        with Browser(f"http://127.0.0.1:{port}", Path(folder)) as page:
            page.wait_for_request("ReadMessages")
            page.look_on(seconds)
            out.write_bytes(page.screenshot())
    for address in sorted({urlsplit(address).netloc for address in page.requested if address.startswith("http")}):
        print("asked for:", address)
    for said in sorted(set(page.refused)):
        print("refused:", said)


if __name__ == "__main__":
    main(Path(sys.argv[1]), *map(float, sys.argv[2:]))
