"""From a camera's node to a robot's, through a server: both are clients that nobody here wrote."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np

from asterism.protocol.rig import load_rig
from asterism.protocol.ros2 import types
from asterism.server.__main__ import main
from asterism.server.simulation.demo_rig import DEMO_RIG
from tests.clients.serving import until
from tests.protocol.ros2.ros_store import STORE
from tests.servers import TIMEOUT_S, free_endpoint, running, wait_for_line
from tests.service.ros2.independent import SdkNode, need_sdk

DOMAIN, TOPIC, FRAMES = 3, "/front/image_raw", 3


class SdkCamera:
    """sdk_camera.py in a process of its own."""

    def __init__(self, endpoint: str, folder: Path, focal_px: float) -> None:
        told = {
            kind.name: (kind.ros, kind.hash, STORE.generate_msgdef(kind.ros, ros_version=2)[0])
            for kind in (types.IMAGE, types.CAMERA_INFO)
        }
        arguments = [endpoint.rpartition(":")[2], DOMAIN, TOPIC, folder, focal_px, json.dumps(told)]
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.service.ros2.sdk_camera", *map(str, arguments)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == "ready\n"

    def take(self) -> bool:
        """One more image."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write("now\n")
        self._process.stdin.flush()
        return bool(self._process.stdout.readline())

    def close(self) -> None:
        self._process.communicate(timeout=60)


def test_from_a_cameras_node_to_a_robots(tmp_path: Path) -> None:
    need_sdk()
    assert main(["simulate", str(DEMO_RIG), str(tmp_path / "sim"), "--frames", str(FRAMES), "--seed", "4"]) == 0
    rig, endpoint = load_rig(tmp_path / "sim" / "rig.yaml"), free_endpoint()
    truth = [json.loads(line) for line in (tmp_path / "sim" / "truth.jsonl").read_text().splitlines()]
    options = ["--ros2", "--ros-domain", str(DOMAIN), "--ros-namespace", "lab", "--listen", endpoint]
    with running("serve", tmp_path / "sim" / "rig.yaml", f"ros2:{TOPIC}", *options) as server:
        wait_for_line(server, "serving 5 robots")
        odom = {f"/lab/{robot.id}/odom": types.ODOMETRY for robot in rig.robots}
        node = SdkNode(endpoint, DOMAIN, {**odom, "/tf_static": types.TF_MESSAGE}, late=("/tf_static",))
        camera = SdkCamera(endpoint, tmp_path / "sim" / "frames", 1.01 * rig.camera.focal_px)
        until(lambda: camera.take() and min(node.counts()[topic] for topic in odom) >= FRAMES, TIMEOUT_S)
        told = wait_for_line(server, "camera_info: its calibration is not the rig's")
        camera.close()
        received = node.finish()["received"]
        server.terminate()
        assert server.wait(timeout=60) == 0
    assert f"fx {1.01 * rig.camera.focal_px:.6g} instead of {rig.camera.matrix[0, 0]:.6g}" in told
    for robot in rig.robots:
        seen = [one["position"] for frame in truth for one in frame["robots"] if one["id"] == robot.id]
        for message in received[f"/lab/{robot.id}/odom"]:
            at = message["pose"]["pose"]["position"]
            off = np.linalg.norm(np.array(seen) - [at["x"], at["y"], at["z"]], axis=1)
            assert off.min() < 0.01
            assert message["header"]["frame_id"] == rig.parent_frame
            assert message["twist"]["covariance"][0] == 1e6  # nobody smooths
    children = [one["child_frame_id"] for one in received["/tf_static"][0]["transforms"]]
    assert children[0] == rig.camera.name
