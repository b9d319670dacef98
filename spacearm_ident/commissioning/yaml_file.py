"""A YAML file as plain data, and its places that are still to be filled in."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from ..errors import UserError
from .result import CheckResult, fail


def read_yaml(path: Path) -> Mapping[str, Any]:
    """The mapping a YAML file holds.

    Raises:
        UserError: Unreadable, not YAML, or no mapping.
    """
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"cannot read {path}: {error}") from error
    except yaml.YAMLError as error:
        raise UserError(f"{path} is not valid YAML: {' '.join(str(error).split())}") from error
    if not isinstance(data, dict):
        raise UserError(f"{path} holds no 'key: value' pairs")
    return data


def empty_keys(data: Mapping[str, Any]) -> dict[str, list[str]]:
    """Key -> the joints (of the key `joints`) where it has no value."""
    found: dict[str, list[str]] = {}
    for joint, key in _empty_places(data):
        found.setdefault(key, []).append(joint)
    return found


def to_fill_in(subject: str, path: Path, data: Mapping[str, Any], empty: Mapping[str, list[str]]) -> CheckResult:
    """The failed check of a file in which values are still empty.

    Args:
        subject: What was checked.
        path: The file.
        data: Its contents, with the key `joints`.
        empty: Key -> joints where it has no value, as from `empty_keys`.
    """
    count = len(data["joints"])
    listed = "; ".join(
        f"{key} of {'every joint' if len(joints) == count else ', '.join(joints)}" for key, joints in empty.items()
    )
    return fail(subject, f"{sum(map(len, empty.values()))} values are still empty: {listed}", f"give them in {path}")


def _empty_places(data: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    joints = data.get("joints")
    for joint, keys in joints.items() if isinstance(joints, dict) else ():
        for key, value in keys.items() if isinstance(keys, dict) else ():
            if value is None:
                yield str(joint), str(key)
