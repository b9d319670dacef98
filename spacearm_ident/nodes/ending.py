"""SIGINT and SIGTERM, from a node's first import to the last destructor of its process.

`ros2 launch` sends SIGINT to a node that the terminal's Ctrl-C has reached already, and people press it twice. Python's
own handlers would make of a signal that comes during the imports a traceback, and of one that comes while the
interpreter is taken down, after Python has put the default handlers back, the process's death (exit code -2). So
handlers are there before ROS is imported, and nothing is heard any more once the node has ended in order.
"""

from __future__ import annotations

import signal
import threading
from typing import Final

_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)
_ASKED: Final = threading.Event()


def heed_signals() -> threading.Event:
    """Have SIGINT and SIGTERM set an event, always the same one, and do nothing else; call it in the main thread."""
    for number in _SIGNALS:
        signal.signal(number, lambda *_: _ASKED.set())
    return _ASKED


def ignore_signals() -> None:
    """Ignore SIGINT and SIGTERM until the process is gone; an ignored signal stays ignored as Python ends."""
    for number in _SIGNALS:
        signal.signal(number, signal.SIG_IGN)
