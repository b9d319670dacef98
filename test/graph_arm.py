"""A program that plays a small arm's recordings to the graph, with the trajectory node's words around them.

Reads commands from standard input and answers each with `ok` when it is done:
`run NAME BAG [stopped]` (states and samples), `play BAG` (samples only), `say TEXT` (a raw /excitation/state).

    python graph_arm.py [best_effort]
"""

from __future__ import annotations

import json
import sys
import time

import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from spacearm_ident.recording.bag import read_bag
from spacearm_ident.recording.messages import DESCRIPTION_TOPIC, STATES_TOPIC, TOPIC_TYPES

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
PER_SECOND = 2000.0
SETTLE_S = 0.3
"""Topics are not ordered among each other: what must come before something else gets this much time."""


class Player:
    def __init__(self) -> None:
        rclpy.init()
        self.node = rclpy.create_node("small_arm")
        self.description = self.node.create_publisher(String, DESCRIPTION_TOPIC, LATCHED)
        offered = QoSProfile(depth=1000)
        if "best_effort" in sys.argv:
            offered.reliability = ReliabilityPolicy.BEST_EFFORT
        self.states = self.node.create_publisher(JointState, STATES_TOPIC, offered)
        self.excitation = self.node.create_publisher(String, "/excitation/state", LATCHED)
        while not self.states.get_subscription_count():
            time.sleep(0.02)
        time.sleep(SETTLE_S)

    def say(self, text: str) -> None:
        self.excitation.publish(String(data=text))
        time.sleep(SETTLE_S)

    def play(self, bag: str) -> None:
        streams = read_bag(bag, {topic: kind.name for topic, kind in TOPIC_TYPES.items()}.get).streams
        for payload in streams[DESCRIPTION_TOPIC].payloads[:1] if DESCRIPTION_TOPIC in streams else ():
            self.description.publish(payload)
        start = time.monotonic()
        for number, payload in enumerate(streams[STATES_TOPIC].payloads):
            wait = start + number / PER_SECOND - time.monotonic()
            if wait > 0:
                time.sleep(wait)
            self.states.publish(payload)
        time.sleep(SETTLE_S)

    def run(self, name: str, bag: str, ending: str = "") -> None:
        complete = ending != "stopped"
        self.say(json.dumps({"state": "approach", "run": name, "complete": None}))
        self.say(json.dumps({"state": "running", "run": name, "complete": None}))
        self.play(bag)
        if not complete:
            self.say(json.dumps({"state": "stopping", "run": name, "complete": False}))
        self.say(json.dumps({"state": "done", "run": name, "complete": complete}))


def main() -> None:
    player = Player()
    for line in sys.stdin:
        command, _, rest = line.strip().partition(" ")
        match command:
            case "run":
                player.run(*rest.split())
            case "play":
                player.play(rest)
            case "say":
                player.say(rest)
        print("ok", flush=True)
    rclpy.shutdown()


if __name__ == "__main__":
    main()
