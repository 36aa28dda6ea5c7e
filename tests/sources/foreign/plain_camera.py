"""A camera program of somebody else's: plain zenoh and Foxglove's schemas, nothing of Asterism.

    python tests/sources/foreign/plain_camera.py ENDPOINT KEY FOLDER COUNT HZ [raw|png] [stamp offset, s]

Publishes the images of a folder in order, again and again, COUNT in all, once a line comes on its input.
"""

import json
import sys
import time
from pathlib import Path

import cv2
import zenoh
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

endpoint, key, folder, count, rate = sys.argv[1:6]
kind = sys.argv[6] if len(sys.argv) > 6 else "raw"
apart_s = float(sys.argv[7]) if len(sys.argv) > 7 else 0.0
files = sorted(Path(folder).glob("*.png"))
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps([endpoint]))
config.insert_json5("scouting/multicast/enabled", "false")
session = zenoh.open(config)
print("ready", flush=True)
sys.stdin.readline()
begin = time.monotonic()
for k in range(int(count)):
    file = files[k % len(files)]
    image = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    time.sleep(max(begin + k / float(rate) - time.monotonic(), 0.0))
    if kind == "raw":
        message = RawImage(width=image.shape[1], height=image.shape[0], step=image.shape[1], encoding="mono8")
        message.data = image.tobytes()
    else:
        message = CompressedImage(format="png", data=file.read_bytes())
    message.timestamp.FromNanoseconds(time.time_ns() + round(apart_s * 1e9))
    encoding = zenoh.Encoding(f"application/protobuf;{message.DESCRIPTOR.full_name}")
    session.put(key, message.SerializeToString(), encoding=encoding)
time.sleep(0.3)  # what was sent may still be under way
session.close()
