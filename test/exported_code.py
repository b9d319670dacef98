"""What `spacearm export` writes as code, run: C compiled as strict C99, Python modules imported."""

from __future__ import annotations

import ctypes
import importlib.util
import shutil
import subprocess
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from spacearm_ident.dynamics.model import IdentifiedModel
from spacearm_ident.estimate.identified import Validation
from spacearm_ident.export.write import export_model

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2", "-ffp-contract=off", "-shared", "-fPIC")


class Library:
    """The exported C of a model as a shared library."""

    def __init__(self, model: IdentifiedModel, validation: Validation | None, folder: Path) -> None:
        compiler = shutil.which("cc")
        if compiler is None:
            pytest.skip("needs a C compiler (cc)")
        _, files = export_model(model, validation, "c", folder, "a test")
        source = next(file for file in files if file.suffix == ".c")
        words = [compiler, *STRICT, str(source), "-o", str(folder / "arm.so"), "-lm"]
        made = subprocess.run(words, capture_output=True, text=True)
        assert made.returncode == 0, made.stderr
        self._functions, self._prefix = ctypes.CDLL(str(folder / "arm.so")), source.stem

    def call(self, name: str, shape: tuple[int, ...], *arguments: np.ndarray | float) -> np.ndarray:
        """What a function gives for one state."""
        out = np.zeros(shape)
        pointer = ctypes.POINTER(ctypes.c_double)
        kept = [np.ascontiguousarray(one) if isinstance(one, np.ndarray) else ctypes.c_double(one) for one in arguments]
        words = [one.ctypes.data_as(pointer) if isinstance(one, np.ndarray) else one for one in kept]
        getattr(self._functions, f"{self._prefix}_{name}")(*words, out.ctypes.data_as(pointer))
        return out


def module_of(model: IdentifiedModel, validation: Validation | None, form: str, folder: Path) -> ModuleType:
    """The exported Python module of a model, imported."""
    path = folder / f"arm_{form}.py"
    export_model(model, validation, form, path, "a test")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
