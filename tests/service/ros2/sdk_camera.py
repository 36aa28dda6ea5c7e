"""A camera's node of ROS 2 that nobody here wrote (PyPI zenoh-ros2-sdk): images of a folder, and its calibration.

Arguments: port, domain, topic, folder, focal length it tells, px, JSON of the definitions of Image and CameraInfo. It
says `ready` once somebody subscribes to the topic, as lazy drivers do, then publishes an image for every line.
"""

import json
import sys
import time
from pathlib import Path

import cv2
import numpy as np
from rosbags.typesys import Stores, get_typestore
from zenoh_ros2_sdk import ROS2Publisher, get_topic_info
from zenoh_ros2_sdk.session import ZenohSession

TYPES = get_typestore(Stores.ROS2_JAZZY).types


def main() -> None:
    port, domain, topic = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
    focal = float(sys.argv[5])
    files = sorted(Path(sys.argv[4]).glob("*.png"))
    publishers = {
        kind: ROS2Publisher(where, kind, definition, domain_id=domain, router_port=port, type_hash=told_hash)
        for where, kind, told_hash, definition in (
            (topic, *json.loads(sys.argv[6])["Image"]),
            (f"{topic.rpartition('/')[0]}/camera_info", *json.loads(sys.argv[6])["CameraInfo"]),
        )
    }
    image_to, info_to = publishers.values()
    while get_topic_info(topic, domain_id=domain, router_port=port).subscriber_count == 0:
        time.sleep(0.1)
    print("ready", flush=True)
    for number, _ in enumerate(sys.stdin):
        image = cv2.imread(str(files[number % len(files)]), cv2.IMREAD_UNCHANGED)
        height, width = image.shape
        stamp = TYPES["builtin_interfaces/msg/Time"](*divmod(time.time_ns(), 10**9))
        header = TYPES["std_msgs/msg/Header"](stamp, "camera_optical_frame")
        matrix = np.array([focal, 0.0, width / 2, 0.0, focal, height / 2, 0.0, 0.0, 1.0])
        info_to.publish(
            header=header,
            height=height,
            width=width,
            distortion_model="plumb_bob",
            d=np.zeros(5),
            k=matrix,
            r=np.eye(3).ravel(),
            p=np.zeros(12),
            binning_x=0,
            binning_y=0,
            roi=TYPES["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False),
        )
        image_to.publish(
            header=header,
            height=height,
            width=width,
            encoding="mono8",
            is_bigendian=0,
            step=width,
            data=image.ravel(),
        )
        print(number, flush=True)
    for publisher in publishers.values():
        publisher.close()
    ZenohSession.get_instance().close()


if __name__ == "__main__":
    main()
