"""Images from the network: what is lost, how long they take, and how right their times are, between two processes.

    python -m tests.measure.network_images [SECONDS] [HZ]

The camera's clock is an hour behind and runs 100 ppm too fast; every image carries the true time in its first pixels.
"""

import json
import subprocess
import sys
import threading
import time

import numpy as np
import zenoh
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from asterism.protocol.network import open_server
from asterism.server.sources.foreign.network import RAW, NetworkImages
from tests.servers import free_endpoint

WIDTH, HEIGHT, KEY = 1280, 1024, "cell/camera"
BEHIND_S, FAST = 3600.0, 1e-4
SETTLED_S = 15.0  # of the stamps


def publish(endpoint: str, seconds: float, rate_hz: float) -> None:
    """In a process of its own, with zenoh and Foxglove's schema only."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    image = np.random.default_rng(0).integers(0, 30, (HEIGHT, WIDTH)).astype(np.uint8)
    with zenoh.open(config) as session:
        publisher = session.declare_publisher(KEY, encoding=zenoh.Encoding(RAW))
        begin_ns, wall_ns = time.monotonic_ns(), time.time_ns()
        for k in range(round(seconds * rate_hz)):
            time.sleep(max(begin_ns + k * 1e9 / rate_hz - time.monotonic_ns(), 0.0) * 1e-9)
            now_ns = time.monotonic_ns()
            image.reshape(-1)[:8] = np.frombuffer(now_ns.to_bytes(8, "little"), np.uint8)
            message = RawImage(width=WIDTH, height=HEIGHT, step=WIDTH, encoding="mono8", data=image.tobytes())
            message.timestamp.FromNanoseconds(
                wall_ns - round(BEHIND_S * 1e9) + round((now_ns - begin_ns) * (1.0 + FAST))
            )
            publisher.put(message.SerializeToString())
        time.sleep(1.0)


def measure(seconds: float, rate_hz: float) -> None:
    """Take them as a server does, and print what they were worth."""
    endpoint = free_endpoint()
    with open_server(endpoint) as session:
        source = NetworkImages(KEY, None, print)
        source.join(session, listens=True)
        command = [
            sys.executable,
            "-m",
            "tests.measure.network_images",
            "publish",
            endpoint,
            str(seconds),
            str(rate_hz),
        ]
        camera = subprocess.Popen(command)
        threading.Thread(target=lambda: (camera.wait(), source.close())).start()
        errors_ms, delays_ms, since_s = [], [], []
        for frame in source.frames():
            here_ns = source.clock.now_ns(frame.session)
            taken_ns = source.clock.at_ns(
                int.from_bytes(frame.image.reshape(-1)[:8].tobytes(), "little"), frame.session
            )
            errors_ms.append((frame.exposed_ns - taken_ns) * 1e-6)
            delays_ms.append((here_ns - taken_ns) * 1e-6)
            since_s.append((taken_ns - source.clock.started_ns) * 1e-9)
    sent = round(seconds * rate_hz)
    settled = np.array(errors_ms)[np.array(since_s) > since_s[0] + SETTLED_S]
    print(f"{WIDTH}x{HEIGHT} at {rate_hz:g} Hz for {seconds:g} s: {sent} sent, {len(errors_ms)} taken, ", end="")
    print(f"{source.missed} replaced by newer ones, {source.unreadable} unreadable")
    print(f"from put to frame: median {np.median(delays_ms):.2f} ms, 99 % {np.percentile(delays_ms, 99):.2f} ms")
    for name, values in (("all", np.array(errors_ms)), (f"after {SETTLED_S:g} s", settled)):
        if len(values):
            low, middle, high = np.percentile(values, [1, 50, 99])
            print(f"exposed_ns less the truth, {name}: median {middle:+.2f} ms, 1 to 99 % {low:+.2f} to {high:+.2f} ms")


if __name__ == "__main__":
    if sys.argv[1:2] == ["publish"]:
        publish(sys.argv[2], float(sys.argv[3]), float(sys.argv[4]))
    else:
        measure(*(float(word) for word in [*sys.argv[1:3], *["60", "60"][len(sys.argv[1:3]) :]]))
