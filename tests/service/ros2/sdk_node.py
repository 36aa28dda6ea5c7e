"""A node of ROS 2 that nobody here wrote (PyPI zenoh-ros2-sdk), in a process of its own: what it receives, and sees.

Arguments: port, domain, JSON of [[topic, type, hash, definition, whether late joiners get what was], ...]. It says
`ready`, tells for every line that comes in how many messages it has of each topic, and at the end of its input prints
one line of JSON: `received`, by topic, and `seen`, topics with the types that it finds by their tokens.
"""

import json
import sys
from dataclasses import asdict, is_dataclass
from typing import Any

import numpy as np
from zenoh_ros2_sdk import ROS2Subscriber, get_topic_names_and_types
from zenoh_ros2_sdk.qos import QosDurability, QosProfile
from zenoh_ros2_sdk.session import ZenohSession


def plain(value: Any) -> Any:
    """As JSON has it."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, list):
        return [plain(one) for one in value]
    if isinstance(value, dict):
        return {key: plain(one) for key, one in value.items()}
    return plain(asdict(value)) if is_dataclass(value) and not isinstance(value, type) else value


def main() -> None:
    port, domain = int(sys.argv[1]), int(sys.argv[2])
    received: dict[str, list[Any]] = {}
    subscribers = []
    for topic, kind, told_hash, definition, late in json.loads(sys.argv[3]):
        quality = QosProfile(durability=QosDurability.TRANSIENT_LOCAL) if late else QosProfile()
        taken = received.setdefault(topic, [])
        subscribers.append(
            ROS2Subscriber(
                topic,
                kind,
                taken.append,
                msg_definition=definition,
                domain_id=domain,
                router_port=port,
                type_hash=told_hash,
                qos=quality,
            )
        )
    print("ready", flush=True)
    for _ in sys.stdin:
        print(json.dumps({topic: len(taken) for topic, taken in received.items()}), flush=True)
    seen = get_topic_names_and_types(domain_id=domain, router_port=port, timeout=2.0)
    print(json.dumps({"received": {topic: plain(taken) for topic, taken in received.items()}, "seen": seen}))
    for subscriber in subscribers:
        subscriber.close()
    ZenohSession.get_instance().close()


if __name__ == "__main__":
    main()
