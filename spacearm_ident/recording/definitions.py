"""Message definition texts of whatever types are installed, as rosbag2 puts them into a bag (`ros2msg`).

A ROS 2 installation keeps each definition in `share/PACKAGE/msg/NAME.msg`. The text of a type is that file,
then every type it depends on, once each, behind a line of 80 `=` and a line `MSG: PACKAGE/NAME`.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterable
from pathlib import Path

_RULE = "=" * 80
_PRIMITIVES = frozenset(("bool", "byte", "char", "float32", "float64", "string", "wstring")) | {
    f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)
}
# `type name`, the type with an optional array suffix or string bound; constants are of primitive type.
_FIELD = re.compile(r"^\s*([A-Za-z][\w/]*)(?:<=\d+)?(?:\[[^\]]*\])?\s+[A-Za-z]")


def share_folders() -> tuple[Path, ...]:
    """The `share` folders of the ROS 2 installations in use: sourced ones first, then Python's own prefix."""
    prefixes = [*filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)), sys.prefix]
    return tuple(dict.fromkeys(Path(prefix) / "share" for prefix in prefixes))


def definition_text(name: str, shares: Iterable[Path] | None = None) -> str | None:
    """The definition of a message type with all it depends on; None where a file of it is not installed.

    Args:
        name: Full name, `package/msg/Name`.
        shares: Folders to look in; those of `share_folders` unless given.
    """
    folders = tuple(share_folders() if shares is None else shares)
    package, _, short = name.partition("/msg/")
    texts: dict[str, str] = {}
    if not short or not _collect(f"{package}/{short}", folders, texts):
        return None
    first, *others = texts
    return "\n".join([texts[first], *(f"{_RULE}\nMSG: {other}\n{texts[other]}" for other in others)])


def _collect(name: str, folders: tuple[Path, ...], texts: dict[str, str]) -> bool:
    """Add `name` (`package/Name`) and what it depends on to `texts`; False where a file is missing."""
    if name in texts:
        return True
    package, short = name.split("/", 1)
    file = next((f for root in folders if (f := root / package / "msg" / f"{short}.msg").is_file()), None)
    if file is None:
        return False
    texts[name] = text = file.read_text(encoding="utf-8")
    return all(_collect(used, folders, texts) for used in _used(text, package))


def _used(text: str, package: str) -> list[str]:
    """The message types a definition names, as `package/Name`."""
    fields = (_FIELD.match(line.partition("#")[0]) for line in text.splitlines())
    kinds = [field[1] for field in fields if field and field[1] not in _PRIMITIVES]
    return [kind if "/" in kind else f"{package}/{kind}" for kind in dict.fromkeys(kinds)]
