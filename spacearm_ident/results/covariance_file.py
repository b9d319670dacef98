"""`covariance.json`: how well the determined combinations are known together, for robust control.

A controller that shall hold for every arm the data allow draws from, or bounds, a Gaussian over what the data
determine: the base parameters (before physical consistency is imposed) and the nonlinear constants that are there.
The base-parameter map says what each is in the parameters of `model.yaml`, whose own values are given beside.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..estimate.identified import Identified

SCHEMA = "spacearm_ident/covariance/1"


def covariance_dict(identified: Identified) -> dict[str, Any]:
    """The content of `covariance.json`.

    Returns:
        `unknowns` (name, unit, kind `base` or `constant`), their `mean` (u,), `covariance` (u, u) in products of
        these units, `model` (u,) the physically consistent values of `model.yaml`, and `map`: base parameter ->
        parameter -> coefficient.
    """
    model, base = identified.model.model, identified.base
    count = len(model.parameters)
    whole = np.zeros((len(base.independent) + len(model.constants), len(identified.covariance)))
    whole[: len(base.independent), :count] = base.regrouping
    whole[len(base.independent) :, count:] = np.eye(len(model.constants))
    covariance = whole @ identified.covariance @ whole.T
    # Held parameters and constants that are absent have no spread: they are no unknowns.
    kept = np.flatnonzero(np.diag(covariance) > 0)
    leaders = [model.parameters[number] for number in base.independent]
    unknowns = [{"name": name, "unit": item.unit, "kind": "base"} for name, item in zip(base.names, leaders)]
    unknowns += [{"name": item.name, "unit": item.unit, "kind": "constant"} for item in model.constants]
    mean = np.concatenate([identified.base_values, identified.model.constants])
    consistent = np.concatenate([base.regrouping @ identified.model.parameters, identified.model.constants])
    block = covariance[np.ix_(kept, kept)]
    return {
        "schema": SCHEMA,
        "unknowns": [unknowns[k] for k in kept],
        "mean": mean[kept].tolist(),
        "model": consistent[kept].tolist(),
        "covariance": ((block + block.T) / 2).tolist(),
        "map": {
            base.names[k]: {
                model.parameters[n].name: float(base.regrouping[k, n]) for n in np.flatnonzero(base.regrouping[k])
            }
            for k in kept
            if k < len(base.names)
        },
    }
