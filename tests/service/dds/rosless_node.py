"""A node of ROS 2 over DDS that nobody here wrote (PyPI rosless), in a process of its own: what it receives.

Arguments: domain, JSON of [[topic, type, whether late joiners get what was], ...]. It says `ready` when it has found
every topic, tells for every line that comes in how many messages it has of each, and at the end of its input prints one
line of JSON: messages by topic.
"""

import json
import sys
import threading
from typing import Any

import rosless

DEEP = 5000  # messages kept until they are read


def plain(value: Any) -> Any:
    """As JSON has it."""
    if isinstance(value, rosless.Message):
        return {name: plain(one) for name, one in value.to_dict().items()}
    if isinstance(value, dict):
        return {name: plain(one) for name, one in value.items()}
    if isinstance(value, bytes):
        return list(value)
    return [plain(one) for one in value] if isinstance(value, list | tuple) else value


def take(subscription: Any, into: list[Any], ended: threading.Event) -> None:
    """Everything that comes, until it is to end."""
    while not ended.is_set():
        if (message := subscription.read(timeout=0.1)) is not None:
            into.append(plain(message))


def main() -> None:
    node, ended = rosless.Node(int(sys.argv[1])), threading.Event()
    received: dict[str, list[Any]] = {}
    threads = []
    for topic, kind, late in json.loads(sys.argv[2]):
        durability = "transient_local" if late else "volatile"
        subscription = node.subscribe(topic, kind, reliability="reliable", durability=durability, depth=DEEP)
        arguments = (subscription, received.setdefault(topic, []), ended)
        threads.append(threading.Thread(target=take, args=arguments))
        threads[-1].start()
    print("ready", flush=True)
    for _ in sys.stdin:
        print(json.dumps({topic: len(messages) for topic, messages in received.items()}), flush=True)
    ended.set()
    for thread in threads:
        thread.join()
    print(json.dumps(received))


if __name__ == "__main__":
    main()
