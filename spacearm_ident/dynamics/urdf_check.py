"""What is refused of a URDF before its parsers see it.

They recurse over the tree, drop what they cannot read (an inertial with one bad number, a joint that closes a loop)
with a word on stderr, and go on with another arm than the file describes.
"""

from __future__ import annotations

import math

from ..documents import check_xml
from ..errors import UserError

MAX_JOINTS = 500
"""Most joints of a URDF, fixed ones counted."""
_NUMBERS = {
    "origin": ("xyz", "rpy"),
    "axis": ("xyz",),
    "mass": ("value",),
    "inertia": ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"),
    "limit": ("lower", "upper", "effort", "velocity"),
    "mimic": ("multiplier", "offset"),
}
_COUNT = {"xyz": 3, "rpy": 3}
_XACRO = "/xacro"
"""How the addresses of xacro's namespace end: http://www.ros.org/wiki/xacro and older ones."""
_EXPRESSION = "${"
"""How xacro's expressions begin."""


def check_urdf(urdf: str) -> None:
    """Refuse a URDF that would be read as something else, or not survived.

    Raises:
        UserError: Not well-formed, a DOCTYPE, too large, a xacro that is not expanded, more than `MAX_JOINTS` joints,
            joints that make no tree, or kinematics and inertials that are no finite numbers (limits may be infinite).
    """
    joints = _Joints()
    check_xml(urdf, "the URDF", joints.on_element)
    joints.check_tree()


class _Joints:
    """Collects parent and child of every joint; checks on the way that xacro left nothing, and numbers."""

    def __init__(self) -> None:
        self.ends: list[dict[str, str]] = []
        self._path: list[tuple[str, str]] = []
        self._xacro: set[str] = set()

    def on_element(self, depth: int, tag: str, attributes: dict[str, str]) -> None:
        self._path = [*self._path[: depth - 1], (tag, attributes.get("name", ""))]
        inside = [name for name, _ in self._path[1:-1]]
        self._check_expanded(tag, attributes)
        if depth == 2 and tag == "joint":
            self.ends.append({"name": attributes.get("name", "")})
            if len(self.ends) > MAX_JOINTS:
                raise UserError(f"the URDF has more than {MAX_JOINTS} joints: give that of the arm alone")
        elif inside == ["joint"] and tag in ("parent", "child"):
            self.ends[-1][tag] = attributes.get("link", "")
        if inside == ["joint"] or inside == ["link", "inertial"]:
            for key in _NUMBERS.get(tag, ()):
                if key in attributes:
                    self._check_numbers(tag, key, attributes[key])

    def _check_expanded(self, tag: str, attributes: dict[str, str]) -> None:
        """Refuse what xacro replaces: names in its namespace, whatever its prefix, and expressions in links and joints.

        What plug-ins of other elements keep in their attributes is theirs.
        """
        for key, value in attributes.items():
            if key.startswith("xmlns:") and value.rstrip("/").endswith(_XACRO):
                self._xacro.add(key.removeprefix("xmlns:"))
        left = [f"<{tag}>"] if tag.rpartition(":")[0] in self._xacro else []
        left += [f"{tag} {key}" for key in attributes if key.rpartition(":")[0] in self._xacro]
        if [name for name, _ in self._path[1:2]] in (["link"], ["joint"]):
            left += [f"{tag} {key}={value!r}" for key, value in attributes.items() if _EXPRESSION in value]
        if left:
            raise UserError(
                f"the URDF is a xacro file that is not expanded ({left[0]}): run 'xacro FILE > robot.urdf' and give "
                "robot.urdf"
            )

    def _check_numbers(self, tag: str, key: str, text: str) -> None:
        try:
            values = [float(word) for word in text.split()]
        except ValueError:
            values = []
        fits = len(values) == _COUNT.get(key, 1) and all(
            math.isfinite(value) or (tag == "limit" and not math.isnan(value)) for value in values
        )
        if not fits:
            kind, name = self._path[1]
            raise UserError(f"the URDF's {kind} {name!r} has {tag} {key}={text!r}: give {_COUNT.get(key, 1)} number(s)")

    def check_tree(self) -> None:
        """Refuse links with two parents, and loops."""
        by_child: dict[str, dict[str, str]] = {}
        for joint in self.ends:
            child = joint.get("child", "")
            if child in by_child:
                both = f"{by_child[child]['name']!r} and {joint['name']!r}"
                raise UserError(f"the URDF's joints {both} both carry the link {child!r}: a URDF is a tree")
            by_child[child] = joint
        for joint in self.ends:
            link, steps = joint.get("parent", ""), 0
            while link in by_child:
                link, steps = by_child[link].get("parent", ""), steps + 1
                if steps > len(self.ends):
                    raise UserError(f"the URDF's joint {joint['name']!r} is in a loop: a URDF is a tree")
