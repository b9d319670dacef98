"""Parameters of the identifier about the arm's surroundings and about scarce data, checked when they are read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..dynamics.model import OVER_TEMPERATURE
from ..environment.gravity import GRAVITY_CHOICES
from ..errors import UserError


def surroundings_of(parameter: Callable[..., Any]) -> dict[str, Any]:
    """Declare and read `temperature`, `estimate_gravity` and `prior`, as `Options` takes them.

    Raises:
        UserError: A value that is none, or a prior that is not there.
    """
    text = parameter("temperature", "", "Friction over temperature: f_c, k_v1, v_b, with commas between; empty: none")
    temperature = tuple(name.strip() for name in text.split(",") if name.strip())
    for name in temperature:
        if name not in OVER_TEMPERATURE:
            raise UserError(f"parameter temperature: no {name!r}: some of {', '.join(OVER_TEMPERATURE)}")
    gravity = parameter("estimate_gravity", "", "Estimate gravity: vector, direction; empty: it is the arm's")
    if gravity and gravity not in GRAVITY_CHOICES:
        raise UserError(f"parameter estimate_gravity: no {gravity!r}: one of {', '.join(GRAVITY_CHOICES)}, or empty")
    prior = parameter("prior", "", "Result folder whose model is updated by the run; empty: none")
    path = Path(prior).expanduser() if prior else None
    if path is not None and not path.exists():
        raise UserError(f"parameter prior: {path}: no such file or folder")
    return {"temperature": temperature, "estimate_gravity": gravity, "prior": path}
