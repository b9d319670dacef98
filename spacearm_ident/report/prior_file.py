"""A result folder as a prior: `model.yaml` is the mean, the covariance lies beside it in `result.npz`."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import numpy as np

from ..dynamics.model_file import load_model
from ..errors import UserError
from ..identification.from_prior import GroundPrior
from .store import ARRAYS, FIGURES, MODEL, checksum

ADVICE = "give the model.yaml in a result folder of 'spacearm identify'"


def load_prior(path: Path) -> GroundPrior:
    """The model of a result folder with its covariance.

    Args:
        path: `model.yaml` of a result folder, or the folder.

    Raises:
        UserError: No model, no covariance beside it, or that of another model.
    """
    file = path / MODEL if path.is_dir() else path
    model = load_model(file)
    folder = file.parent
    try:
        sums = json.loads((folder / FIGURES).read_text(encoding="utf-8"))["sha256"]
        with np.load(folder / ARRAYS, allow_pickle=False) as arrays:
            covariance = np.asarray(arrays["covariance"], dtype=np.float64)
    except OSError as error:
        missing = Path(error.filename or folder / ARRAYS).name
        raise UserError(f"{file} has no covariance beside it ({missing}), a prior needs one: {ADVICE}") from error
    except (KeyError, TypeError, ValueError, zipfile.BadZipFile) as error:
        raise UserError(f"the covariance beside {file} cannot be read: {ADVICE}, or identify again") from error
    if sums.get(MODEL) != checksum(file) or sums.get(ARRAYS) != checksum(folder / ARRAYS):
        raise UserError(f"{file} is not the model that the covariance beside it was written with: {ADVICE}")
    prior = GroundPrior(model, covariance, f"{file} (SHA-256 {sums[MODEL][:12]})")
    if covariance.shape != (len(prior.names),) * 2 or not np.isfinite(covariance).all():
        raise UserError(f"the covariance beside {file} does not fit it: identify again")
    return prior
