"""A subscriber with plain zenoh and the Foxglove schema only: what a stranger's program would be.

    python tests/service/plain_subscriber.py ENDPOINT OUT.jsonl [KEY-EXPRESSION]

Prints `ready` once subscribed, writes one JSON line a message (key, encoding, receipt time, payload in base64, and
the pose of odometry messages), and ends when the server's liveliness token goes, or on a line on its input.
"""

import base64
import json
import select
import sys
import threading
import time
from pathlib import Path

import zenoh
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry

endpoint, out = sys.argv[1:3]
expression = sys.argv[3] if len(sys.argv) > 3 else "asterism/**"
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps([endpoint]))
config.insert_json5("scouting/multicast/enabled", "false")
session = zenoh.open(config)
gone = threading.Event()
received: list[tuple[int, str, str, bytes]] = []


def receive(sample: zenoh.Sample) -> None:
    received.append((time.time_ns(), str(sample.key_expr), str(sample.encoding), sample.payload.to_bytes()))


def liveliness(sample: zenoh.Sample) -> None:
    if sample.kind == zenoh.SampleKind.DELETE:
        gone.set()


subscriber = session.declare_subscriber(expression, receive)
alive = session.liveliness().declare_subscriber("**/alive", liveliness, history=True)
print("ready", flush=True)
while not gone.wait(0.1):
    if select.select([sys.stdin], [], [], 0)[0]:
        break
time.sleep(0.3)  # what was sent before the token went may still be under way
with Path(out).open("w") as file:
    for received_ns, key, encoding, payload in received:
        entry = {
            "received_ns": received_ns,
            "key": key,
            "encoding": encoding,
            "payload": base64.b64encode(payload).decode(),
        }
        if encoding == "application/protobuf;foxglove.Odometry":
            message = Odometry()
            message.ParseFromString(payload)
            p, q = message.pose.position, message.pose.orientation
            entry |= {
                "robot": message.body_frame_id,
                "frame_id": message.frame_id,
                "exposed_ns": message.timestamp.seconds * 10**9 + message.timestamp.nanos,
                "position": [p.x, p.y, p.z],
                "orientation": [q.x, q.y, q.z, q.w],
                "metadata": {pair.key: pair.value for pair in message.metadata},
            }
        file.write(json.dumps(entry) + "\n")
session.close()
