"""The plain `canopen` library as the master of simulated drives."""

import struct
import time

from spacearm_ident.canbus.cia402 import State, state_of


def until(condition, seconds=5.0):
    deadline = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.005)
    return found


def reset(network, nmt, nodes, command="RESET"):
    """Reset `nodes` and wait for their boot-up messages (the library's own wait may begin too late)."""
    booted = set()
    for node_id in nodes:
        network.subscribe(0x700 + node_id, lambda can_id, data, _: data == b"\0" and booted.add(can_id & 0x7F))
    nmt.state = command
    until(lambda: booted == set(nodes))


def state(node):
    return state_of(node.sdo[0x6041].raw)


def command(node, *words):
    for word in words:
        node.sdo[0x6040].raw = word


def enable(node):
    command(node, 0x06, 0x07, 0x0F)
    assert state(node) is State.OPERATION_ENABLED


class Stream:
    """SYNC and set-points from the library's own periodic tasks, feedback collected."""

    def __init__(self, network, node, period=0.005):
        self.network, self.node, self.frames = network, node, []
        tpdo, rpdo = node.tpdo[1], node.rpdo[1]
        tpdo.read()
        rpdo.read()
        tpdo.clear()
        for index in (0x6064, 0x6077, 0x6041):
            tpdo.add_variable(index)
        tpdo.trans_type, tpdo.enabled = 1, True
        rpdo.clear()
        rpdo.add_variable(0x607A)
        rpdo.add_variable(0x6040)
        rpdo.trans_type, rpdo.enabled = 1, True
        tpdo.save()
        rpdo.save()
        network.subscribe(0x180 + node.id, lambda _, data, stamp: self.frames.append((stamp, bytes(data))))
        node.sdo[0x60C2][1].raw = round(1e3 * period)
        node.nmt.state = "OPERATIONAL"
        network.sync.start(period)

    def send(self, target, word=0x0F):
        self.network.send_message(0x200 + self.node.id, struct.pack("<iH", target, word))

    def last(self):
        seen = len(self.frames)
        until(lambda: len(self.frames) > seen + 1)
        return struct.unpack("<ihH", self.frames[-1][1])
