"""What nodes of ROS 2 get: the right fields of every message, also late joiners, on topics that they find."""

from dataclasses import replace
from typing import Any

import numpy as np
import zenoh
import zenoh.ext

from asterism.protocol import asterism_pb2 as pb
from asterism.protocol.codec import to_bytes
from asterism.protocol.messages import STATUS, Message
from asterism.protocol.network import client_config
from asterism.protocol.ros2 import types
from asterism.protocol.ros2.names import RosPlace
from asterism.protocol.ros2.wire import topic_key
from tests.clients.serving import until
from tests.protocol.make_golden import RIG
from tests.protocol.ros2.ros_store import in_ros
from tests.servers import TIMEOUT_S
from tests.service.ros2.independent import (
    FRAME,
    SdkNode,
    frame_of,
    need_sdk,
    pose,
    telling,
    wait_until_it_listens,
)
from tests.service.ros2.received import DYNAMIC, TOPICS, check_received

COUNT = 50  # 1000 in python -m tests.measure.ros2
TOGETHER = 5  # frames without a pause: more than a camera makes, less than the short queue drops


def test_a_node_receives_everything(rng: np.random.Generator) -> None:
    need_sdk()
    told = [pose(number, rng) for number in range(COUNT)]
    with telling(RosPlace(7, "/lab")) as (endpoint, outlet, _):
        node = SdkNode(endpoint, 7, TOPICS, late=("/tf_static",))
        wait_until_it_listens(node, outlet, [pose(-1, rng)])
        before = node.counts()
        for sent, one in enumerate(told, start=1):
            outlet.write(frame_of([one]), FRAME)
            if sent % TOGETHER == 0:
                until(lambda n=sent: all(node.counts()[topic] >= before[topic] + n for topic in DYNAMIC), TIMEOUT_S)
        status = pb.Status(time_ns=5, rate_hz=60.0, problem="the disk is full")
        outlet.between([Message("asterism/cam/status", STATUS, to_bytes(status), 5, 5, 0)])
        until(lambda: node.counts()["/diagnostics"], TIMEOUT_S)
        found = node.finish()
    check_received(found["received"], told)
    assert {topic: [kind.ros] for topic, kind in TOPICS.items()}.items() <= dict(found["seen"]).items()


def test_another_rig_has_other_topics_and_transforms(rng: np.random.Generator) -> None:
    (alpha,) = RIG.robots
    bravo = replace(alpha, id="bravo", points={"nose": np.array([0.1, 0.0, 0.0])})
    place = RosPlace(0, "")
    with telling(place) as (endpoint, outlet, _), zenoh.open(client_config(endpoint)) as node:
        # Its camera is followed, and ROS has no name for one of its robots.
        outlet.take_rig(replace(RIG, follows_world=True, robots=(bravo, replace(alpha, id="never-mind"))))
        heard: dict[str, Any] = {}

        def hear(sample: zenoh.Sample) -> None:
            topic, kind = str(sample.key_expr).split("/", 1)[1].rsplit("/", 2)[:2]
            told = next(one for one in TOPICS.values() if one.dds == kind)
            heard[topic] = in_ros(sample.payload.to_bytes(), told.ros)

        def all_heard() -> bool:
            poses = [pose(0, rng, "bravo"), pose(0, rng, "never-mind")]
            outlet.write(frame_of(poses, RIG.T_world_camera), FRAME)
            return {"bravo/odom", "bravo/pose", "tf", "tf_static"} <= heard.keys()

        late = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1)
        static = topic_key(place.domain, "/tf_static", types.TF_MESSAGE)
        with (
            node.declare_subscriber("0/**", hear),
            zenoh.ext.declare_advanced_subscriber(node, static, hear, history=late),
        ):
            until(all_heard)
        replies = node.liveliness().get("@ros2_lv/0/*/*/*/MP/**")
        seen = {str(reply.ok.key_expr).split("/")[9] for reply in replies if reply.ok is not None}
    assert heard["bravo/odom"].child_frame_id == "bravo"
    assert [one.child_frame_id for one in heard["tf"].transforms] == ["bravo", "never-mind", "cam"]
    children = [one.child_frame_id for one in heard["tf_static"].transforms]
    assert children == ["bravo/nose", "never-mind/tool"]
    assert seen == {"%bravo%pose", "%bravo%odom", "%tf", "%tf_static", "%diagnostics"}
