"""Coverage-guided fuzzing of the readers with atheris, beside the property tests of `test/test_fuzz*.py`.

    pip install atheris==3.0.0
    python bench/fuzz.py {recording,cdr,yaml,urdf} [CORPUS_DIR] [-max_total_time=SECONDS] [other libFuzzer options]

Anything that is raised but `UserError` ends it with the input in a file. Not among the package's dependencies.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["spacearm_ident"]):
    from spacearm_ident.documents import parse_yaml
    from spacearm_ident.dynamics.arm import arm_from_urdf
    from spacearm_ident.errors import UserError
    from spacearm_ident.recording import cdr, read_recording

SCRATCH = Path(tempfile.mkdtemp(prefix="spacearm-fuzz-")) / "bag.mcap"
MAGIC = b"\x89MCAP0\r\n"


def recording(data: bytes) -> None:
    SCRATCH.write_bytes(MAGIC + data)
    read_recording(SCRATCH)


def payloads(data: bytes) -> None:
    size = max(1, data[0] if data else 1)
    cdr.decode_joint_states([data[k : k + size] for k in range(0, len(data), size)])


def document(data: bytes) -> None:
    parse_yaml(data.decode("utf-8", "replace"), "in.yaml")


def urdf(data: bytes) -> None:
    arm_from_urdf(data.decode("utf-8", "replace"))


TARGETS: dict[str, Callable[[bytes], None]] = {
    "recording": recording,
    "cdr": payloads,
    "yaml": document,
    "urdf": urdf,
}


def main() -> None:
    name = sys.argv.pop(1) if len(sys.argv) > 1 else ""
    if name not in TARGETS:
        sys.exit(f"say what to read: {', '.join(TARGETS)}")

    def one(data: bytes) -> None:
        try:
            TARGETS[name](data)
        except UserError as error:
            assert str(error).isprintable()

    atheris.Setup(sys.argv, one)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
