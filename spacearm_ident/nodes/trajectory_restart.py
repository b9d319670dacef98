"""What a run plays, and beginning it again after a stop that nobody has to see to.

That is one by a machine too busy for the driver's cycle.
Whether a stop is of that kind the driver alone decides: it is asked to recover and enable by `/driver/resume`, which
it refuses after anything else (`driver.resume`). Nothing here blocks: the node's timer steps it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from std_srvs.srv import Trigger

from ..errors import UserError
from ..excitation.trajectory import Trajectory
from ..excitation.trajectory_file import load_trajectory
from .runtime import Level, LiveNode

RESUMED_S: Final = 30.0
"""Longest wait for the driver's answer: it brings the arm to rest, boots drives that went astray, enables them."""
FOUND_S: Final = 3.0
"""Longest wait for the service to be there; a driver that spoke on the graph before the stop is known already."""
BEGUN_S: Final = 10.0
"""Longest wait until a run begins once the drives are enabled: their word and the arm's rest are heard by then."""


@dataclass(frozen=True)
class Started:
    """What `/excitation/start` began, as it was then: what is begun again is the same.

    Attributes:
        file: Where it was read from.
        excitation: What was in it.
    """

    file: str
    excitation: Trajectory

    @classmethod
    def read(cls, file: str) -> Started:
        """What is in a file.

        Raises:
            UserError: None is named, or it cannot be read.
        """
        if not file:
            raise UserError("no trajectory: set the parameter trajectory_file to an excitation file, then start")
        return cls(file, load_trajectory(Path(file).expanduser()))


class Restart:
    """One attempt to begin again.

    Args:
        node: Whose client it is.
        begin: Begins the run; raises `UserError` where it cannot (yet).
    """

    def __init__(self, node: LiveNode, begin: Callable[[], object]) -> None:
        self._node, self._begin = node, begin
        self._client = node.create_client(Trigger, "driver/resume")
        self._future: Any = None
        self._resumed = False
        self._since = time.monotonic()

    def step(self) -> bool:
        """Go on; returns whether the run has begun.

        Raises:
            UserError: It will not: why.
        """
        waited = time.monotonic() - self._since
        if not self._resumed:
            self._ask(waited)
            return False
        try:
            self._begin()
        except UserError:
            if waited > BEGUN_S:
                raise
            return False
        return True

    def close(self) -> None:
        """Forget it."""
        self._node.destroy_client(self._client)

    def _ask(self, waited: float) -> None:
        if self._future is None:
            if self._client.service_is_ready():
                self._future = self._client.call_async(Trigger.Request())
            elif waited > FOUND_S:
                raise UserError(f"there is no {self._client.srv_name}")
        elif self._future.done():
            reply = self._future.result()
            if not reply.success:
                raise UserError(reply.message)
            self._node.log(Level.OK, reply.message)
            self._resumed, self._since = True, time.monotonic()
            return
        if waited > RESUMED_S:
            raise UserError(f"no answer from {self._client.srv_name} within {RESUMED_S:.0f} s")
