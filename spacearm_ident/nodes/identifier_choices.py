"""What may be chosen by the identifier's parameters."""

from __future__ import annotations

from typing import Final

from ..dynamics.model import FRICTION_LAWS, OVER_TEMPERATURE
from ..environment.gravity import GRAVITY_CHOICES
from ..sessions.bags import AUTO
from ..solvers.choice import SOLVERS
from .choices import Choices

FRICTION: Final = Choices((AUTO, *FRICTION_LAWS))
SOLVER: Final = Choices(SOLVERS)
TEMPERATURE: Final = Choices(OVER_TEMPERATURE, optional=True, separated=True)
ESTIMATE_GRAVITY: Final = Choices(GRAVITY_CHOICES, optional=True)
