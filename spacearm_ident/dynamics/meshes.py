"""Where the meshes are that a URDF names: `package://NAME/...`, `file://...`, or a path beside the URDF.

A package is looked for in the folders given and those around them, and in ROS_PACKAGE_PATH and AMENT_PREFIX_PATH; a
checkout whose folder has another name than its package counts too, if the rest of the path is there.
"""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..documents import parse_xml

_PACKAGE, _FILE = "package://", "file://"
AROUND = 6
"""How many folders upwards from a given one a package is looked for: package/urdf/robots/ur5/arm.urdf and some."""


@dataclass(frozen=True)
class Meshes:
    """What became of a URDF's meshes.

    Attributes:
        urdf: The URDF with those that were found under absolute paths.
        found: How many different files were found.
        missing: Names, as the URDF has them, of those that were not.
    """

    urdf: str
    found: int
    missing: tuple[str, ...]

    @property
    def advice(self) -> str:
        """How to point to what is missing; empty where nothing is."""
        if not self.missing:
            return ""
        first = self.missing[0]
        package = first.removeprefix(_PACKAGE).split("/", 1)[0] if first.startswith(_PACKAGE) else ""
        what = f"--package-path FOLDER names the one that holds the folder {package}" if package else "correct the path"
        return f"{len(self.missing)} of {len(self.missing) + self.found} meshes not found ({first}): {what}"


def resolve_meshes(urdf: str, folders: Sequence[str]) -> Meshes:
    """Look for the meshes of collision and visual geometry.

    Args:
        urdf: Text of a URDF that `check_urdf` has passed.
        folders: Where to look first; a relative path is taken from each.
    """
    robot = parse_xml(urdf, "the URDF")
    places: dict[str, Path | None] = {}
    around = [str(folder) for folder in _around(folders)]
    for mesh in robot.iter("mesh"):
        name = mesh.get("filename", "")
        if name not in places:
            places[name] = next((path for path in _exact(name, around) if path.is_file()), None)
        found = places[name]
        if found is not None:
            mesh.set("filename", str(found.resolve()))
    missing = tuple(name for name, path in places.items() if path is None)
    return Meshes(ET.tostring(robot, encoding="unicode"), len(places) - len(missing), missing)


def package_folders(urdf: str, folders: Sequence[str]) -> list[str]:
    """Folders, absolute and few, with which `resolve_meshes` finds what it finds with `folders` from anywhere.

    Args:
        urdf: Text of the URDF whose meshes are wanted.
        folders: Where to look first, relative to the working directory or absolute.

    Returns:
        For `package_path` of an arm file; a mesh that is not found adds none.
    """
    needed: list[str] = []
    for mesh in parse_xml(urdf, "the URDF").iter("mesh"):
        name = mesh.get("filename", "")
        if any(path.is_file() for path in _exact(name, needed)):
            continue
        # The folder that holds the package before the package itself.
        places = [(folder, loose) for loose in (False, True) for folder in _around(folders)]
        fits = (f for f, loose in places if any(path.is_file() for path in _exact(name, [str(f)], loose)))
        folder = next(fits, None)
        if folder is not None:
            needed.append(str(folder.resolve()))
    return needed


def _exact(name: str, folders: Sequence[str], loose: bool = True) -> Iterator[Path]:
    """Files a name may mean, with packages in just these folders; `loose`: or with a package itself among them."""
    if name.startswith(_FILE):
        yield Path(name.removeprefix(_FILE))
    elif name.startswith(_PACKAGE):
        package, _, rest = name.removeprefix(_PACKAGE).partition("/")
        yield from (Path(folder) / package / rest for folder in folders)
        yield from (Path(folder) / rest for folder in folders if rest and loose)
    else:
        yield from (Path(folder) / name for folder in folders or ("",))


def _around(folders: Sequence[str]) -> list[Path]:
    """The folders and those above them, then what the environment names."""
    found: list[Path] = []
    for folder in map(Path, folders):
        resolved = folder.resolve()
        found += [folder, *list(resolved.parents)[:AROUND]]
    found += [Path(folder) for folder in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if folder]
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        found += [Path(prefix) / "share"] if prefix else []
    return list(dict.fromkeys(found))
