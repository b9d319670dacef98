"""What `spacearm mismatch` says of the recordings in ../shared: one table, as it says it.

    python bench/verdicts.py [--recordings DIR] [--out DIR]

The sealed recordings hide something that nobody here knows; their reference is the commissioning run of the same arm.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

CALL = "import sys; from spacearm_ident.cli.main import main; sys.exit(main())"


def cases(root: Path) -> list[tuple[str, list[Path], Path, list[Path]]]:
    """Name, references, field recording and recordings to judge on."""
    found = []
    for folder in sorted((root / "sealed").iterdir()):
        if folder.is_dir():
            arm = ElementTree.parse(folder / "arm.urdf").getroot().get("name")
            reference = [root / "sealed" / f"commissioning_{arm}.mcap"]
            found.append(
                (f"sealed/{folder.name}", reference, folder / "field.mcap", [folder / "field_validation.mcap"])
            )
    ur10e, tx40 = root / "real" / "ur10e", root / "real" / "tx40"
    healthy = [ur10e / "commissioning.mcap", ur10e / "commissioning_2.mcap"]
    found.append(("real/ur10e", healthy, ur10e / "field.mcap", [ur10e / "field_validation.mcap"]))
    found.append(("real/tx40", [], tx40 / "excitation.mcap", []))
    return found


def explain(reference: list[Path], field: Path, judged: list[Path], out: Path) -> dict[str, Any]:
    """The tool's answer, in a process of its own."""
    words = [str(field), "--out", str(out), "--json", "--quiet"]
    for option, paths in (("--reference", reference), ("--validate", judged)):
        for path in paths:
            words += [option, str(path)]
    done = subprocess.run([sys.executable, "-c", CALL, "mismatch", *words], capture_output=True, text=True, check=False)
    if done.returncode not in (0, 1):
        raise SystemExit(done.stderr)
    answer: dict[str, Any] = json.loads(done.stdout)
    return answer


def row(name: str, answer: dict[str, Any]) -> str:
    """One line of the table."""
    findings = []
    for finding in answer["findings"]:
        values = [
            f"{key} {value['value']:.3g} {value['unit']}" for key, value in list(finding["parameters"].items())[:3]
        ]
        explained = finding["validation"]["explained_fraction"]
        share = "" if explained is None else f", explains {100 * explained:.0f} %"
        twins = [a["effect"] for a in finding["alternatives"] if a["score"] > 0.97 and a["effect"] != finding["effect"]]
        beside = f"; as well: {', '.join(twins)}" if twins else ""
        where = ", ".join(joint.removeprefix("joint_") for joint in finding["joints"])
        findings.append(
            f"`{finding['effect']}` at {where} ({'; '.join(values) or finding['where']}{share}; "
            f"confidence {finding['confidence']:.2f}{beside})"
        )
    left = ", ".join(f"{u['joints'][0].removeprefix('joint_')}" for u in answer["unexplained"])
    return f"| {name} | {answer['verdict']} | {'<br>'.join(findings) or '–'} | {left or '–'} |"


def main() -> None:
    """Run all, print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recordings", type=Path, default=Path("../shared/recordings"))
    parser.add_argument("--out", type=Path, help="keep the result folders here")
    options = parser.parse_args()
    print("| recording | verdict | findings, largest first | residual left at |\n|---|---|---|---|")
    with TemporaryDirectory() as scratch:
        for name, reference, field, judged in cases(options.recordings):
            out = (options.out or Path(scratch)) / name.replace("/", "_")
            print(row(name, explain(reference, field, judged, out)), flush=True)


if __name__ == "__main__":
    main()
